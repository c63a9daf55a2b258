#!/bin/bash
# Images that keypoints must not be refined on: in simulated captures one camera is a
# frame late (its images are those of the next frame), or the surface shines, so that
# reflections wander over it. Errors of all cameras with keypoints as they are found,
# and refined and completed on the images, which must not be worse by more than 5 %.
#
#   tests/benchmark/disturbed_images.sh [SEED...]        (default: 1 2 3)
set -euo pipefail
# shellcheck source=tests/benchmark/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
[[ $# -gt 0 ]] || set -- 1 2 3

# late CAPTURE CAMERA: turns the images of the camera by a frame.
late() {
  local folders=("$1"/images/*/) first i
  first=${folders[0]}
  cp "$first$2" "$work/first"
  for ((i = 0; i + 1 < ${#folders[@]}; ++i)); do
    cp "${folders[i + 1]}$2" "${folders[i]}$2"
  done
  mv "$work/first" "${folders[-1]}$2"
}

capture=$work/capture

# simulate SEED GLOSS
simulate() {
  "$colmap" multi_frame_simulator --output_path "$capture" --Simulator.seed "$1" \
    --Simulator.overwrite 1 --Simulator.num_cameras 9 --Simulator.num_frames 3 \
    --Simulator.num_points 300 --Simulator.image_width 480 \
    --Simulator.image_height 360 --Simulator.gloss "$2" >"$work/log.txt"
}

for seed in "$@"; do
  for state in healthy late glossy; do
    case $state in
      healthy) simulate "$seed" 0 ;;
      late) late "$capture" cam04.png ;;
      glossy) simulate "$seed" 0.3 ;;
    esac
    rm -rf "$work/frames"
    "$colmap" multi_frame_triangulator --image_path "$capture/images" \
      --extrinsics_path "$capture/rig" --output_path "$work/frames" >"$work/log.txt"
    for refined in 0 1; do
      code=0
      "$colmap" multi_frame_intrinsics_refiner --input_path "$work/frames" \
        --image_path "$capture/images" --extrinsics_path "$capture/rig" \
        --output_path "$work/out" --MultiFrame.dense_features none \
        --MultiFrame.refine_keypoints "$refined" \
        --MultiFrame.complete_tracks "$refined" >"$work/log.txt" 2>&1 || code=$?
      evaluate "seed $seed $state, refined $refined (exit $code)" "$work/out" \
        "$capture/ground_truth"
    done
  done
done

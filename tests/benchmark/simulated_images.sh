#!/bin/bash
# Keypoints aligned on simulated images, whose truth is exact: 16 cameras, 4 frames,
# from images and a drifted calibration, with little and much noise and blur. Prints
# the rms of the keypoints under the true cameras, and the errors of the intrinsics
# in permille and px and in units of their reported standard deviations, with
# keypoints as they are, aligned, and with completed tracks.
#
#   tests/benchmark/simulated_images.sh [--seeds "0 1"] [--models "PINHOLE OPENCV"]
#                                       [--images "NOISE BLUR"]
set -euo pipefail
# shellcheck source=tests/benchmark/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
seeds=0
models="PINHOLE OPENCV"
images=("2 0.4" "8 0.4" "2 1.5" "8 1.5")
while (($# > 0)); do
  case $1 in
    --seeds) seeds=$2 && shift ;;
    --images) images=("$2") && shift ;;
    --models) models=$2 && shift ;;
    *) sed -n '2,9p' "${BASH_SOURCE[0]}" >&2 && exit 1 ;;
  esac
  shift
done

# true_rms OUT TRUTH: rms of the keypoints of OUT with all cameras as in TRUTH.
true_rms() {
  jq -r '.cameras[].name' "$1/summary.json" >"$work/cameras.txt"
  "$colmap" multi_frame_intrinsics_refiner --input_path "$1/frames" \
    --extrinsics_path "$2" --output_path "$work/true" \
    --MultiFrame.use_prior_intrinsics 1 --MultiFrame.held_out_share 0 \
    --constant_camera_list_path "$work/cameras.txt" \
    --MultiFrame.retriangulation_rounds 0 >"$work/log.txt"
  printf '%-40s keypoints under the true cameras: rms %.3f px, %s observations\n' "" \
    "$(number rms_px_after "$work/true/summary.json")" \
    "$(jq '[.cameras[].num_observations] | add' "$work/true/summary.json")"
}

# stds NAME OUT TRUTH: rms of the errors in units of the standard deviations.
stds() {
  python3 -B - "$root/tests/benchmark" "$2/summary.json" "$3" <<'PYTHON'
import json, math, pathlib, sys
sys.path.insert(0, sys.argv[1])
import model_files
summary = json.load(open(sys.argv[2], encoding="utf-8"))
cameras = summary["cameras"]
truth = model_files.read_text_cameras(pathlib.Path(sys.argv[3]))
def rms(idxs):
    errors = [(camera["params"][i] - truth[camera["name"]][1][i]) / camera["params_std"][i]
              for camera in cameras for i in idxs]
    return math.sqrt(sum(error**2 for error in errors) / len(errors))
std = summary["result"]["modes"]["common_focal_scale_std_permille"]
print(f"{'':40} errors: focal lengths {rms([0, 1]):.2f}, principal points {rms([2, 3]):.2f} stds, "
      f"reported std of the common focal scale {std:.3f} permille")
PYTHON
}

# try_capture MODEL NOISE BLUR SEED
try_capture() {
  local capture=$work/capture name refine_keypoints complete_tracks choice
  "$colmap" multi_frame_simulator --output_path "$capture" --Simulator.seed "$4" \
    --Simulator.overwrite 1 --Simulator.camera_model "$1" \
    --Simulator.image_noise "$2" --Simulator.blur "$3" >"$work/log.txt"
  rm -rf "$work/frames"
  "$colmap" multi_frame_triangulator --image_path "$capture/images" \
    --extrinsics_path "$capture/rig" --output_path "$work/frames" >"$work/log.txt"
  echo "$1, noise $2 grey levels, blur $3 px, seed $4"
  for choice in "neither 0 0" "aligned 1 0" "completed 1 1"; do
    read -r name refine_keypoints complete_tracks <<<"$choice"
    "$colmap" multi_frame_intrinsics_refiner --input_path "$work/frames" \
      --image_path "$capture/images" --extrinsics_path "$capture/rig" \
      --output_path "$work/out" --MultiFrame.dense_features none \
      --MultiFrame.refine_keypoints "$refine_keypoints" \
      --MultiFrame.complete_tracks "$complete_tracks" >"$work/log.txt"
    evaluate "$name" "$work/out" "$capture/ground_truth"
    true_rms "$work/out" "$capture/ground_truth"
    stds "$name" "$work/out" "$capture/ground_truth"
  done
}

for model in $models; do
  for noise_and_blur in "${images[@]}"; do
    read -r noise blur <<<"$noise_and_blur"
    for seed in $seeds; do try_capture "$model" "$noise" "$blur" "$seed"; done
  done
done

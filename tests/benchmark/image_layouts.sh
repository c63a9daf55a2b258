#!/bin/bash
# panoptic31 in every layout of images, and as one lossless video (FFV1) per camera:
# triangulated and refined, largest difference of any intrinsic parameter from the
# layout by frame. Needs ffmpeg. The images are converted to PNG first, so that all
# layouts have the same pixels.
#
#   tests/benchmark/image_layouts.sh [DATA_FOLDER]
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
command -v ffmpeg >/dev/null || { echo "SKIPPED: there is no ffmpeg" >&2 && exit 0; }
find_data "$@"
rig=$data/panoptic31/drifted_calibration

for image in "$data"/panoptic31/images/*/*; do
  frame=$(basename "$(dirname "$image")")
  camera=$(basename "${image%.*}")
  mkdir -p "$work/by_frame/$frame" "$work/by_camera/$camera" "$work/flat"
  ffmpeg -v error -i "$image" "$work/by_frame/$frame/$camera.png" </dev/null
  ln -s "$work/by_frame/$frame/$camera.png" "$work/by_camera/$camera/$frame.png"
  ln -s "$work/by_frame/$frame/$camera.png" "$work/flat/${camera}_$frame.png"
done
mkdir "$work/videos"
for folder in "$work"/by_camera/*; do
  ffmpeg -v error -framerate 25 -pattern_type glob -i "$folder/*.png" -c:v ffv1 \
    -pix_fmt bgr0 "$work/videos/$(basename "$folder").mkv" </dev/null
done

intrinsics() { jq -c '[.cameras[] | .params]' "$work/out_$1/refined/summary.json"; }

for layout in by_frame by_camera flat videos; do
  "$colmap" multi_frame_automatic_refiner --workspace_path "$work/out_$layout" \
    --image_path "$work/$layout" --extrinsics_path "$rig" \
    --MultiFrame.dense_features none >"$work/log.txt"
  evaluate "$layout" "$work/out_$layout/refined" "$data/panoptic31/calibration"
  jq -rn --argjson a "$(intrinsics by_frame)" --argjson b "$(intrinsics "$layout")" \
    '[[$a, $b] | transpose[] | transpose[] | .[0] - .[1] | fabs] | max
     | "  largest difference from by_frame: \(.) px"'
done

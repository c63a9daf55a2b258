#!/bin/bash
# The real captures of the data folder from images, the published extrinsics and
# drifted intrinsics: multi_frame_triangulator, then the refiner. Prints what was
# triangulated, the errors against the published calibrations, and for robovision12
# repeatability and the residuals of frames left out.
#
#   tests/benchmark/captures_from_images.sh [DATA_FOLDER]
set -euo pipefail
# shellcheck source=tests/benchmark/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
find_data "$@"

# triangulate SET INTRINSICS: from SET/images to $work/frames.
triangulate() {
  rm -rf "$work/frames"
  TIMEFORMAT='user CPU s: %U'
  time "$colmap" multi_frame_triangulator --image_path "$1/images" \
    --extrinsics_path "$1/calibration" --intrinsics_path "$2" \
    --output_path "$work/frames" >"$work/log.txt"
  cat "$work"/frames/*/triangulation.json |
    awk -F'[:,]' '
      /"num_images"/ { if ($2 < min || !n) min = $2; ++n }
      /"num_points"/ { points += $2 }
      /"num_observations"/ { observations += $2 }
      /"(extraction|matching|verification|triangulation)"/ { gsub(/[ "]/, "", $1); time[$1] += $2 }
      END { printf "%d frames of at least %d images, %.0f points per frame, track length %.2f; s per frame:", n, min, points / n, observations / points
        for (stage in time) printf " %s %.1f", stage, time[stage] / n
        print "" }'
}

# points_per_frame FRAMES: of models that COLMAP can read.
points_per_frame() {
  for frame in "$1"/*; do
    "$colmap" model_analyzer --path "$frame" 2>&1
  done | awk '/Points:/ { n += $NF; ++frames } END { printf "frames_triangulated: %.0f points per frame\n", n / frames }'
}

set_path=$data/panoptic31
echo "panoptic31 (31 cameras)"
points_per_frame "$set_path/frames_triangulated"
triangulate "$set_path" "$set_path/drifted_calibration"
refine without_new_tracks "$work/frames" "$set_path/calibration" 1 10 \
  --MultiFrame.retriangulation_rounds 0
for treatment in keep merge drop; do
  options=(--MultiFrame.static_points "$treatment")
  refine "${treatment}_10_frames" "$work/frames" "$set_path/calibration" 1 10 \
    "${options[@]}"
  halves "$treatment" "$work/frames" "$set_path/calibration" 5 "${options[@]}"
done

set_path=$data/robovision12
echo "robovision12 (12 cameras)"
points_per_frame "$set_path/frames_triangulated"
triangulate "$set_path" "$set_path/drifted_calibration"
halves exact "$work/frames" "$set_path/calibration" 4
halves soft "$work/frames" "$set_path/calibration" 4 "${soft[@]}"

set_path=$data/strecha_herz_jesus_p8
echo "strecha_herz_jesus_p8 (8 images as 8 cameras; 1 % and 10 px off)"
mkdir "$work/drifted"
cp "$set_path/calibration/"{images,points3D}.txt "$work/drifted"
awk '/^#/ { print; next }
  { printf "%s %s %s %s %.17g %.17g %.17g %.17g\n", $1, $2, $3, $4, 1.01 * $5, 1.01 * $6, $7 + 10, $8 + 10 }' \
  "$set_path/calibration/cameras.txt" >"$work/drifted/cameras.txt"
triangulate "$set_path" "$work/drifted"
evaluate start "$work/drifted" "$set_path/calibration"
refine accurate "$work/frames" "$set_path/calibration" 1 1

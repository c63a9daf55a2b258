#!/bin/bash
# Repeatability over disjoint sets of frames of panoptic31 (odd against even ones,
# first half against second half), and errors against its published calibration, with
# keypoints as they are, aligned on the images, and with completed tracks, too; static
# background kept and dropped. Without dense features, so that nothing else of the
# images takes part.
#
#   tests/benchmark/refined_keypoints.sh [DATA_FOLDER]
set -euo pipefail
# shellcheck source=tests/benchmark/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
find_data "$@"

set_path=$data/panoptic31
for treatment in keep drop; do
  for choice in "neither 0 0" "aligned 1 0" "completed 1 1"; do
    read -r name refine_keypoints complete_tracks <<<"$choice"
    for split in interleaved halves; do
      "$split" "${name}_${treatment}_$split" "$set_path/frames_triangulated" \
        "$set_path/calibration" 5 --image_path "$set_path/images" \
        --MultiFrame.dense_features none \
        --MultiFrame.static_points "$treatment" \
        --MultiFrame.refine_keypoints "$refine_keypoints" \
        --MultiFrame.complete_tracks "$complete_tracks"
    done
  done
done

#!/bin/bash
# Which frames of a long capture: panoptic31 with K of its ten frames, by
# --MultiFrame.max_num_frames (the middle ones of K equal parts), the first K, and
# those that differ most from one another (lists: the pair with the largest
# difference of small grey images, then again and again the frame whose smallest
# difference from those taken is largest). Errors against the published calibration,
# and distance from the result of all ten.
#
#   tests/benchmark/frame_choice.sh [DATA_FOLDER]
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
find_data "$@"
frames=$data/panoptic31/frames_triangulated
rig=$data/panoptic31/calibration

# choice NAME [OPTION...]
choice() {
  "$colmap" multi_frame_intrinsics_refiner --input_path "$frames" --extrinsics_path "$rig" \
    --image_path "$data/panoptic31/images" --output_path "$work/$1" \
    --MultiFrame.dense_features none --MultiFrame.report 0 "${@:2}" >"$work/log.txt"
  evaluate "$1: calibration" "$work/$1" "$rig"
  [[ $1 == all ]] || evaluate "$1: all ten" "$work/$1" "$work/all/rig"
}

choice all
for count in 2 3 5; do
  choice "even_$count" --MultiFrame.max_num_frames "$count"
  list_frames "$frames" 1 "$count" >"$work/list.txt"
  choice "first_$count" --frame_list_path "$work/list.txt"
done
for list in "000000 000135" "000000 000060 000135" "000000 000030 000060 000090 000135"; do
  tr ' ' '\n' <<<"$list" >"$work/list.txt"
  choice "most_different_$(wc -w <<<"$list")" --frame_list_path "$work/list.txt"
done

#!/bin/bash
# Accuracy on the real captures of the data folder, against their published
# calibrations: start, `accurate` with 1, 2, 5 and 10 frames, `paper`, static
# background kept, merged and dropped, repeatability over disjoint halves of the
# frames and residuals of frames left out; with dense features `sift` and, where
# options of a network are given, with that.
#
#   tests/benchmark/real_captures.sh [DATA_FOLDER] [-- NETWORK_OPTION...]
#   for example -- --MultiFrame.onnx_path alike.onnx
set -euo pipefail
# shellcheck source=tests/benchmark/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
folder=()
if (($# > 0)) && [[ $1 != -- ]]; then
  folder=("$1")
  shift
fi
(($# == 0)) || shift
network=("$@")
find_data "${folder[@]}"

# with_features NAME SET_PATH HALF FEATURE_OPTION...: all frames, one frame, and
# halves, with the options in the array `extrinsics`. Features are computed once.
with_features() {
  local frames=$2/frames_triangulated rig=$2/calibration
  local database=$work/features.sqlite
  refine "$1_all_frames" "$frames" "$rig" 1 $((2 * $3)) "${extrinsics[@]}" \
    --image_path "$2/images" "${@:4}" --MultiFrame.write_dense_features "$database"
  local options=("${extrinsics[@]}" --MultiFrame.dense_feature_path "$database")
  refine "$1_1_frame" "$frames" "$rig" 1 1 "${options[@]}"
  halves "$1" "$frames" "$rig" "$3" "${options[@]}"
  rm "$database"
}

extrinsics=()
set_path=$data/panoptic31
frames=$set_path/frames_triangulated
rig=$set_path/calibration
echo "panoptic31 (31 cameras)"
evaluate start "$frames" "$rig"
for count in 1 2 5 10; do
  refine "accurate_${count}_frames" "$frames" "$rig" 1 "$count"
done
refine paper_10_frames "$frames" "$rig" 1 10 --MultiFrame.preset paper
for treatment in keep merge drop; do
  options=(--MultiFrame.static_points "$treatment")
  refine "${treatment}_10_frames" "$frames" "$rig" 1 10 "${options[@]}"
  halves "$treatment" "$frames" "$rig" 5 "${options[@]}"
done
with_features sift "$set_path" 5
((${#network[@]} == 0)) || with_features network "$set_path" 5 "${network[@]}"

set_path=$data/robovision12
frames=$set_path/frames_triangulated
rig=$set_path/calibration
echo "robovision12 (12 cameras)"
refine triangulated "$frames" "$rig" 1 8
refine sfm "$set_path/frames_sfm" "$rig" 1 8
halves exact "$frames" "$rig" 4
extrinsics=("${soft[@]}")
refine soft_triangulated "$frames" "$rig" 1 8 "${extrinsics[@]}"
for treatment in keep merge drop; do
  halves "soft_$treatment" "$frames" "$rig" 4 "${extrinsics[@]}" \
    --MultiFrame.static_points "$treatment"
done
with_features soft_sift "$set_path" 4
((${#network[@]} == 0)) || with_features soft_network "$set_path" 4 "${network[@]}"

#!/bin/bash
# Refined intrinsics of two programs, as one built with COLMAP 3.8 and one with
# COLMAP 4, from the same frames: panoptic31 and robovision12 of the data folder,
# and a simulated dome. Prints the largest difference per capture, relative to the
# parameter (to 1 for distortion coefficients), and fails if one is above 1e-9.
#
#   tests/benchmark/compare_versions.sh PROGRAM PROGRAM2 [DATA_FOLDER]
set -euo pipefail
(($# >= 2)) || {
  sed -n '2,7p' "${BASH_SOURCE[0]}" >&2
  exit 1
}
programs=("$(realpath "$1")" "$(realpath "$2")")
# shellcheck source=tests/benchmark/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
status=0

# compare NAME FRAMES RIG [OPTION...]: 5 frames.
compare() {
  local i
  list_frames "$2" 1 5 >"$work/list.txt"
  for i in 0 1; do
    "${programs[i]}" multi_frame_intrinsics_refiner --input_path "$2" --extrinsics_path "$3" \
      --frame_list_path "$work/list.txt" --output_path "$work/out$i" --MultiFrame.report 0 \
      "${@:4}" >"$work/log.txt"
  done
  jq -rs --arg name "$1" '
    def size: fabs | if . > 1 then . else 1 end;
    [.[].cameras] | transpose
    | [.[] as [$a, $b] | [$a.params, $b.params] | transpose[] | (.[0] - .[1] | fabs) / (.[0] | size)]
    | "\($name) \(max) \(length)"' "$work"/out[01]/summary.json |
    awk '{ printf "%-32s %.2g of %d parameters\n", $1, $2, $3; exit !($2 < 1e-9) }' || status=1
}

"${programs[0]}" multi_frame_simulator --output_path "$work/dome" --Simulator.num_cameras 38 \
  --Simulator.num_points 800 --Simulator.render_images 0 >"$work/log.txt"
compare dome "$work/dome/frames" "$work/dome/rig"
find_data "${@:3}"
compare panoptic31 "$data/panoptic31/frames_triangulated" "$data/panoptic31/calibration"
compare robovision12 "$data/robovision12/frames_triangulated" "$data/robovision12/calibration"
compare robovision12_sfm_soft "$data/robovision12/frames_sfm" "$data/robovision12/calibration" "${soft[@]}"
exit "$status"

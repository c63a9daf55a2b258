#!/bin/bash
# Cost of multi_frame_triangulator against the number of cameras: simulates one
# frame with images for each number and prints the verified pairs of cameras, the
# points, and user CPU seconds of one thread: of all, and of each stage (by its
# share of the wall time, so that other programs on the machine do not count).
#
#   tests/benchmark/triangulator_scaling.sh [CAMERAS... [-- OPTION...]]
set -euo pipefail
# shellcheck source=tests/benchmark/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
numbers=()
while (($# > 0)) && [[ $1 != -- ]]; do
  numbers+=("$1")
  shift
done
(($# == 0)) || shift
((${#numbers[@]} > 0)) || numbers=(10 31 64)

record=$work/frames/frame000000/triangulation.json
TIMEFORMAT=%U
printf '%8s %6s %7s %12s %11s %13s %14s %8s\n' cameras pairs points \
  extraction_s matching_s verification_s triangulation_s user_s
for num_cameras in "${numbers[@]}"; do
  rm -rf "$work/frames"
  "$colmap" multi_frame_simulator --output_path "$work/capture" \
    --Simulator.num_cameras "$num_cameras" --Simulator.num_frames 1 \
    --Simulator.image_width 640 --Simulator.image_height 427 \
    --Simulator.overwrite 1 --Simulator.quiet 1
  { time "$colmap" multi_frame_triangulator --image_path "$work/capture/images" \
    --extrinsics_path "$work/capture/rig" --output_path "$work/frames" \
    --MultiFrameTriangulator.num_threads 1 "$@" >"$work/log.txt"; } 2>"$work/time.txt"
  awk -v n="$num_cameras" -v pairs="$(number num_pairs "$record")" \
    -v points="$(number num_points "$record")" -v e="$(number extraction "$record")" \
    -v m="$(number matching "$record")" -v v="$(number verification "$record")" \
    -v t="$(number triangulation "$record")" '{ f = $1 / (e + m + v + t)
      printf "%8d %6d %7d %12.1f %11.1f %13.1f %14.1f %8.1f\n",
        n, pairs, points, f * e, f * m, f * v, f * t, $1 }' "$work/time.txt"
done

#!/bin/bash
# The part of the refiner's work that more threads cannot share: simulates 40 cameras x
# 32 frames, refines them, and prints user CPU seconds, those outside of loops over
# several items (src/util/cpu_time.h; all of the run, start and report included) and
# their share, for 1 and 2 threads. Times of a busy machine vary; the share does less.
#
#   tests/benchmark/serial_share.sh [CAMERAS [FRAMES [POINTS]]] [-- refiner options...]
set -euo pipefail
# shellcheck source=tests/benchmark/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
sizes=()
while (($#)) && [[ $1 != -- ]]; do
  sizes+=("$1")
  shift
done
shift $(($# > 0))

"$colmap" multi_frame_simulator --output_path "$work/capture" --Simulator.quiet 1 \
  --Simulator.num_cameras "${sizes[0]:-40}" --Simulator.num_frames "${sizes[1]:-32}" \
  --Simulator.num_points "${sizes[2]:-2000}" --Simulator.render_images 0

printf '%8s %10s %10s %8s\n' threads cpu_s serial_s share
TIMEFORMAT='%U %S'
for threads in 1 2; do
  { time "$colmap" multi_frame_intrinsics_refiner --input_path "$work/capture/frames" \
    --extrinsics_path "$work/capture/rig" --output_path "$work/result" \
    --MultiFrame.num_threads "$threads" "$@" >"$work/log.txt"; } 2>"$work/time.txt"
  read -r user system <"$work/time.txt"
  jq -r '.cpu_s | "\(.total) \(.serial)"' "$work/result/summary.json" |
    awk -v threads="$threads" -v all="$user $system" '{
      split(all, time, " ")
      total = time[1] + time[2]
      # What comes after the summary is serial.
      serial = total - ($1 - $2)
      printf "%8d %10.2f %10.2f %6.1f %%\n", threads, total, serial, 100 * serial / total }'
done

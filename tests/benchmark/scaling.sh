#!/bin/bash
# Cost against the number of frames: simulates one capture of 38 cameras, refines
# its first 1, 2, 4, ... frames and prints user CPU seconds, wall seconds, peak
# memory and Newton iterations of each run, then 1 thread against 2 threads.
#
#   tests/benchmark/scaling.sh [FRAMES] [POINTS] [extra refiner options...]
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd -P)
colmap=${MFIR_COLMAP:-$root/build/bin/colmap}
num_frames=${1:-64}
num_points=${2:-2000}
shift $(($# < 2 ? $# : 2))
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

"$colmap" multi_frame_simulator --output_path "$work/capture" \
  --Simulator.num_cameras 38 --Simulator.num_frames "$num_frames" \
  --Simulator.num_points "$num_points" --Simulator.render_images 0 \
  --Simulator.quiet 1

# refine FRAMES THREADS [OPTION...]: one row of the table.
refine() {
  find "$work/capture/frames" -mindepth 1 -maxdepth 1 -printf '%f\n' | sort |
    head -n "$1" >"$work/list.txt"
  TIMEFORMAT='%U %R'
  { time "$colmap" multi_frame_intrinsics_refiner \
    --input_path "$work/capture/frames" --frame_list_path "$work/list.txt" \
    --extrinsics_path "$work/capture/rig" --output_path "$work/result" \
    --MultiFrame.num_threads "$2" "${@:3}" >"$work/log.txt"; } 2>"$work/time.txt"
  read -r user wall <"$work/time.txt"
  rss=$(jq .peak_rss_bytes "$work/result/summary.json")
  iterations=$(awk -F, 'NR > 1 { sum += $3 } END { print sum }' "$work/result/history.csv")
  refining=$(jq '.timings_s["Refining intrinsics"]' "$work/result/summary.json")
  printf '%6d %8d %10s %10s %14.2f %10d %10d\n' \
    "$1" "$2" "$user" "$wall" "$refining" $((rss / 1048576)) "$iterations"
}

printf '%6s %8s %10s %10s %14s %10s %10s\n' \
  frames threads user_s wall_s refining_s peak_MiB iterations
for ((n = 1; n <= num_frames; n *= 2)); do
  refine "$n" -1 "$@"
done
for threads in 1 2; do
  refine "$num_frames" "$threads" "$@"
done

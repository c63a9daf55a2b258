#!/bin/bash
# Accuracy on captures in the paper's formats with known truth: each FOLDER has
# recon/ (frames), KRT (known extrinsics) and KRT_gt (truth), and for
# --dense_features dense_features.sqlite. Prints focal_abs and pp_abs (px, sum of
# both axes), user CPU seconds and number of solves of each, and the means.
#
#   tests/benchmark/dome_captures.sh [--frames N] [--dense_features]
#     FOLDER... [-- refiner options...]
set -euo pipefail
# shellcheck source=tests/benchmark/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
num_frames=1000000
dense_features=0
folders=()
while (($# > 0)) && [[ $1 != -- ]]; do
  case $1 in
    --frames) num_frames=$2 && shift ;;
    --dense_features) dense_features=1 ;;
    *) folders+=("$1") ;;
  esac
  shift
done
(($# == 0)) || shift
((${#folders[@]} > 0)) || {
  sed -n '2,8p' "${BASH_SOURCE[0]}" >&2
  exit 1
}

# value KEY: mean of a metric in the log.
value() {
  awk -v key="$1" '$1 == key { print $3; exit }' "$work/log.txt"
}

TIMEFORMAT=%U
printf '%-40s %10s %10s %8s %7s\n' capture focal_abs pp_abs user_s solves
for folder in "${folders[@]}"; do
  find "$folder/recon" -mindepth 1 -maxdepth 1 -printf '%f\n' | sort |
    head -n "$num_frames" >"$work/list.txt"
  features=()
  ((dense_features == 0)) ||
    features=(--MultiFrame.dense_feature_path "$folder/dense_features.sqlite")
  { time "$colmap" multi_frame_intrinsics_refiner --input_path "$folder/recon" \
    --frame_list_path "$work/list.txt" --extrinsics_path "$folder/KRT" \
    --ground_truth_path "$folder/KRT_gt" --output_path "$work/result" \
    "${features[@]}" "$@" >"$work/log.txt"; } 2>"$work/time.txt"
  printf '%-40s %10s %10s %8s %7s\n' "$folder" "$(value focal_abs)" \
    "$(value pp_abs)" "$(cat "$work/time.txt")" \
    "$(($(wc -l <"$work/result/history.csv") - 1))"
done | tee "$work/table.txt"
awk '{ f += $2; p += $3; t += $4; n += $5 }
  END { printf "%-40s %10.3f %10.4f %8.2f %7.1f\n", "mean of " NR, f / NR, p / NR, t / NR, n / NR }' \
  "$work/table.txt"

#!/bin/bash
# Interrupts every command at random instants and checks that the exit code is the
# one that shells expect, that stderr has one line, that an earlier result is whole,
# that nothing is left over, and that the next run gives the same result as ever.
#
#   tests/interrupted_runs.sh COLMAP [RUNS [SEED]]
#
#   COLMAP   the program
#   RUNS     interrupted runs of each command; default 5
#   SEED     of the instants; default 1
set -euo pipefail

colmap=$1
runs=${2:-5}
RANDOM=${3:-1}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

fail() {
  echo "FAILED: $*" >&2
  exit 1
}

# Names and contents of all files, but for times and memory in summaries.
digest() {
  (cd "$1" && find . -type f ! -name summary.json ! -name history.csv \
    ! -name report.html ! -name triangulation.json ! -name database.db \
    -exec sha256sum {} + | sort -k 2)
}

no_rests() {
  local rests
  rests=$(find "$work" -name '*unfinished*' -o -name '*.removed_*' -o -name '*.mfir_*')
  [[ -z $rests ]] || fail "$1 left $rests"
}

# whole_run OPTION...: a run of interrupt's command that gives its result.
whole_run() {
  "$colmap" "$name" "$@" >"$work/log.txt" 2>&1 || fail "$name: $(cat "$work/log.txt")"
  [[ $(digest "$output") == "$before" ]] || fail "$name: another result than before"
  no_rests "$name"
}

# interrupt NAME OUTPUT OPTION...: the whole run, then interrupted ones, then a
# whole one again.
interrupt() {
  local name=$1 output=$2 begin duration_ms before signal code expected delay_ms count=0
  shift 2
  begin=$(date +%s%N)
  "$colmap" "$name" "$@" >"$work/log.txt" 2>&1 || fail "$name: $(cat "$work/log.txt")"
  duration_ms=$((($(date +%s%N) - begin) / 1000000 + 1))
  before=$(digest "$output")
  for ((i = 0; i < runs; ++i)); do
    case $((RANDOM % 3)) in
      0) signal=INT expected=130 ;;
      1) signal=TERM expected=143 ;;
      2) signal=KILL expected=137 ;;
    esac
    delay_ms=$((RANDOM * duration_ms / 32768))
    code=0
    # In a shell of its own, which says "Killed" where nobody reads it.
    (timeout --preserve-status -s "$signal" \
      "$((delay_ms / 1000)).$(printf %03d $((delay_ms % 1000)))" \
      "$colmap" "$name" "$@" >/dev/null 2>"$work/stderr.txt"
    exit $?) 2>/dev/null || code=$?
    [[ $code -eq 0 || $code -eq $expected ]] ||
      fail "$name: exit code $code after $signal at $delay_ms ms: $(cat "$work/stderr.txt")"
    [[ $code -eq 0 ]] || count=$((count + 1))
    if [[ $code -eq 130 || $code -eq 143 ]]; then
      # Nothing is said before main, where the system ends the program.
      [[ $(grep -v '^WARNING' "$work/stderr.txt" | sed 's/^Interrupted by SIG.*/-/') =~ ^-?$ ]] ||
        fail "$name: stderr after $signal at $delay_ms ms: $(cat "$work/stderr.txt")"
      no_rests "$name after $signal at $delay_ms ms"
    fi
    # A killed run leaves what it had begun; the next whole one removes it.
    [[ $code -ne 137 ]] || whole_run "$@"
    # The triangulator skips frames that are finished: each of them is whole.
    [[ $name == multi_frame_triangulator ]] || [[ $(digest "$output") == "$before" ]] ||
      fail "$name: the earlier result has changed after $signal at $delay_ms ms"
    [[ $name != multi_frame_triangulator ]] || rm -rf "$output"
  done
  whole_run "$@"
  echo "$name: $count of $runs runs interrupted within $duration_ms ms"
}

capture=$work/capture
interrupt multi_frame_simulator "$capture" --output_path "$capture" \
  --Simulator.overwrite 1 \
  --Simulator.num_cameras 5 --Simulator.num_frames 2 \
  --Simulator.num_points 150 --Simulator.render_images 1 \
  --Simulator.image_width 320 --Simulator.image_height 240
interrupt multi_frame_triangulator "$work/frames" --image_path "$capture/images" \
  --extrinsics_path "$capture/rig" --output_path "$work/frames"
interrupt multi_frame_intrinsics_refiner "$work/out" --input_path "$capture/frames" \
  --extrinsics_path "$capture/rig" --output_path "$work/out"
mkdir "$work/evaluation"
interrupt multi_frame_evaluator "$work/evaluation" --input_path "$work/out" \
  --ground_truth_path "$capture/ground_truth" \
  --output_path "$work/evaluation/evaluation.json"

#!/bin/bash
# Runs every command while something goes wrong, and checks that it ends with an exit
# code and one line that say so, that an earlier result is whole, that nothing is left
# over and that the next run is right.
#
#   tests/faulty_runs.sh COLMAP FAILING_CALLS [STRIDE [FAULT...]]
#
#   COLMAP         the program
#   FAILING_CALLS  the library of tests/faults/failing_calls.c
#   STRIDE         above 1 about 400 / STRIDE of the writes of a command find the disk
#                  full, 1 / STRIDE of 40 runs have inputs that change, and every third
#                  name is tried; default 1: all
#   FAULT          full_disk, read_only, changed_input, two_runs, memory, few_files,
#                  names; default: all
set -euo pipefail

colmap=$1
failing_calls=$2
stride=${3:-1}
shift $(($# < 3 ? $# : 3))
faults=("$@")
((${#faults[@]})) || faults=(full_disk read_only changed_input two_runs memory few_files names)
RANDOM=1
work=$(mktemp -d)
chmod 755 "$work"
trap 'chmod -R u+w "$work"; rm -rf "$work"' EXIT
# Models are read through links in there.
export TMPDIR=$work/tmp
mkdir -m 1777 "$TMPDIR"
# What starts the program as somebody else, whom permissions bind.
as_user=()
num_runs=0

fail() {
  echo "FAILED: $*" >&2
  exit 1
}

# Names and contents of all files, but for what has times and paths in it.
digest() {
  (cd "$1" && find . -type f ! -name summary.json ! -name history.csv \
    ! -name report.html ! -name triangulation.json ! -name database.db \
    ! -name project.ini ! -name evaluation.json -exec sha256sum {} + | sort -k 2)
}

no_rests() {
  local rests
  rests=$(find "$work" -name '*unfinished*' -o -path "$TMPDIR/*")
  [[ -z $rests ]] || fail "$1 left $rests"
}

# attempt WHAT CODES COMMAND...: its exit code, one of the CODES, is in `code`; any but
# 0 and 5 comes with one line on stderr.
attempt() {
  local what=$1 codes=$2
  shift 2
  code=0
  timeout 100 "${as_user[@]}" "$@" >"$work/stdout.txt" 2>"$work/stderr.txt" </dev/null || code=$?
  # COLMAP 4's log has colours, and says without a line's end that it has no file.
  sed -i 's/\x1b\[[0-9;]*m//g; s/COULD NOT CREATE A LOGGINGFILE [0-9.-]*!//g' "$work/stderr.txt"
  num_runs=$((num_runs + 1))
  [[ " $codes " == *" $code "* ]] ||
    fail "$what: exit code $code: $(tail -n 5 "$work/stderr.txt")"
  [[ $code -eq 0 || $code -eq 5 ]] || [[ $(grep -vcE '^WARNING|SQLite error|^Could not create logging file|^libpng error' "$work/stderr.txt") -eq 1 &&
    $(grep -c '^ERROR: ' "$work/stderr.txt") -eq 1 ]] ||
    fail "$what: no single error: $(cat "$work/stderr.txt")"
}

# The commands, on the capture in $data: commands VERB calls VERB NAME OUTPUT OPTION...
# for each. The outputs are in $results.
commands() {
  local verb=$1 type
  "$verb" multi_frame_simulator "$results/capture" --output_path "$results/capture" \
    --Simulator.overwrite 1 --Simulator.num_cameras 5 --Simulator.num_frames 2 \
    --Simulator.num_points 60 --Simulator.image_width 200 --Simulator.image_height 150
  "$verb" multi_frame_triangulator "$results/frames" --image_path "$data/images" \
    --extrinsics_path "$data/rig" --output_path "$results/frames" --MultiFrameTriangulator.overwrite 1
  "$verb" multi_frame_intrinsics_refiner "$results/out" --input_path "$data/frames" \
    --extrinsics_path "$data/rig" --output_path "$results/out" \
    --MultiFrame.output_types opencv,kalibr
  "$verb" multi_frame_automatic_refiner "$results/automatic" --image_path "$data/images" \
    --extrinsics_path "$data/rig" --workspace_path "$results/automatic"
  mkdir -p "$results/evaluation" "$results/report" "$results/rigs"
  "$verb" multi_frame_evaluator "$results/evaluation" --input_path "$data/out" \
    --ground_truth_path "$data/ground_truth" \
    --output_path "$results/evaluation/evaluation.json"
  "$verb" multi_frame_reporter "$results/report" --input_path "$data/out" \
    --output_path "$results/report/report.html"
  for type in colmap rig_config krt opencv transforms metashape panoptic csv kalibr multical; do
    "$verb" multi_frame_rig_converter "$results/rigs" --input_path "$data/ground_truth" \
      --output_path "$results/rigs/$type" --output_type "$type"
  done
}

whole_run() {
  local name=$1 output=$2
  shift 2
  attempt "$name" 0 "$colmap" "$name" "$@"
}

# unchanged WHAT OUTPUT: it is as it was, and nothing else is there.
unchanged() {
  [[ $(digest "$2") == "$before" ]] || fail "$1: the earlier result has changed"
  no_rests "$1"
}

# Every write, one after another, is the first that finds the disk full.
on_full_disk() {
  local name=$1 output=$2 before num n step=1
  shift 2
  before=$(digest "$output")
  attempt "$name" 0 env LD_PRELOAD="$failing_calls" MFIR_FAIL_COUNT="$work/count.txt" \
    "$colmap" "$name" "$@"
  num=$(cat "$work/count.txt")
  ((num > 0)) || fail "$name: no writes are counted"
  ((stride == 1)) || step=$((1 + num * stride / 400))
  for ((n = 1 + RANDOM % step; n <= num; n += step)); do
    attempt "$name, full at write $n of $num" "0 4" env LD_PRELOAD="$failing_calls" \
      MFIR_FAIL_FROM=$n "$colmap" "$name" "$@"
    unchanged "$name, full at write $n of $num" "$output"
  done
  whole_run "$name" "$output" "$@"
  unchanged "$name after a full disk" "$output"
}

full_disk() { commands on_full_disk; }

# Nobody may write to the output, whether it has an earlier result or not.
on_read_only() {
  local name=$1 output=$2 before
  shift 2
  before=$(digest "$output")
  chmod -R a-w "$results"
  attempt "$name, read-only output" 4 "$colmap" "$name" "$@"
  chmod -R u+w "$results"
  unchanged "$name, read-only output" "$output"
  mv "$output" "$work/aside"
  chmod a-w "$results"
  attempt "$name, read-only parent" 4 "$colmap" "$name" "$@"
  chmod u+w "$results"
  [[ ! -e $output ]] || fail "$name: made $output"
  mv "$work/aside" "$output"
  no_rests "$name, read-only parent"
}

read_only() {
  local program=$colmap
  if ((EUID == 0)); then
    # Root may write everywhere.
    command -v setpriv >/dev/null || { echo "read_only: skipped, no setpriv" && return; }
    cp "$colmap" "$work/colmap"
    colmap=$work/colmap
    chown -R nobody "$results"
    as_user=(setpriv --reuid=nobody --clear-groups)
  fi
  commands on_read_only
  mv "$TMPDIR" "$TMPDIR.away"
  attempt "no temporary folder" 0 "$colmap" multi_frame_intrinsics_refiner \
    --input_path "$data/frames" --extrinsics_path "$data/rig" --output_path "$results/out"
  mv "$TMPDIR.away" "$TMPDIR"
  chmod a-r "$data/frames/frame000001/sparse/0/images.bin"
  attempt "unreadable input" 2 "$colmap" multi_frame_intrinsics_refiner \
    --input_path "$data/frames" --extrinsics_path "$data/rig" --output_path "$results/out"
  chmod a+r "$data/frames/frame000001/sparse/0/images.bin"
  as_user=()
  colmap=$program
  chown -R "$EUID" "$results"
}

# Cuts, empties, overwrites and removes files of $data until it is ended.
spoil_inputs() {
  local files file i
  mapfile -t files < <(find "$data" -type f)
  for ((i = 0; i < 1000; ++i)); do
    file=${files[RANDOM % ${#files[@]}]}
    case $((RANDOM % 4)) in
      0) truncate -s "$((RANDOM % 3000))" "$file" ;;
      1) : >"$file" ;;
      2) dd if=/dev/urandom of="$file" bs=64 count=1 conv=notrunc seek=$((RANDOM % 50)) ;;
      3) rm -f "$file" ;;
    esac 2>/dev/null
    sleep 0.0$((RANDOM % 10))
  done
}

on_changed_input() {
  local name=$1 output=$2 spoiler i
  shift 2
  [[ $name != multi_frame_simulator ]] || return 0
  for ((i = 0; i < (40 + stride - 1) / stride; ++i)); do
    spoil_inputs &
    spoiler=$!
    attempt "$name, inputs change" "0 2 3 5" "$colmap" "$name" "$@"
    kill "$spoiler"
    wait "$spoiler" 2>/dev/null || true
    no_rests "$name, inputs change"
    rm -rf "$data"
    cp -r "$work/original" "$data"
    [[ $name != multi_frame_rig_converter ]] || break
  done
}

# With other outputs: bad input that can be read may end in another good result.
changed_input() {
  cp -r "$data" "$work/original"
  cp -r "$results" "$work/kept"
  commands on_changed_input
  rm -rf "$results" "$work/original"
  mv "$work/kept" "$results"
}

on_two_runs() {
  local name=$1 output=$2 before first=0 second=0
  shift 2
  # What an input that changed has left may be the result of that input.
  attempt "$name" 0 "$colmap" "$name" "$@"
  before=$(digest "$output")
  "$colmap" "$name" "$@" >/dev/null 2>"$work/first.txt" &
  attempt "$name, two runs" "0 4" "$colmap" "$name" "$@"
  second=$code
  wait $! || first=$?
  [[ $first -eq 0 || $first -eq 4 ]] || fail "$name, two runs: $first: $(cat "$work/first.txt")"
  [[ $first -eq 0 || $second -eq 0 ]] || fail "$name, two runs: both failed: $(cat "$work/first.txt")"
  unchanged "$name, two runs" "$output"
}

two_runs() { commands on_two_runs; }

# limited ULIMIT_OPTIONS COMMAND...: in a shell whose limits end with it.
limited() {
  local option=$1 value=$2
  shift 2
  (ulimit "$option" "$value" && exec "$@")
}
export -f limited

on_little_memory() {
  local name=$1 output=$2 before kilobytes
  shift 2
  before=$(digest "$output")
  for ((kilobytes = least; kilobytes < 3 * least; kilobytes += least * stride / 30 + 1)); do
    attempt "$name, $kilobytes KB" "0 3" bash -c 'limited -v "$@"' - "$kilobytes" "$colmap" "$name" "$@"
    unchanged "$name, $kilobytes KB" "$output"
  done
}

# From what the program needs to be loaded on, which varies a little.
memory() {
  local least=100000
  until bash -c 'limited -v "$@"' - "$least" "$colmap" multi_frame_simulator --help >/dev/null 2>&1; do
    least=$((least + 5000))
    ((least < 4000000)) || fail "the program does not start"
  done
  least=$((least + least / 20))
  commands on_little_memory
}

on_few_files() {
  local name=$1 output=$2 before
  shift 2
  before=$(digest "$output")
  attempt "$name, 16 open files" 0 bash -c 'limited -n "$@"' - 16 "$colmap" "$name" "$@"
  unchanged "$name, 16 open files" "$output"
}

few_files() { commands on_few_files; }

# The same results in folders, and of frames, of other names.
names() {
  local name part i=0 original=$data reference=$results
  for name in "$(printf 'n%.0s' {1..255})" $'line\nbreak' "it's \"quoted\" & <b>" \
    $'\xff\xfe not UTF-8' '$(touch escaped); *?' '-rf' '#1 = [x]'; do
    ((i++ % (stride > 1 ? 3 : 1) == 0)) || continue
    for part in folder frame; do
      data=$work/names/data
      results=$work/names/results
      if [[ $part == folder ]]; then
        data=$work/names/$name/data
        results=$work/names/$name/results
      fi
      mkdir -p "${data%/*}"
      cp -r "$original" "$data"
      if [[ $part == frame ]]; then
        mv "$data/frames/frame000001" "$data/frames/$name"
        mv "$data/images/frame000001" "$data/images/$name"
      fi
      commands whole_run
      no_rests "the name $name"
      # The choice of held-out tracks depends on the names of frames.
      [[ $part == frame || $(digest "$results/out/rig") == $(digest "$reference/out/rig") ]] ||
        fail "$part $name: another result"
      rm -rf "$work/names"
    done
  done
  data=$original
  results=$reference
}

data=$work/data
results=$work/results
mkdir "$results"
attempt simulator 0 "$colmap" multi_frame_simulator --output_path "$data" \
  --Simulator.num_cameras 5 --Simulator.num_frames 2 --Simulator.num_points 150 \
  --Simulator.image_width 320 --Simulator.image_height 240
attempt refiner 0 "$colmap" multi_frame_intrinsics_refiner --input_path "$data/frames" \
  --extrinsics_path "$data/rig" --output_path "$data/out"
commands whole_run
for fault in "${faults[@]}"; do
  num_runs=0
  SECONDS=0
  "$fault"
  echo "$fault: $num_runs runs, $SECONDS s"
done

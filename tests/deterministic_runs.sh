#!/bin/bash
# The same input gives the same bytes: with 1, 2 and 7 threads, and with the cameras,
# images, points and frames of the input in another order (where COLMAP writes the
# points of a frame in that order, too). For all commands, but for the preset `paper`,
# whose solver (Ceres) sums in the order in which threads come.
#
#   tests/deterministic_runs.sh COLMAP
set -euo pipefail

colmap=$1
work=$(mktemp -d)
colmap=$(realpath "$colmap")
trap 'rm -rf "$work"' EXIT
num_runs=0
permuted=false

run() {
  "$colmap" "$@" >"$work/log.txt" 2>&1 || {
    echo "FAILED: $*: $(tail -n 5 "$work/log.txt")" >&2
    exit 1
  }
  num_runs=$((num_runs + 1))
}

# content FILE: without times, memory and paths.
content() {
  case $1 in
    */summary.json)
      jq -S 'del(.timings_s, .cpu_s, .peak_rss_bytes, .created, .options, .inputs, .stages[].time_s)' "$1"
      ;;
    */triangulation.json) jq -S 'del(.timings_s, .inputs)' "$1" ;;
    */history.csv) cut -d , -f 1-3,5- "$1" ;;
    */frames/*/points3D.bin) if $permuted; then stat -c %s "$1"; else cat "$1"; fi ;;
    *) cat "$1" ;;
  esac
}

# digest FOLDER: names and contents of all files.
digest() {
  (
    cd "$1"
    find . -type f ! -name report.html ! -name database.db ! -name project.ini | sort |
      while read -r file; do echo "$(content "$file" | sha256sum) $file"; done
  )
}

# same WHAT FOLDER: as $work/reference/NAME, where NAME is the folder's.
same() {
  local reference
  reference=$work/reference/$(basename "$2")
  [[ $(digest "$2") == $(digest "$reference") ]] || {
    echo "FAILED: $1: $2 differs:" >&2
    diff <(digest "$reference") <(digest "$2") | grep '^>' >&2
    exit 1
  }
}

# all_commands THREADS DATA OUT: every command on the capture DATA.
all_commands() {
  local threads=$1 data=$2 out=$3 type
  mkdir -p "$out/rigs" "$out/evaluation"
  run multi_frame_triangulator --image_path "$data/images" --extrinsics_path "$data/rig" \
    --output_path "$out/frames" --MultiFrameTriangulator.num_threads "$threads"
  run multi_frame_intrinsics_refiner --input_path "$data/frames" \
    --extrinsics_path "$data/rig" --output_path "$out/out" --MultiFrame.num_threads "$threads"
  run multi_frame_intrinsics_refiner --input_path "$data/frames" --image_path "$data/images" \
    --extrinsics_path "$data/rig" --output_path "$out/out_with_images" \
    --MultiFrame.dense_features sift --MultiFrame.num_threads "$threads"
  run multi_frame_automatic_refiner --image_path "$data/images" \
    --extrinsics_path "$data/rig" --workspace_path "$out/automatic" \
    --MultiFrame.num_threads "$threads" --MultiFrameTriangulator.num_threads "$threads"
  run multi_frame_evaluator --input_path "$out/out" --ground_truth_path "$data/ground_truth" \
    --output_path "$out/evaluation/evaluation.json"
  for type in colmap rig_config krt opencv transforms metashape panoptic csv kalibr multical; do
    run multi_frame_rig_converter --input_path "$data/ground_truth" \
      --output_path "$out/rigs/$type" --output_type "$type"
  done
  # Of one result, whose times are in it.
  (cd "$data" && run multi_frame_reporter --input_path out --output_path "$out/evaluation/page")
}

# simulate THREADS OUT
simulate() {
  run multi_frame_simulator --output_path "$2" --Simulator.num_cameras 6 \
    --Simulator.num_frames 3 --Simulator.num_points 200 --Simulator.image_width 320 \
    --Simulator.image_height 240 --Simulator.num_threads "$1"
}

# reverse_model FOLDER: cameras, images and points of the text model in the opposite
# order.
reverse_model() {
  local name
  for name in cameras points3D; do
    grep -v '^#' "$1/$name.txt" | tac >"$work/reversed.txt" || true
    mv "$work/reversed.txt" "$1/$name.txt"
  done
  # Two lines each, of which the second may be empty.
  grep -v '^#' "$1/images.txt" | paste -d '\v' - - | tac | tr '\v' '\n' >"$work/reversed.txt"
  mv "$work/reversed.txt" "$1/images.txt"
}

# permute FROM TO: the capture in another order of everything.
permute() {
  local frame model image
  mkdir -p "$2"
  cp -r "$1/rig" "$1/ground_truth" "$1/out" "$2"
  reverse_model "$2/rig"
  reverse_model "$2/ground_truth"
  for frame in $(ls -r "$1/frames"); do
    model=$2/frames/$frame/sparse/0
    mkdir -p "$model"
    run model_converter --input_path "$1/frames/$frame/sparse/0" --output_path "$model" \
      --output_type TXT
    reverse_model "$model"
    mkdir -p "$2/images/$frame"
    for image in $(ls -r "$1/images/$frame"); do
      cp "$1/images/$frame/$image" "$2/images/$frame"
    done
  done
}

simulate 1 "$work/reference/capture"
capture=$work/reference/capture
run multi_frame_intrinsics_refiner --input_path "$capture/frames" \
  --extrinsics_path "$capture/rig" --output_path "$capture/out"
for threads in 2 7; do
  simulate "$threads" "$work/$threads/capture"
  rm -rf "${work:?}/$threads/capture/out"
  [[ $(digest "$work/$threads/capture") == $(cd "$capture" && mv out ../aside && digest . && mv ../aside out) ]] || {
    echo "FAILED: another capture with $threads threads" >&2
    exit 1
  }
done
permute "$capture" "$work/permuted_capture"
all_commands 1 "$capture" "$work/reference/results"
all_commands 2 "$capture" "$work/2/results"
same "2 threads" "$work/2/results"
all_commands 7 "$capture" "$work/7/results"
same "7 threads" "$work/7/results"
permuted=true
all_commands 7 "$work/permuted_capture" "$work/permuted/results"
same "another order of the input" "$work/permuted/results"
echo "$num_runs runs, same bytes"

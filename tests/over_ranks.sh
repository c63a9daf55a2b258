#!/bin/bash
# over_ranks.sh COLMAP: three processes under mpirun give what one process gives,
# and when one of them fails or dies the run ends with one line and an exit code.
set -euo pipefail

colmap=$1
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"

fail() {
  echo "FAILED: $*" >&2
  exit 1
}

# As root and with more processes than processors, as in a container.
ranks() {
  mpirun -q --allow-run-as-root --oversubscribe --bind-to none -n "$@"
}

quiet=(--Simulator.quiet 1 --Simulator.num_cameras 8 --Simulator.num_frames 7)
"$colmap" multi_frame_simulator --output_path capture "${quiet[@]}" \
  --Simulator.image_width 320 --Simulator.image_height 240
"$colmap" multi_frame_simulator --output_path tracks "${quiet[@]}" \
  --Simulator.render_images 0 --Simulator.num_points 300

# Frames from images: the same bytes, whichever process makes them.
triangulate=(multi_frame_triangulator --image_path capture/images
  --extrinsics_path capture/rig --MultiFrameTriangulator.num_threads 1)
"$colmap" "${triangulate[@]}" --output_path frames_1 >log.txt 2>&1 ||
  fail "$(cat log.txt)"
ranks 3 "$colmap" "${triangulate[@]}" --output_path frames_3 >log.txt 2>&1 ||
  fail "$(cat log.txt)"
diff -r --exclude triangulation.json --exclude database.db frames_1 frames_3 ||
  fail "frames differ"
[[ $(grep -c "^Frame '" log.txt) == 7 ]] || fail "not every frame once: $(cat log.txt)"
# And again: all is done already.
ranks 2 "$colmap" "${triangulate[@]}" --output_path frames_3 >log.txt 2>&1 ||
  fail "$(cat log.txt)"
[[ $(grep -c "finished before" log.txt) == 7 ]] || fail "not finished: $(cat log.txt)"

# max_difference OUT1 OUT2 NUMBERS: the largest relative difference of these numbers
# of two results, NUMBERS a list in jq. What is null has to be so in both.
max_difference() {
  jq -rs "[[.[0] | $3], [.[1] | $3]]"' | transpose
    | map(if .[0] == null and .[1] == null then [0, 0] else . end)
    | map((.[0] - .[1]) / ([(.[1] | fabs), 1e-300] | max) | fabs) | max' \
    "$1/summary.json" "$2/summary.json"
}

# expect_close WHAT MAX OUT1 OUT2 NUMBERS
expect_close() {
  local difference
  difference=$(max_difference "${@:3}")
  awk -v difference="$difference" -v max="$2" 'BEGIN { exit !(difference <= max) }' ||
    fail "$1: $difference in the stead of $2"
  echo "$1: largest relative difference $difference"
}

refine=(multi_frame_intrinsics_refiner --extrinsics_path tracks/rig
  --MultiFrame.num_threads 1)
for input in tracks/frames frames_1; do
  # Without new tracks: these are taken or not at limits, where the last digits can
  # decide about one.
  [[ $input != frames_1 ]] ||
    refine=("${refine[@]/tracks\/rig/capture\/rig}" --MultiFrame.retriangulation_rounds 0)
  "$colmap" "${refine[@]}" --input_path "$input" --output_path out_1 >log.txt 2>&1 ||
    fail "$(cat log.txt)"
  for num in 2 3; do
    ranks $num "$colmap" "${refine[@]}" --input_path "$input" \
      --output_path out_n >log.txt 2>&1 || fail "$(cat log.txt)"
    name="$input, $num processes"
    expect_close "$name, intrinsics" 1e-9 out_1 out_n '.cameras[].params[]'
    # Points stop within their own tolerance, to which these are more sensitive.
    expect_close "$name, what is said of them" 1e-5 out_1 out_n '(.cameras[]
      | .params_std[], .rms_px_before, .rms_px_after), (.result | .rms_px_before,
        .rms_px_after, .held_out_rms_px, .noise_std_px, .outlier_share, .max_inlier_px)'
    expect_close "$name, counts" 0 out_1 out_n '(.frames[] | .num_images, .num_points,
      .num_observations, .alignment_rms), (.cameras[] | .num_frames, .num_observations),
      (.result.static_points | .num_points, .num_tracks, .observation_share)'
    [[ $(find out_n/frames -name points3D.bin | wc -l) == 7 ]] || fail "frames are missing"
    [[ -f out_n/report.html && ! -e out_n/.unfinished ]] || fail "$(ls -a out_n)"
    [[ $(jq '.peak_rss_bytes_of_processes | length' out_n/summary.json) == "$num" ]] ||
      fail "memory of processes"
  done
done

# expect CODE TEXT COMMAND...: one ERROR line with the text.
expect() {
  local code=0
  "${@:3}" >log.txt 2>&1 || code=$?
  [[ $code == "$1" ]] || fail "exit code $code in the stead of $1: $(cat log.txt)"
  [[ $(grep -c ERROR log.txt) == 1 ]] || fail "not one line: $(cat log.txt)"
  grep -q "ERROR: .*$2" log.txt || fail "no '$2': $(cat log.txt)"
}

refine[2]=tracks/rig
expect 1 "cannot do this together" ranks 2 "$colmap" "${refine[@]}" --input_path tracks/frames \
  --output_path out_2 --MultiFrame.preset paper
expect 1 "start no more processes than frames" ranks 8 "$colmap" "${refine[@]}" \
  --input_path tracks/frames --output_path out_2
expect 1 "runs as one process" ranks 2 "$colmap" multi_frame_evaluator --input_path out_1 \
  --ground_truth_path tracks/rig
# A bad frame of one process only.
cp -r tracks/frames damaged
last=$(find damaged -mindepth 1 -maxdepth 1 | sort | tail -n 1)
find "$last" -name 'points3D.*' -exec truncate -s 100 {} +
expect 2 "$(basename "$last")" ranks 3 "$colmap" "${refine[@]}" --input_path damaged \
  --output_path out_2
[[ ! -e out_2/summary.json && ! -e out_2/.unfinished ]] || fail "$(ls -a out_2)"

# A process that dies takes the run with it; frames that are finished stay.
rm -rf frames_3
ranks 3 "$colmap" "${triangulate[@]}" --output_path frames_3 >log.txt 2>&1 &
mpirun=$!
until find frames_3 -name triangulation.json 2>/dev/null | grep -q . || ! kill -0 $mpirun 2>/dev/null; do
  sleep 0.1
done
victim=$(pgrep -P $mpirun -f multi_frame_triangulator | tail -n 1 || true)
if [[ -n $victim ]]; then
  kill -KILL "$victim"
  code=0
  wait $mpirun || code=$?
  ((code != 0)) || fail "exit code 0 although a process was killed"
  finished=$(find frames_3 -name triangulation.json | wc -l)
  ((finished > 0)) || fail "no finished frame is left"
  ranks 3 "$colmap" "${triangulate[@]}" --output_path frames_3 >log.txt 2>&1 ||
    fail "$(cat log.txt)"
  (($(grep -c "finished before" log.txt) >= finished)) || fail "frames were made again"
  diff -r --exclude triangulation.json --exclude database.db --exclude .unfinished \
    frames_1 frames_3 || fail "frames differ after a death"
  echo "a killed process: exit code $code, $finished finished frames kept"
fi

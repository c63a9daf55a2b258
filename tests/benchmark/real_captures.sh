#!/bin/bash
# Accuracy on the real captures of the data folder, against their published
# calibrations: start, `accurate` with 1, 2, 5 and 10 frames, `paper`, and the
# repeatability over disjoint halves of the frames.
#
#   tests/benchmark/real_captures.sh [DATA_FOLDER]
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd -P)
colmap=${MFIR_COLMAP:-$root/build/bin/colmap}
data=${1:-${MFIR_DATA_DIR:-$root/../shared/data}}
[[ -d $data ]] || {
  echo "SKIPPED: there is no data folder $data" >&2
  exit 0
}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

# metrics FILE.json: one line of the evaluation.
metrics() {
  awk -F'[:,]' '
    /"(focal_rel|pp_abs)": \{/ { key = $1; gsub(/[ "]/, "", key); next }
    /"(common|rest)": \{/ { group = $1; gsub(/[ "]/, "", group) }
    /"(focal_scale_permille|pp_shift_x_px|pp_shift_y_px)": \{/ { key = $1; gsub(/[ "]/, "", key); next }
    /"mean"/ && key != "" { printf "%s%s %.3f  ", group == "rest" ? "rest_" : "", key, $2; key = "" }
    END { print "" }' "$1"
}

# number KEY FILE: the first number of the key in a JSON file.
number() {
  sed -n "s/.*\"$1\": \([-0-9.e]*\).*/\1/p" "$2" | head -n 1
}

# evaluate NAME INPUT TRUTH
evaluate() {
  "$colmap" multi_frame_evaluator --input_path "$2" --ground_truth_path "$3" \
    --output_path "$work/evaluation.json" >"$work/log.txt"
  printf '%-36s ' "$1"
  metrics "$work/evaluation.json"
}

# refine NAME FRAMES RIG FIRST COUNT [OPTION...]: evaluates, keeps the result.
refine() {
  find "$2" -mindepth 1 -maxdepth 1 -printf '%f\n' | sort |
    tail -n "+$4" | head -n "$5" >"$work/list.txt"
  "$colmap" multi_frame_intrinsics_refiner --input_path "$2" \
    --frame_list_path "$work/list.txt" --extrinsics_path "$3" \
    --output_path "$work/$1" "${@:6}" >"$work/log.txt"
  evaluate "$1" "$work/$1" "$3"
  printf '%-36s rms_after %.3f  held_out_rms %s px\n' "" \
    "$(sed -n '/"result"/,$p' "$work/$1/summary.json" >"$work/result.json" &&
      number rms_px_after "$work/result.json")" \
    "$(number held_out_rms_px "$work/result.json")"
}

set_path=$data/panoptic31
echo "panoptic31 (31 cameras)"
evaluate start "$set_path/frames_triangulated" "$set_path/calibration"
for count in 1 2 5 10; do
  refine "accurate_${count}_frames" "$set_path/frames_triangulated" \
    "$set_path/calibration" 1 "$count"
done
sift=(--image_path "$set_path/images")
refine sift_1_frames "$set_path/frames_triangulated" \
  "$set_path/calibration" 1 1 "${sift[@]}"
refine sift_10_frames "$set_path/frames_triangulated" \
  "$set_path/calibration" 1 10 "${sift[@]}"
refine paper_10_frames "$set_path/frames_triangulated" \
  "$set_path/calibration" 1 10 --MultiFrame.preset paper
refine frames_1-5 "$set_path/frames_triangulated" "$set_path/calibration" 1 5
refine frames_6-10 "$set_path/frames_triangulated" "$set_path/calibration" 6 5
evaluate "repeatability 1-5 against 6-10" "$work/frames_1-5" "$work/frames_6-10/rig"
refine sift_frames_1-5 "$set_path/frames_triangulated" \
  "$set_path/calibration" 1 5 "${sift[@]}"
refine sift_frames_6-10 "$set_path/frames_triangulated" \
  "$set_path/calibration" 6 5 "${sift[@]}"
evaluate "sift repeatability 1-5 against 6-10" "$work/sift_frames_1-5" \
  "$work/sift_frames_6-10/rig"

set_path=$data/robovision12
echo "robovision12 (12 cameras)"
refine triangulated "$set_path/frames_triangulated" "$set_path/calibration" 1 8
refine sfm "$set_path/frames_sfm" "$set_path/calibration" 1 8
refine frames_1-4 "$set_path/frames_triangulated" "$set_path/calibration" 1 4
refine frames_5-8 "$set_path/frames_triangulated" "$set_path/calibration" 5 4
evaluate "repeatability 1-4 against 5-8" "$work/frames_1-4" "$work/frames_5-8/rig"
# The published extrinsics are not exact: 0.02 degrees, 0.1 mm.
soft=(--MultiFrame.extrinsics_rotation_std_deg 0.02
  --MultiFrame.extrinsics_translation_std 0.0001)
refine soft_triangulated "$set_path/frames_triangulated" \
  "$set_path/calibration" 1 8 "${soft[@]}"
refine soft_frames_1-4 "$set_path/frames_triangulated" \
  "$set_path/calibration" 1 4 "${soft[@]}"
refine soft_frames_5-8 "$set_path/frames_triangulated" \
  "$set_path/calibration" 5 4 "${soft[@]}"
evaluate "soft repeatability 1-4 against 5-8" "$work/soft_frames_1-4" \
  "$work/soft_frames_5-8/rig"
sift=(--image_path "$set_path/images")
refine sift_frames_1-4 "$set_path/frames_triangulated" \
  "$set_path/calibration" 1 4 "${soft[@]}" "${sift[@]}"
refine sift_frames_5-8 "$set_path/frames_triangulated" \
  "$set_path/calibration" 5 4 "${soft[@]}" "${sift[@]}"
evaluate "soft sift repeatability 1-4 against 5-8" "$work/sift_frames_1-4" \
  "$work/sift_frames_5-8/rig"

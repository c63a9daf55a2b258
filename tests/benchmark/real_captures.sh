#!/bin/bash
# Accuracy on the real captures of the data folder, against their published
# calibrations: start, `accurate` with 1, 2, 5 and 10 frames, `paper`, and the
# repeatability over disjoint halves of the frames, with the static background
# kept, merged and dropped.
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

# in_stds NAME OUT1 OUT2: rms of the differences of focal lengths and principal
# points (PINHOLE), each in units of its reported standard deviation.
in_stds() {
  awk -v name="$1" '
    /"params": \[/ { key = "params"; i = 0; next }
    /"params_std": \[/ { key = "std"; i = 0; next }
    /\]/ { if (key == "std") ++camera[FILENAME]; key = ""; next }
    key != "" { value[FILENAME, key, camera[FILENAME] + 0, i++] = $1 + 0 }
    END {
      a = ARGV[1]; b = ARGV[2]
      for (c = 0; c < camera[a]; ++c)
        for (i = 0; i < 4; ++i)
          sum[i < 2] += (value[a, "params", c, i] - value[b, "params", c, i])^2 / \
                        (value[a, "std", c, i]^2 + value[b, "std", c, i]^2)
      printf "%-36s focal lengths %.2f, principal points %.2f stds\n", name,
             sqrt(sum[1] / camera[a] / 2), sqrt(sum[0] / camera[a] / 2)
    }' "$2/summary.json" "$3/summary.json"
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
  printf '%-36s rms_after %.3f  held_out_rms %s px  static %s\n' "" \
    "$(sed -n '/"result"/,$p' "$work/$1/summary.json" >"$work/result.json" &&
      number rms_px_after "$work/result.json")" \
    "$(number held_out_rms_px "$work/result.json")" \
    "$(number observation_share "$work/result.json")"
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
for treatment in merge keep drop; do
  static_points=(--MultiFrame.static_points "$treatment")
  refine "${treatment}_10_frames" "$set_path/frames_triangulated" \
    "$set_path/calibration" 1 10 "${static_points[@]}"
  refine "${treatment}_1-5" "$set_path/frames_triangulated" \
    "$set_path/calibration" 1 5 "${static_points[@]}"
  refine "${treatment}_6-10" "$set_path/frames_triangulated" \
    "$set_path/calibration" 6 5 "${static_points[@]}"
  evaluate "$treatment: 1-5 against 6-10" "$work/${treatment}_1-5" \
    "$work/${treatment}_6-10/rig"
  in_stds "$treatment: 1-5 against 6-10" "$work/${treatment}_1-5" \
    "$work/${treatment}_6-10"
done
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
for treatment in merge keep drop; do
  static_points=(--MultiFrame.static_points "$treatment")
  refine "soft_${treatment}_1-4" "$set_path/frames_triangulated" \
    "$set_path/calibration" 1 4 "${soft[@]}" "${static_points[@]}"
  refine "soft_${treatment}_5-8" "$set_path/frames_triangulated" \
    "$set_path/calibration" 5 4 "${soft[@]}" "${static_points[@]}"
  evaluate "soft $treatment: 1-4 against 5-8" "$work/soft_${treatment}_1-4" \
    "$work/soft_${treatment}_5-8/rig"
  in_stds "soft $treatment: 1-4 against 5-8" "$work/soft_${treatment}_1-4" \
    "$work/soft_${treatment}_5-8"
done
sift=(--image_path "$set_path/images")
refine sift_frames_1-4 "$set_path/frames_triangulated" \
  "$set_path/calibration" 1 4 "${soft[@]}" "${sift[@]}"
refine sift_frames_5-8 "$set_path/frames_triangulated" \
  "$set_path/calibration" 5 4 "${soft[@]}" "${sift[@]}"
evaluate "soft sift repeatability 1-4 against 5-8" "$work/sift_frames_1-4" \
  "$work/sift_frames_5-8/rig"

# shellcheck shell=bash
# Sourced by the scripts here that run the built program on captures: $colmap, and
# the scratch folder $work.

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd -P)
colmap=${MFIR_COLMAP:-$root/build/bin/colmap}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

# The published extrinsics of robovision12 are not exact: 0.02 degrees, 0.1 mm.
# shellcheck disable=SC2034
soft=(--MultiFrame.extrinsics_rotation_std_deg 0.02
  --MultiFrame.extrinsics_translation_std 0.0001)

# find_data [DATA_FOLDER]: sets $data, or ends the script.
find_data() {
  data=${1:-${MFIR_DATA_DIR:-$root/../shared/data}}
  [[ -d $data ]] || {
    echo "SKIPPED: there is no data folder $data" >&2
    exit 0
  }
}

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
  printf '%-40s ' "$1"
  metrics "$work/evaluation.json"
}

# list_frames FRAMES FIRST COUNT: names of frames, one per line; FIRST from 1.
list_frames() {
  find "$1" -mindepth 1 -maxdepth 1 -type d -printf '%f\n' | sort |
    tail -n "+$2" | head -n "$3"
}

# refine NAME FRAMES RIG FIRST COUNT [OPTION...]: keeps the result in $work/NAME,
# evaluates it against RIG.
refine() {
  list_frames "$2" "$4" "$5" >"$work/list.txt"
  "$colmap" multi_frame_intrinsics_refiner --input_path "$2" \
    --frame_list_path "$work/list.txt" --extrinsics_path "$3" \
    --output_path "$work/$1" "${@:6}" >"$work/log.txt"
  evaluate "$1" "$work/$1" "$3"
  sed -n '/"result"/,$p' "$work/$1/summary.json" >"$work/result.json"
  printf '%-40s rms_after %.3f  held_out_rms %s px  static %s\n' "" \
    "$(number rms_px_after "$work/result.json")" \
    "$(number held_out_rms_px "$work/result.json")" \
    "$(number observation_share "$work/result.json")"
}

# left_out NAME FRAMES FIRST COUNT: rms of other frames with all cameras as in the
# result $work/NAME.
left_out() {
  list_frames "$2" "$3" "$4" >"$work/list.txt"
  sed -n '/^ *"cameras": \[/,/^ *"stages"/s/^ *"name": "\(.*\)",$/\1/p' \
    "$work/$1/summary.json" >"$work/cameras.txt"
  "$colmap" multi_frame_intrinsics_refiner --input_path "$2" \
    --frame_list_path "$work/list.txt" --extrinsics_path "$work/$1/rig" \
    --output_path "$work/$1_left_out" --MultiFrame.use_prior_intrinsics 1 \
    --constant_camera_list_path "$work/cameras.txt" \
    --MultiFrame.retriangulation_rounds 0 --MultiFrame.held_out_share 0 \
    >"$work/log.txt"
  sed -n '/"result"/,$p' "$work/$1_left_out/summary.json" >"$work/result.json"
  printf '%-40s rms %.4f px\n' "$1, frames left out" \
    "$(number rms_px_after "$work/result.json")"
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
      printf "%-40s focal lengths %.2f, principal points %.2f stds\n", name,
             sqrt(sum[1] / camera[a] / 2), sqrt(sum[0] / camera[a] / 2)
    }' "$2/summary.json" "$3/summary.json"
}

# halves NAME FRAMES RIG HALF [OPTION...]: repeatability of the first HALF frames
# against the next HALF, and the residuals of each under the other's cameras.
halves() {
  local first="$1_1-$4" second="$1_$(($4 + 1))-$((2 * $4))"
  refine "$first" "$2" "$3" 1 "$4" "${@:5}"
  refine "$second" "$2" "$3" $(($4 + 1)) "$4" "${@:5}"
  evaluate "$1: repeatability" "$work/$first" "$work/$second/rig"
  in_stds "$1: repeatability" "$work/$first" "$work/$second"
  left_out "$first" "$2" $(($4 + 1)) "$4"
  left_out "$second" "$2" 1 "$4"
}

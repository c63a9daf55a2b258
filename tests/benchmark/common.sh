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
  jq -r '
    [(to_entries[] | select(.key == "focal_rel" or .key == "pp_abs")),
     (.common // {} | to_entries[]),
     (.rest // {} | to_entries[] | .key = "rest_" + .key)]
    | map(select(.value | type == "object" and has("mean")))
    | map(select(.key | test("focal_rel|pp_abs|focal_scale_permille|pp_shift_[xy]_px")))[]
    | "\(.key) \(.value.mean)"' "$1" | awk '{ printf "%s %.3f  ", $1, $2 } END { print "" }'
}

# number KEY FILE: the first of that key in the file, or in its field "result".
number() {
  jq -r --arg key "$1" 'first((.result // .) | .. | objects | select(has($key)) | .[$key])' "$2"
}

# evaluate NAME INPUT TRUTH
evaluate() {
  "$colmap" multi_frame_evaluator --input_path "$2" --ground_truth_path "$3" \
    --output_path "$work/evaluation.json" >"$work/log.txt"
  printf '%-40s ' "$1"
  metrics "$work/evaluation.json"
}

# list_frames FRAMES FIRST COUNT: names of frames, one per line; FIRST from 1. With
# $every_second, every second frame from FIRST on.
every_second=
list_frames() {
  find "$1" -mindepth 1 -maxdepth 1 -type d -printf '%f\n' | sort |
    tail -n "+$2" | awk -v step="${every_second:+2}" \
    '(NR - 1) % (step ? step : 1) == 0' | head -n "$3"
}

# refine NAME FRAMES RIG FIRST COUNT [OPTION...]: keeps the result in $work/NAME,
# evaluates it against RIG.
refine() {
  list_frames "$2" "$4" "$5" >"$work/list.txt"
  "$colmap" multi_frame_intrinsics_refiner --input_path "$2" \
    --frame_list_path "$work/list.txt" --extrinsics_path "$3" \
    --output_path "$work/$1" "${@:6}" >"$work/log.txt"
  evaluate "$1" "$work/$1" "$3"
  printf '%-40s rms_after %.3f  held_out_rms %s px  static %s\n' "" \
    "$(number rms_px_after "$work/$1/summary.json")" \
    "$(number held_out_rms_px "$work/$1/summary.json")" \
    "$(number observation_share "$work/$1/summary.json")"
}

# left_out NAME FRAMES FIRST COUNT: rms of other frames with all cameras as in the
# result $work/NAME.
left_out() {
  list_frames "$2" "$3" "$4" >"$work/list.txt"
  jq -r '.cameras[].name' "$work/$1/summary.json" >"$work/cameras.txt"
  "$colmap" multi_frame_intrinsics_refiner --input_path "$2" \
    --frame_list_path "$work/list.txt" --extrinsics_path "$work/$1/rig" \
    --output_path "$work/$1_left_out" --MultiFrame.use_prior_intrinsics 1 \
    --constant_camera_list_path "$work/cameras.txt" \
    --MultiFrame.retriangulation_rounds 0 --MultiFrame.held_out_share 0 \
    >"$work/log.txt"
  printf '%-40s rms %.4f px\n' "$1, frames left out" \
    "$(number rms_px_after "$work/$1_left_out/summary.json")"
}

# in_stds NAME OUT1 OUT2: rms of the differences of focal lengths and principal
# points (PINHOLE), each in units of its reported standard deviation.
in_stds() {
  jq -rs '
    [.[0].cameras, .[1].cameras] | transpose as $pairs
    | def rms($idxs):
        [$pairs[] | . as [$a, $b] | $idxs[] as $i
         | pow($a.params[$i] - $b.params[$i]; 2) /
           (pow($a.params_std[$i]; 2) + pow($b.params_std[$i]; 2))]
        | add / length | sqrt;
      "\(rms([0, 1])) \(rms([2, 3]))"' "$2/summary.json" "$3/summary.json" |
    awk -v name="$1" '{
      printf "%-40s focal lengths %.2f, principal points %.2f stds\n", name, $1, $2 }'
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

# interleaved NAME FRAMES RIG HALF [OPTION...]: the same for the odd frames against
# the even ones, HALF of each.
interleaved() {
  local every_second=1
  refine "$1_odd" "$2" "$3" 1 "$4" "${@:5}"
  refine "$1_even" "$2" "$3" 2 "$4" "${@:5}"
  evaluate "$1: repeatability" "$work/$1_odd" "$work/$1_even/rig"
  in_stds "$1: repeatability" "$work/$1_odd" "$work/$1_even"
  left_out "$1_odd" "$2" 2 "$4"
  left_out "$1_even" "$2" 1 "$4"
}

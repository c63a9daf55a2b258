#!/bin/bash
# Lenses with distortion, from raw images and a wrong calibration: simulates a
# capture with images, makes the first distortion parameter of all cameras wrong by
# 0.05 (beside the drift of focal lengths and principal points), triangulates,
# refines, and prints the mean absolute error of every parameter before and after,
# and that of the whole lens model (the evaluator's projection rms).
#
#   tests/benchmark/wrong_distortion.sh [MODEL [SEED [CAMERAS [FRAMES
#     [refiner options...]]]]]
#
# MODEL: OPENCV (default), RADIAL, OPENCV_FISHEYE, ...
set -euo pipefail
# shellcheck source=tests/benchmark/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
model=${1:-OPENCV}
seed=${2:-0}
num_cameras=${3:-16}
num_frames=${4:-4}
shift $(($# < 4 ? $# : 4))
case $model in
  SIMPLE_RADIAL* | RADIAL*) names=(f cx cy) ;;
  *) names=(fx fy cx cy) ;;
esac

# Close cameras with short lenses, so that the object fills the images: 0.05 moves
# their corners by 5 px.
"$colmap" multi_frame_simulator --output_path "$work/capture" \
  --Simulator.camera_model "$model" --Simulator.seed "$seed" \
  --Simulator.distance 0.3 --Simulator.focal_length 800 \
  --Simulator.num_cameras "$num_cameras" \
  --Simulator.num_frames "$num_frames" \
  --Simulator.image_width 640 --Simulator.image_height 480 \
  --Simulator.initial_distortion_sigma 0 --Simulator.quiet 1
k1=$((5 + ${#names[@]}))
awk -v k1="$k1" '!/^#/ { $k1 += 0.05 } { print }' OFMT=%.17g CONVFMT=%.17g \
  "$work/capture/rig/cameras.txt" >"$work/cameras.txt"
mv "$work/cameras.txt" "$work/capture/rig/cameras.txt"

TIMEFORMAT='user CPU s: %U'
time "$colmap" multi_frame_triangulator --image_path "$work/capture/images" \
  --extrinsics_path "$work/capture/rig" --output_path "$work/frames"
time "$colmap" multi_frame_intrinsics_refiner --input_path "$work/frames" \
  --extrinsics_path "$work/capture/rig" --output_path "$work/result" "$@" |
  grep -E 'Round|improvement|Frame|px after'

# params MODEL_FOLDER: per image its name and the parameters of its camera.
params() {
  awk '/^#/ { next }
    FNR == NR { id = $1; $1 = $2 = $3 = $4 = ""; of[id] = $0; next }
    NF == 10 { print $10 of[$9] }' "$1/cameras.txt" "$1/images.txt" | sort
}

# errors MODEL_FOLDER: mean absolute error of each parameter.
errors() {
  join <(params "$work/capture/ground_truth") <(params "$1") |
    awk '{ n = (NF - 1) / 2
        for (i = 2; i <= n + 1; ++i) sum[i] += $i > $(i + n) ? $i - $(i + n) : $(i + n) - $i }
      END { for (i = 2; i <= n + 1; ++i) printf "%.6f ", sum[i] / NR }'
}

# grid MODEL_FOLDER: projection rms, mean and maximum over cameras.
grid() {
  "$colmap" multi_frame_evaluator --input_path "$1" \
    --ground_truth_path "$work/capture/ground_truth" |
    awk '/projection rms/ { print $4, $5 }'
}

read -r -a before <<<"$(errors "$work/capture/rig") $(grid "$work/capture/rig")"
read -r -a after <<<"$(errors "$work/result/rig") $(grid "$work/result/rig")"
case $model in
  *FISHEYE | THIN* | FULL*) extra=(k1 k2 k3 k4) ;;
  *) extra=(k1 k2 p1 p2) ;;
esac
[[ $model != THIN* ]] || extra=(k1 k2 p1 p2 k3 k4 sx1 sy1)
[[ $model != FULL* ]] || extra=(k1 k2 p1 p2 k3 k4 k5 k6)
names+=("${extra[@]:0:${#before[@]}-2-${#names[@]}}" 'grid, rms (px)' 'grid, worst camera')
printf '%-20s %12s %12s\n' "$model, seed $seed" before after
for i in "${!names[@]}"; do
  printf '%-20s %12.5f %12.5f\n' "${names[i]}" "${before[i]}" "${after[i]}"
done

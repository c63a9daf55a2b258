#!/bin/bash
# Sets up this machine as far as needed, builds the colmap program, and goes from
# images and drifted intrinsics to refined ones, on a simulated capture whose true
# intrinsics are known exactly.
set -euo pipefail
# shellcheck source=scripts/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"

usage() {
  cat <<USAGE
Usage: scripts/quickstart.sh [OPTIONS]

Installs missing packages, builds the colmap program, simulates the images of a
camera array, triangulates frames from them with the known extrinsics, refines
the intrinsics, and compares them with the true ones before and after.

Options:
  --output_path DIR    where to write (default: quickstart in the build folder)
$(common_options)
USAGE
}

output_path=
while (($#)); do
  # The only one without a value.
  [[ $1 != --mpi ]] || { MPI=1 && shift && continue; }
  if [[ $1 == --output_path ]]; then
    [[ -n ${2-} ]] || usage_error "$1 needs a folder"
    output_path=$(realpath -m "$2")
  else
    parse_common_option "$@"
  fi
  shift 2
done

# json_mean FILE KEY: of an evaluation; null is nan.
json_mean() {
  jq -r ".$2.mean // \"nan\"" "$1"
}

# print_row TEXT UNIT KEY
print_row() {
  printf '  %-28s %12.3f %12.3f   %s\n' "$1" "$(json_mean "$before" "$3")" \
    "$(json_mean "$after" "$3")" "$2"
}

set_up colmap_program

colmap=$BUILD_PATH/bin/colmap
output_path=${output_path:-$BUILD_PATH/quickstart}
capture=$output_path/capture
frames=$output_path/frames
refined=$output_path/refined
before=$output_path/evaluation_before.json
after=$output_path/evaluation_after.json
make_folder "$output_path" --output_path

# A capture made by this very program would come out the same again.
if [[ ! $capture -nt $colmap ]]; then
  rm -rf "$frames"
  "$colmap" multi_frame_simulator --output_path "$capture" --Simulator.overwrite 1 ||
    die "the simulation failed with exit code $?, see above"
fi
"$colmap" multi_frame_triangulator --image_path "$capture/images" \
  --extrinsics_path "$capture/rig" --output_path "$frames" ||
  die "the triangulation failed with exit code $?, see above"
"$colmap" multi_frame_intrinsics_refiner --input_path "$frames" \
  --image_path "$capture/images" --extrinsics_path "$capture/rig" \
  --ground_truth_path "$capture/ground_truth" --output_path "$refined" ||
  die "the refinement failed with exit code $?, see above"
run_step "Evaluating the start" evaluator_before \
  "$colmap" multi_frame_evaluator --input_path "$capture/rig" \
  --ground_truth_path "$capture/ground_truth" --output_path "$before"
run_step "Evaluating the result" evaluator_after \
  "$colmap" multi_frame_evaluator --input_path "$refined" \
  --ground_truth_path "$capture/ground_truth" --output_path "$after"

printf '\n  %-28s %12s %12s\n' 'Mean error of the cameras' before after
print_row 'focal length' px focal_abs
print_row 'focal length, relative' permille focal_rel
print_row 'principal point' px pp_abs
print_row 'principal point, relative' permille pp_rel
cat <<WRITTEN

Written:
  $capture
    the simulated capture: images, rig (known extrinsics, drifted intrinsics),
    ground_truth
  $frames
    per frame a database and a sparse model
  $refined
    the result: rig, frames, KRT, summary.json, history.csv, project.ini, report.html
  $before
  $after
    the evaluations
Program: $colmap

Open the report in a browser:
  $refined/report.html
WRITTEN

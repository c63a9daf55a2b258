#!/bin/bash
# colmap4_workflow.sh COLMAP_PROGRAM: what a user of COLMAP 4's rigs does, from
# images to COLMAP's own commands on OUT/model. Exit code 77 with COLMAP 3.8.
set -euo pipefail
colmap=$1

[[ $("$colmap" help) != "COLMAP 3."* ]] || { echo "skipped: COLMAP 3.8 has no rigs" && exit 77; }
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
mkdir sparse adjusted undistorted text

fail() {
  echo "FAILED: $*"
  exit 1
}

# run COMMAND OPTIONS...: one of COLMAP's or ours; its output only if it fails.
run() {
  "$colmap" "$@" >log.txt 2>&1 || { cat log.txt && fail "$*"; }
  echo "ok: $1"
}

# has_all_images MODEL: that the model has one rig with all frames and images.
has_all_images() {
  run model_analyzer --path "$1" --log_target stderr
  local line
  for line in "Rigs: 1" "Cameras: 8" "Registered frames: 2" "Registered images: 16"; do
    grep -q "$line\$" log.txt || { cat log.txt && fail "$1 has not '$line'"; }
  done
}

run multi_frame_simulator --output_path capture --Simulator.num_cameras 8 --Simulator.num_frames 2 \
  --Simulator.azimuth 60 --Simulator.image_width 400 --Simulator.image_height 300
# A folder per camera, the layout of COLMAP's rigs.
for image in capture/images/*/*; do
  frame=$(basename "$(dirname "$image")")
  camera=$(basename "$image" .png)
  mkdir -p "images/$camera"
  cp "$image" "images/$camera/$frame.png"
done

run multi_frame_rig_converter --input_path capture/rig --output_path rig.json --output_type rig_config
run feature_extractor --database_path database.db --image_path images --FeatureExtraction.use_gpu 0 \
  --ImageReader.single_camera_per_folder 1 --ImageReader.camera_model PINHOLE \
  --SiftExtraction.max_num_features 600 --log_target stderr
run rig_configurator --database_path database.db --rig_config_path rig.json --log_target stderr
run exhaustive_matcher --database_path database.db --FeatureMatching.use_gpu 0 --log_target stderr
run mapper --database_path database.db --image_path images --output_path sparse \
  --Mapper.ba_refine_sensor_from_rig 0 --log_target stderr
has_all_images sparse/0

run multi_frame_intrinsics_refiner --input_path sparse/0 --image_path images --extrinsics_path capture/rig \
  --ground_truth_path capture/ground_truth --output_path refined
# What two small frames say about the common focal scale depends on the mapper's choices.
jq -e '(.evaluation.common.focal_scale_permille.mean | fabs) < 3.5 * .result.modes.common_focal_scale_std_permille and
  .result.modes.common_focal_scale_std_permille < 1 and .evaluation.pp_abs.mean < 0.5' refined/summary.json >log.txt ||
  { jq .evaluation refined/summary.json && fail "the refined intrinsics are wrong"; }

has_all_images refined/model
run bundle_adjuster --input_path refined/model --output_path adjusted \
  --BundleAdjustment.refine_sensor_from_rig 0 --log_target stderr
has_all_images adjusted
run image_undistorter --image_path images --input_path refined/model --output_path undistorted \
  --log_target stderr
has_all_images undistorted/sparse
(($(find undistorted/images -name '*.png' | wc -l) == 16)) || fail "image_undistorter wrote not all images"
run model_converter --input_path refined/model --output_path text --output_type TXT --log_target stderr

# The rig keeps the known extrinsics: every image of OUT/model has the pose that its camera has in RIG.
poses() {
  grep -E '\.png$' "$1" | sed -E 's/\/frame[0-9]+\.png$/.png/' | awk '{ print $10, $2, $3, $4, $5, $6, $7, $8 }' | sort
}
poses refined/rig/images.txt >rig_poses.txt
poses text/images.txt | awk '
  NR == FNR { for (i = 2; i <= 8; ++i) pose[$1, i] = $i; next }
  { for (i = 2; i <= 8; ++i) if (($i - pose[$1, i])^2 > 1e-24) bad = 1; ++num }
  END { exit bad || num != 16 }' rig_poses.txt - || fail "poses of refined/model are not those of the rig"
echo "passed"

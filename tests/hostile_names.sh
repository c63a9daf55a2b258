#!/bin/bash
# Names in inputs that are paths, and links where results are written: whatever a
# command does with them, nothing outside of its output changes.
#
#   tests/hostile_names.sh COLMAP [STRIDE]
#
#   STRIDE   every how many names and links are tried; default 1
set -euo pipefail

colmap=$1
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
export TMPDIR=$work/tmp
mkdir "$TMPDIR"
# Outputs are three folders deep, so that ../../x is still in $work.
inside=$work/a/b/c
names=('../../escaped' "$work/escaped" '..' '.' 'a/../../../escaped' '~/escaped' '$(touch escaped)'
  '`touch escaped`' '-rf' "';touch_escaped;'" '<script>alert(1)</script>' '{{7*7}}' '%n%s' 'CON')
stride=${2:-1}
num_runs=0
num_planted=0

fail() {
  echo "FAILED: $*" >&2
  exit 1
}

# All that is not output, by name, kind and content.
outside() {
  (cd "$work" && find . -path ./a/b/c -prune -o ! -name stderr.txt -printf '%p %y %l\n' | sort &&
    find . -path ./a/b/c -prune -o -type f ! -name stderr.txt -exec sha256sum {} + | sort)
}

# run WHAT CODES COMMAND...: ends with one of the exit codes, and changes nothing
# outside.
run() {
  local what=$1 codes=$2 before code=0
  shift 2
  before=$(outside)
  (cd "$inside" && timeout 100 "$colmap" "$@") >/dev/null 2>"$work/stderr.txt" </dev/null || code=$?
  num_runs=$((num_runs + 1))
  [[ " $codes " == *" $code "* ]] || fail "$what: $1: exit code $code: $(cat "$work/stderr.txt")"
  diff <(echo "$before") <(outside) >&2 || fail "$what: $1 has changed what is outside"
  ! find "$work" -name escaped -o -name touch_escaped | grep . >&2 || fail "$what: $1 has made that"
}

tried=()
for ((i = 0; i < ${#names[@]}; i += stride)); do tried+=("${names[i]}"); done

# Each camera's name in the rig, in a format that names cameras, and each image's.
rig_named() {
  rm -rf "$work/in"
  mkdir "$work/in"
  sed "1s,.*,${1//&/\\&}," "$work/data/KRT" >"$work/in/KRT"
  cp -r "$work/data/rig" "$work/in/rig"
  sed -i "s, cam00\.png$, ${1//&/\\&}," "$work/in/rig/images.txt"
}

cameras_and_images() {
  local name type
  for name in "${tried[@]}"; do
    rig_named "$name"
    rm -rf "$inside" && mkdir -p "$inside"
    for type in colmap rig_config krt opencv transforms metashape panoptic csv kalibr multical; do
      run "camera $name" "0 2 4" multi_frame_rig_converter --input_path "$work/in/KRT" \
        --output_path "$inside/$type" --output_type "$type"
      run "image $name" "0 2 4" multi_frame_rig_converter --input_path "$work/in/rig" \
        --output_path "$inside/$type" --output_type "$type"
    done
    run "image $name" "0 2" multi_frame_intrinsics_refiner --input_path "$work/data/frames" \
      --extrinsics_path "$work/in/rig" --output_path "$inside/out" \
      --MultiFrame.output_types krt,opencv,csv
    run "camera $name" "0 2" multi_frame_triangulator --image_path "$work/data/images" \
      --extrinsics_path "$work/in/KRT" --output_path "$inside/frames"
  done
}

# Images of one model, whose names say the frame.
frames() {
  local name
  mkdir "$work/data/text"
  "$colmap" model_converter --input_path "$work/data/frames/frame000000/sparse/0" \
    --output_path "$work/data/text" --output_type TXT >/dev/null
  for name in "${tried[@]}"; do
    # The text format knows no spaces.
    [[ $name != *' '* ]] || continue
    rm -rf "$work/in" "$inside" && mkdir -p "$work/in" "$inside"
    cp -r "$work/data/text" "$work/in/model"
    sed -i -E "s,[^ ]*(cam[0-9]+\.png)$,${name//&/\\&}/\1," "$work/in/model/images.txt"
    run "frame $name" "0 2" multi_frame_intrinsics_refiner --input_path "$work/in/model" \
      --extrinsics_path "$work/data/rig" --output_path "$inside/out"
    run "frame $name by regex" "0 2" multi_frame_intrinsics_refiner --input_path "$work/in/model" \
      --extrinsics_path "$work/data/rig" --output_path "$inside/out_regex" \
      --MultiFrame.frame_name_regex '(.*)/cam' --MultiFrame.camera_name_regex '(cam\d+)'
    printf '%s\n' "$name" >"$work/in/list.txt"
    run "listed frame $name" "0 2" multi_frame_triangulator --image_path "$work/data/images" \
      --extrinsics_path "$work/data/rig" --output_path "$inside/frames" \
      --frame_list_path "$work/in/list.txt"
  done
}

# Names in options, and in a result that is read again.
options() {
  local name
  rm -rf "$work/in" "$inside" && mkdir -p "$work/in" "$inside"
  for name in "${tried[@]}"; do
    run "output type $name" "1" multi_frame_intrinsics_refiner --input_path "$work/data/frames" \
      --extrinsics_path "$work/data/rig" --output_path "$inside/out" --MultiFrame.output_types "$name"
    cp -r "$work/data/out" "$inside/result"
    jq --arg name "$name" '.frames[0].name = $name | .cameras[0].name = $name | .inputs.image_path = $name' \
      "$work/data/out/summary.json" >"$inside/result/summary.json"
    run "result with $name" "0 2" multi_frame_reporter --input_path "$inside/result" \
      --compare_path "$inside/result"
    ! grep -q '<script>alert' "$inside/result/report.html" || fail "$name is markup in report.html"
    rm -rf "$inside/result"
  done
}

# planted LINK COMMAND...: a link to a file and to a folder, by that name, before it runs.
planted() {
  local link=$1 target
  shift
  ((num_planted++ % stride == 0)) || return 0
  for target in "$work/victims/file" "$work/victims/folder"; do
    rm -rf "$inside" && mkdir -p "$inside"
    cp -r "$work/data/out" "$inside/out"
    cp -r "$work/frames" "$inside/frames"
    mkdir -p "$(dirname "$inside/$link")"
    rm -rf "${inside:?}/$link"
    ln -s "$target" "$inside/$link"
    run "link $link" "0 1 2 4" "$@"
  done
}

links() {
  local name
  mkdir -p "$work/victims/folder"
  echo "keep me" | tee "$work/victims/file" >"$work/victims/folder/file"
  "$colmap" multi_frame_triangulator --image_path "$work/data/images" --extrinsics_path "$work/data/rig" \
    --output_path "$work/frames" >/dev/null
  for name in rig frames KRT summary.json history.csv project.ini report.html model .unfinished \
    not_converged opencv frames/frame000000; do
    planted "out/$name" multi_frame_intrinsics_refiner --input_path "$work/data/frames" \
      --extrinsics_path "$work/data/rig" --output_path "$inside/out" --MultiFrame.output_types opencv
  done
  for name in "" /sparse /sparse/0 /database.db /triangulation.json /.unfinished; do
    planted "frames/frame000000$name" multi_frame_triangulator --image_path "$work/data/images" \
      --extrinsics_path "$work/data/rig" --output_path "$inside/frames" \
      --MultiFrameTriangulator.overwrite 1
  done
  for name in report.html report.html.tmp report.html.unfinished; do
    planted "out/$name" multi_frame_reporter --input_path "$inside/out"
  done
  for name in evaluation.json evaluation.json.unfinished; do
    planted "$name" multi_frame_evaluator --input_path "$inside/out" \
      --ground_truth_path "$work/data/ground_truth" --output_path "$inside/evaluation.json"
  done
  for name in KRT KRT.unfinished; do
    planted "$name" multi_frame_rig_converter --input_path "$work/data/rig" \
      --output_path "$inside/KRT" --output_type krt
  done
  for name in rig/intri.yml rig.unfinished; do
    planted "$name" multi_frame_rig_converter --input_path "$work/data/ground_truth" \
      --output_path "$inside/rig" --output_type opencv
  done
  for name in capture capture.mfir_partial capture.mfir_old; do
    planted "$name" multi_frame_simulator --output_path "$inside/capture" --Simulator.overwrite 1 \
      --Simulator.num_cameras 5 --Simulator.num_frames 1 --Simulator.num_points 60 \
      --Simulator.render_images 0
  done
}

mkdir -p "$inside"
"$colmap" multi_frame_simulator --output_path "$work/data" --Simulator.num_cameras 5 \
  --Simulator.num_frames 2 --Simulator.num_points 150 --Simulator.image_width 320 \
  --Simulator.image_height 240 >/dev/null
"$colmap" multi_frame_intrinsics_refiner --input_path "$work/data/frames" \
  --extrinsics_path "$work/data/rig" --output_path "$work/data/out" >/dev/null
for part in cameras_and_images frames options links; do
  num_runs=0
  "$part"
  echo "$part: $num_runs runs"
done

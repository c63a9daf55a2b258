#!/bin/bash
# check_layout_test.sh PROJECT_ROOT: check_layout.sh must find planted mistakes.
set -euo pipefail
root=$1
copy=$(mktemp -d)
trap 'rm -rf "$copy"' EXIT

# expect_failure TEXT FILE LINE: LINE added to FILE in a copy of the project.
expect_failure() {
  rm -rf "${copy:?}"/*
  cp -r "$root"/{src,colmap_ext,cuda,tests} "$copy"
  mkdir -p "$(dirname "$copy/$2")"
  echo "$3" >>"$copy/$2"
  if output=$("$root/tests/check_layout.sh" "$copy"); then
    echo "not found: $3 in $2"
    exit 1
  fi
  grep -qF "$1" <<<"$output" || {
    echo "'$1' is not in: $output"
    exit 1
  }
}

expect_failure "points up" src/util/errors.h '#include "src/scene/scene.h"'
expect_failure "points up" src/scene/scene.h '#include "colmap_ext/host/camera.h"'
expect_failure "points up" colmap_ext/models/model_io.h '#include "colmap_ext/exe/command.h"'
expect_failure "no file of the project" colmap_ext/models/model_io.cc '#include "base/camera.h"'
expect_failure "installed COLMAP" colmap_ext/models/model_io.cc '#include <colmap/base/camera.h>'
expect_failure "belong to colmap_ext/host" colmap_ext/models/model_io.cc '// colmap::Camera'
expect_failure "belong to colmap_ext/host" tests/io/model_io_test.cc '#if MFIR_COLMAP_MAJOR > 3'
expect_failure "is no room" src/misc/new.h '#include <vector>'
expect_failure "tests mirror" tests/misc/new_test.cc '#include <vector>'
expect_failure "several headers define Selection" src/dense/dense_features.h 'struct Selection {'

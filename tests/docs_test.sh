#!/bin/bash
# docs_test.sh COLMAP_PROGRAM PROJECT_ROOT DOCUMENT: runs the blocks ```sh run of a
# document, and what its comments <!-- setup ... --> have, in order, in an empty
# folder, with the program as `colmap`.
set -euo pipefail

program=$(realpath "$1")
document=$2/docs/$3
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
mkdir "$folder/bin" "$folder/work"
ln -s "$program" "$folder/bin/colmap"

# The n-th line of the script is the n-th line of the document.
awk '/^<!-- setup$/ || /^```sh run$/ { inside = 1; blocks++; print "#"; next }
  /^-->$/ || /^```$/ { inside = 0 }
  { print inside ? $0 : "#" }
  END { if (!blocks) exit 1 }' "$document" >"$folder/script.sh" ||
  { echo "$document has no block to run" && exit 1; }
grep -c '^```sh run$' "$document" | sed 's/$/ blocks/'
cd "$folder/work"
# Threads that spin slow a busy machine down.
export PATH="$folder/bin:$PATH" OMP_WAIT_POLICY=passive
bash -euo pipefail "$folder/script.sh" ||
  { echo "$document: a command of it has failed, see above" && exit 1; }

#!/bin/bash
# check_layout.sh [PROJECT_ROOT]: fails when src/ or cuda/ includes a COLMAP
# header, or colmap_ext/ includes one outside of its compat.h. A quoted include
# must therefore be a file of the folders that the including file may use: no
# list of COLMAP's folder names, which change between versions, is needed.
set -euo pipefail
cd "${1:-$(dirname "${BASH_SOURCE[0]}")/..}"

status=0
num_includes=0

# check FOLDER ALLOWED_FOLDER...
check() {
  local folder=$1 file line include path allowed
  shift
  while IFS=: read -r file line include; do
    num_includes=$((num_includes + 1))
    [[ $file != colmap_ext/compat.h && $include =~ [\<\"]([^\>\"]*) ]] || continue
    path=${BASH_REMATCH[1]}
    if [[ $include == *\<* ]]; then
      # System headers, unless of an installed COLMAP.
      [[ $path != *colmap/* ]] && continue
    else
      for allowed in "$@"; do
        [[ -f $allowed/$path || ($path == "$allowed"/* && -f $path) ]] && continue 2
      done
    fi
    echo "$file:$line: $folder/ may not include $path (allowed: files of $*)"
    status=1
  done < <(grep -rnE '^[[:space:]]*#[[:space:]]*include[[:space:]]*[<"]' "$folder")
}

check src src cuda
if [[ -d cuda ]]; then
  check cuda src cuda
fi
check colmap_ext colmap_ext src cuda

if ((num_includes == 0)); then
  echo "no include found at all: is '$PWD' the project's folder?"
  exit 1
fi
((status)) || echo "$num_includes includes checked"
exit "$status"

#!/bin/bash
# check_layout.sh [PROJECT_ROOT]: fails when an include points up in the order of
# the rooms below, when it names a file that is not the project's (COLMAP's headers
# are colmap_ext/host's alone), when COLMAP's names or its version stand outside of
# colmap_ext/host, when two headers define a class of one name, or when a test lies in
# no room.
set -euo pipefail
cd "${1:-$(dirname "${BASH_SOURCE[0]}")/..}"

# Bottom to top. A room may include itself and those before it.
rooms=(
  src/util src/parallel src/geometry src/sensor src/scene src/selection cuda src/dense src/patches
  src/feature src/residuals src/estimators src/evaluation src/report src/report_page src/refinement
  src/simulation
  colmap_ext/host colmap_ext/io colmap_ext/models colmap_ext/rig_formats colmap_ext/rigs colmap_ext/options
  colmap_ext/feature colmap_ext/frames colmap_ext/simulation
  colmap_ext/controllers colmap_ext/report colmap_ext/refinement colmap_ext/result colmap_ext/exe
)
status=0
num_includes=0

fail() {
  echo "$1"
  status=1
}

# Variables in the stead of output: a process for each include would take seconds.
declare -A rank
for i in "${!rooms[@]}"; do rank[${rooms[i]}]=$i; done

# find_room FILE: sets room to its folder; the sides of the host for the versions of
# COLMAP are one.
find_room() {
  room=${1%/*}
  [[ $room != colmap_ext/host/v[0-9] ]] || room=colmap_ext/host
}

check_include() {
  local file=$1 line=$2 include=$3 room path from
  find_room "$file"
  from=$room
  path=${include#*[<\"]}
  path=${path%%[>\"]*}
  if [[ $include == *\<* ]]; then
    [[ $path != *colmap/* ]] || fail "$file:$line: $path is a header of an installed COLMAP"
    return
  fi
  if [[ ! -f $path ]]; then
    [[ $from == colmap_ext/host ]] ||
      fail "$file:$line: $path is no file of the project; COLMAP's headers belong to colmap_ext/host"
    return
  fi
  # The launchers and the maths that they launch know each other.
  [[ $from != cuda || ($path != src/dense/* && $path != src/patches/*) ]] || return 0
  find_room "$path"
  if [[ -z ${rank[$room]-} ]] || ((rank[$room] > rank[$from])); then
    fail "$file:$line: $from may not include $path: it points up"
  fi
}

for folder in src colmap_ext cuda; do
  while IFS=: read -r file line include; do
    num_includes=$((num_includes + 1))
    find_room "$file"
    if [[ -z ${rank[$room]-} ]]; then
      fail "$file: ${file%/*} is no room"
      continue
    fi
    check_include "$file" "$line" "$include"
  done < <(grep -rnE '^[[:space:]]*#[[:space:]]*include[[:space:]]*[<"]' "$folder")
done
while IFS=: read -r file line text; do
  [[ $file != colmap_ext/host/* ]] || continue
  fail "$file:$line: names of COLMAP and its version belong to colmap_ext/host: $text"
done < <(grep -rnE '\<(colmap::|MFIR_COLMAP_MAJOR)' --include='*.h' --include='*.cc' src colmap_ext tests)
while IFS= read -r file; do
  room=$(basename "$(dirname "$file")")
  [[ -n ${rank[src/$room]-}${rank[colmap_ext/$room]-} ]] ||
    fail "$file: tests mirror the rooms, and there is no room $room"
done < <(find tests -name '*_test.cc')

# The linker would take the functions of one for both.
while IFS= read -r name; do
  fail "several headers define $name: $(grep -rlE "^(struct|class) $name\\>" --include='*.h' src colmap_ext cuda | tr '\n' ' ')"
done < <(grep -rhoE '^(struct|class) [A-Za-z0-9_]+( final)?( :| \{|$)' --include='*.h' src colmap_ext cuda |
  awk '{ print $2 }' | sort | uniq -d)

if ((num_includes == 0)); then
  echo "no include found at all: is '$PWD' the project's folder?"
  exit 1
fi
((status)) || echo "$num_includes includes checked"
exit "$status"

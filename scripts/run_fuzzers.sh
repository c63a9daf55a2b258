#!/bin/bash
# Builds the fuzzer of all readers (clang, libFuzzer) and runs it on each of them.
set -euo pipefail
# shellcheck source=scripts/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
# Not among the packages of common.sh: nothing else needs clang.
PACKAGES+=(clang libclang-rt-dev libomp-dev)
SECONDS_EACH=60

usage() {
  cat <<USAGE
Usage: scripts/run_fuzzers.sh [OPTIONS] [SECONDS [READER...]]

Runs the fuzzer for SECONDS (default $SECONDS_EACH) on each reader (default: all).
Starts from the examples of the tests, tests/fuzz/corpus and what earlier runs
have found, and prints a line per reader: runs, runs per second, edges of the
code that were reached. An input that ends the program, takes 10 s or 2 GB is
kept in BUILD/findings, and the exit code is 1.

Options:
$(common_options)
USAGE
}

# dictionary READER: its file.
dictionary() {
  local name=next_file
  case $1 in
    model_* | rig_colmap) name=model ;;
    rig_opencv | rig_kalibr) name=yaml ;;
    rig_metashape) name=xml ;;
    rig_* | summary) name=json ;;
    *_sql) name=sql ;;
    names | ini) name=$1 ;;
  esac
  echo "$MFIR_ROOT/tests/fuzz/dictionaries/$name.dict"
}

# fuzz READER: prints its line; false if there is a finding.
fuzz() {
  local reader=$1 log=$BUILD_PATH/logs/$1.log found=$BUILD_PATH/corpus/$1 kept result=0
  kept=$MFIR_ROOT/tests/fuzz/corpus/$reader
  mkdir -p "$found" "$BUILD_PATH/findings"
  [[ -d $kept ]] || kept=
  # Allocations that fail are what readers have to bear. Short traces and a small
  # quarantine of freed memory: faster by a quarter.
  local sanitizer=allocator_may_return_null=0:detect_leaks=0:malloc_context_size=4:quarantine_size_mb=8
  ASAN_OPTIONS=$sanitizer "$BUILD_PATH/bin/mfir_fuzzer" \
    --target="$reader" -max_total_time="$SECONDS_EACH" \
    -timeout=10 -rss_limit_mb=2048 -malloc_limit_mb=1024 -max_len=20000 -print_final_stats=1 \
    -dict="$(dictionary "$reader")" -artifact_prefix="$BUILD_PATH/findings/$reader-" \
    "$found" ${kept:+"$kept"} "$BUILD_PATH/seeds/$reader" >"$log" 2>&1 || result=1
  awk -v reader="$reader" '/^#.* cov: /{for (i = 1; i < NF; ++i) if ($i == "cov:") edges = $(i + 1)}
    /stat::number_of_executed_units/{runs = $2} /stat::average_exec_per_sec/{rate = $2}
    END {printf "%-22s %10d runs %7d per second %6d edges\n", reader, runs, rate, edges}' "$log"
  ((result == 0)) || grep -m 1 -E 'ERROR|runtime error|terminate|what\(\)' "$log" || tail -n 3 "$log"
  return $result
}

while (($#)) && [[ $1 == -* ]]; do
  parse_common_option "$@"
  shift 2
done
(($# == 0)) || { SECONDS_EACH=$1 && shift; }

set_up_preset fuzz mfir_fuzzer
# Each run writes its input to a file; in memory where that is possible.
TMPDIR=$(mktemp -d -p "$([[ -w /dev/shm ]] && echo /dev/shm || echo "${TMPDIR:-/tmp}")")
export TMPDIR
trap 'rm -rf "$TMPDIR"' EXIT
rm -rf "$BUILD_PATH/seeds"
"$BUILD_PATH/bin/mfir_fuzzer" --seeds="$BUILD_PATH/seeds"
(($#)) || mapfile -t readers < <("$BUILD_PATH/bin/mfir_fuzzer" --names)
(($# == 0)) || readers=("$@")
status=0
for reader in "${readers[@]}"; do fuzz "$reader" || status=1; done
exit $status

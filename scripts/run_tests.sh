#!/bin/bash
# Sets up this machine as far as needed, builds everything, runs all tests.
set -euo pipefail
# shellcheck source=scripts/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"

PRESET=

usage() {
  cat <<USAGE
Usage: scripts/run_tests.sh [OPTIONS] [-- CTEST_OPTIONS]

Installs missing packages, builds the colmap program and the tests, and runs
all tests (or those that ctest's own options choose, as in: -- -R rig).

Options:
  --sanitize WHICH     address (and undefined behaviour) or thread: build the
                       project's own code with it, in BUILD/asan or BUILD/tsan
$(common_options)
USAGE
}

while (($#)); do
  [[ $1 != -- ]] || { shift && break; }
  # The only one without a value.
  [[ $1 != --mpi ]] || { MPI=1 && shift && continue; }
  case $1:${2-} in
    --sanitize:address) PRESET=asan ;;
    --sanitize:thread) PRESET=tsan ;;
    --sanitize:*) usage_error "--sanitize must be address or thread" ;;
    *) parse_common_option "$@" ;;
  esac
  shift 2
done

if [[ -n $PRESET ]]; then
  set_up_preset "$PRESET" colmap_program mfir_tests
else
  set_up colmap_program mfir_tests
fi
cd "$BUILD_PATH"
ctest --output-on-failure "$@"

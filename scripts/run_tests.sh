#!/bin/bash
# Sets up this machine as far as needed, builds everything, runs all tests.
set -euo pipefail
# shellcheck source=scripts/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"

usage() {
  cat <<USAGE
Usage: scripts/run_tests.sh [OPTIONS] [-- CTEST_OPTIONS]

Installs missing packages, builds the colmap program and the tests, and runs
all tests (or those that ctest's own options choose, as in: -- -R rig).

Options:
$(common_options)
USAGE
}

while (($#)); do
  [[ $1 != -- ]] || { shift && break; }
  # The only one without a value.
  [[ $1 != --mpi ]] || { MPI=1 && shift && continue; }
  parse_common_option "$@"
  shift 2
done

set_up colmap_program mfir_tests
cd "$BUILD_PATH"
ctest --output-on-failure "$@"

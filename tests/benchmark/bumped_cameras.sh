#!/bin/bash
# Is a camera that was bumped named? Turns one camera of RIG of simulated captures
# by 0.2, 0.5 and 2 degrees, in arrays of 8, 16 and 38 cameras, and counts in how
# many runs it gets a flag, and how often others get one; then the false alarms of
# healthy captures drawn at random.
#
#   tests/benchmark/bumped_cameras.sh [--seeds N] [--healthy M]
#
# Needs python3 (its standard library only).
set -euo pipefail
# shellcheck source=tests/benchmark/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
python3 -B "$root/tests/benchmark/bumped_cameras.py" --program "$colmap" --work "$work" "$@"

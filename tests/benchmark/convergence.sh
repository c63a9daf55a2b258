#!/bin/bash
# How often does the refiner end well? Runs it on captures drawn at random and
# prints, per set, exit codes, iterations, errors and CPU time, and how to repeat
# each draw that failed. A draw depends on nothing but its seed and the set.
#
#   tests/benchmark/convergence.sh [OPTION...] [CAPTURE_FOLDER...] [-- refiner options...]
#
#   CAPTURE_FOLDER   frames, with RIG in ../calibration or ../rig: random frames of
#                    it, sometimes converted to another camera model. Default: the
#                    real captures of the data folder MFIR_DATA_DIR
#   --draws N        draws of each CAPTURE_FOLDER; default 30
#   --simulated M    simulated captures; default 60, 0 beside a CAPTURE_FOLDER
#   --seed S         seed of the first draw; default 0
#   --only SEED      one draw of each set, with the commands and the log
#   --perturb        each draw again with keypoints moved by 1e-9 px, and with all
#                    that has no order shuffled in the files: the intrinsics must
#                    not change by 1e-3 of a standard deviation
#   --csv FILE       one line per draw
#   --keep FOLDER    where inputs and results of the draws stay
#
# Needs python3 (its standard library only).
set -euo pipefail
# shellcheck source=tests/benchmark/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
python3 -B "$root/tests/benchmark/convergence.py" --program "$colmap" --work "$work" \
  --data "${MFIR_DATA_DIR:-$root/../shared/data}" --soft "${soft[*]}" "$@"

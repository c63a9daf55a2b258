#!/bin/bash
# options_docs_test.sh COLMAP_PROGRAM PROJECT_ROOT: every option of our own sections
# that --help lists is in a document, and every command's --help says what it does,
# with an example.
set -euo pipefail
status=0
num_options=0
for command in $("$1" help | grep -oE 'multi_frame_[a-z_]+' | sort -u); do
  help=$("$1" "$command" --help)
  grep -q '^Example:' <<<"$help" || { echo "$command --help has no example" && status=1; }
  while IFS= read -r option; do
    num_options=$((num_options + 1))
    # Options of the simulator are for practice: --help is their document.
    [[ $option != Simulator.* ]] || continue
    if ! grep -rqE "(^|[^a-z_])${option##*.}([^a-z_]|$)" "$2/docs"; then
      echo "$command: --$option is in no document"
      status=1
    fi
  done < <(grep -oE '^  --[A-Za-z_.]+' <<<"$help" | sed 's/^  --//' |
    grep -E '^(MultiFrame|MultiFrameTriangulator)\.' || true)
done
((num_options > 50)) || { echo "only $num_options options found" && exit 1; }
((status)) || echo "$num_options options checked"
exit "$status"

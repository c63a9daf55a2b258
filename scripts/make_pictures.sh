#!/bin/bash
# make_pictures.sh [RESULT]: the pictures of the documentation, docs/*.png, from the
# report of a result (default: that of the quick start). Needs Chromium.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)
result=$(realpath "${1:-$root/build/quickstart/refined}")
browser=${MFIR_BROWSER:-$(command -v chromium || command -v chromium-browser ||
  { echo "error: there is no chromium" >&2 && exit 1; })}
[[ -f $result/report.html ]] || { echo "error: there is no $result/report.html" >&2 && exit 1; }
profile=$(mktemp -d)
trap 'rm -rf "$profile"' EXIT

# picture NAME WIDTH HEIGHT ANCHOR
picture() {
  "$browser" --headless --no-sandbox --disable-gpu --hide-scrollbars --no-first-run \
    --user-data-dir="$profile" --virtual-time-budget=5000 --window-size="$2,$3" \
    --screenshot="$root/docs/$1.png" "file://$result/report.html$4" >/dev/null 2>&1
  ls -l "$root/docs/$1.png"
}

picture report 1000 1500 ""
picture report_verdict 900 560 ""
picture report_camera 900 620 "#camera-0"

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

# picture NAME WIDTH HEIGHT STYLE: of the page with this style added.
picture() {
  sed "s|</head>|<style>${4//$'\n'/}</style></head>|" "$result/report.html" >"$profile/page.html"
  "$browser" --headless --no-sandbox --disable-gpu --hide-scrollbars --no-first-run \
    --user-data-dir="$profile/chromium" --virtual-time-budget=5000 --window-size="$2,$3" \
    --screenshot="$root/docs/$1.png" "file://$profile/page.html" >/dev/null 2>&1
  ls -l "$root/docs/$1.png"
}

# The verdict, the array, and one camera.
picture report 1080 1430 "section{display:none}#verdict,#array,#cameras{display:block}
  .note,#cameras>p,#cameras>h2,#array>p,.array .buttons,.card+.card,nav{display:none}.array canvas{height:22rem}"
picture report_verdict 900 520 ""
picture report_camera 1080 560 "header,nav,section,#cameras>h2,#cameras>p,.card{display:none}nav{display:none!important}
  #cameras,#camera-0{display:block}#camera-0{border:0}"

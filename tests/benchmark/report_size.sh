#!/bin/bash
# Size of report.html of a large array, time to write it, and time until a browser
# has opened it (Chromium, headless; skipped without).
#
#   tests/benchmark/report_size.sh [CAMERAS] [FRAMES] [POINTS]
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
num_cameras=${1:-160}
num_frames=${2:-100}
num_points=${3:-300}

"$colmap" multi_frame_simulator --output_path "$work/capture" \
  --Simulator.num_cameras "$num_cameras" --Simulator.num_frames "$num_frames" \
  --Simulator.num_points "$num_points" --Simulator.render_images 0 --Simulator.quiet 1
"$colmap" multi_frame_intrinsics_refiner --input_path "$work/capture/frames" \
  --extrinsics_path "$work/capture/rig" --output_path "$work/out" \
  --MultiFrame.num_threads 2 --MultiFrame.report 0 --MultiFrame.quiet 1
TIMEFORMAT='written in %U user s'
time "$colmap" multi_frame_reporter --input_path "$work/out" >"$work/log.txt"
printf '%d cameras, %d frames: %.2f MB\n' "$num_cameras" "$num_frames" \
  "$(jq -n "$(stat -c %s "$work/out/report.html") / 1e6")"

browser=${MFIR_BROWSER:-$(command -v chromium || command -v chromium-browser || true)}
[[ -n $browser ]] || { echo "no chromium: opening it was not measured" && exit 0; }
# After the page's own script, with the layout of all of it: the time since the
# navigation began.
sed 's|</body>|<pre id="opened"></pre><script>addEventListener("load", function () {\
  var height = document.documentElement.scrollHeight;\
  document.getElementById("opened").textContent =\
    "opened in " + Math.round(performance.now()) + " ms, " + height + " px high";\
  });</script></body>|' "$work/out/report.html" >"$work/timed.html"
"$browser" --headless --no-sandbox --disable-gpu --user-data-dir="$work/profile" \
  --window-size=1300,900 --dump-dom "file://$work/timed.html" 2>/dev/null |
  grep -oE 'opened in [0-9]+ ms, [0-9]+ px high'

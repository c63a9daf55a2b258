"use strict";
// Turns the array: cameras and points around the origin, z up.
(function () {
  var canvas = document.getElementById("array-view");
  var data = JSON.parse(document.getElementById("array-data").textContent);
  var colors = {good: "#3ecf8e", look: "#ffb020", bad: "#ff5a4d"};
  var azimuth = 0.6, elevation = 0.45, zoom = 1, hovered = -1;
  var width = 0, height = 0;

  function project(p) {
    var ca = Math.cos(azimuth), sa = Math.sin(azimuth);
    var ce = Math.cos(elevation), se = Math.sin(elevation);
    var x = ca * p[0] + sa * p[1], y = -sa * p[0] + ca * p[1];
    var depth = 6 - (ce * y + se * p[2]);
    var scale = zoom * 2.7 * Math.min(width, height) / Math.max(depth, 0.5);
    return [width / 2 + scale * x, height / 2 - scale * (ce * p[2] - se * y), depth];
  }

  function drawCamera(context, camera, highlighted) {
    var center = project(camera.center), corners = camera.corners.map(project);
    context.strokeStyle = colors[camera.health];
    context.lineWidth = highlighted ? 3 : 1.4;
    context.beginPath();
    corners.forEach(function (corner, i) {
      var next = corners[(i + 1) % 4];
      context.moveTo(center[0], center[1]);
      context.lineTo(corner[0], corner[1]);
      context.lineTo(next[0], next[1]);
    });
    context.stroke();
    if (!highlighted) return;
    context.font = "14px system-ui, sans-serif";
    context.fillStyle = "#fff";
    context.fillText(camera.name, center[0] + 10, center[1] - 8);
  }

  function draw() {
    var ratio = Math.max(2, window.devicePixelRatio || 1);
    width = canvas.clientWidth || 700;
    height = canvas.clientHeight || 480;
    canvas.width = width * ratio;
    canvas.height = height * ratio;
    var context = canvas.getContext("2d");
    context.scale(ratio, ratio);
    for (var i = 0; i < data.points.length; i += 4) {
      var p = project(data.points.slice(i, i + 3));
      context.fillStyle = "#" + (0x1000000 + data.points[i + 3]).toString(16).slice(1);
      context.fillRect(p[0], p[1], 2, 2);
    }
    data.cameras.forEach(function (camera, i) {
      drawCamera(context, camera, i === hovered || camera.health === "bad");
    });
  }

  function zoomBy(factor) {
    zoom = Math.min(20, Math.max(0.2, zoom * factor));
    draw();
  }

  function hover(event) {
    var box = canvas.getBoundingClientRect(), nearest = -1, least = 400;
    data.cameras.forEach(function (camera, i) {
      var p = project(camera.center);
      var dx = p[0] - event.clientX + box.left, dy = p[1] - event.clientY + box.top;
      if (dx * dx + dy * dy < least) {
        least = dx * dx + dy * dy;
        nearest = i;
      }
    });
    if (nearest !== hovered) {
      hovered = nearest;
      draw();
    }
  }

  var pointers = new Map();
  canvas.addEventListener("pointerdown", function (event) {
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    canvas.setPointerCapture(event.pointerId);
    hover(event);
  });
  canvas.addEventListener("pointermove", function (event) {
    var last = pointers.get(event.pointerId);
    if (!last) return hover(event);
    var now = [event.clientX, event.clientY];
    if (pointers.size === 2) {
      var other = Array.from(pointers).find(function (p) { return p[0] !== event.pointerId; })[1];
      var distance = function (p) { return Math.hypot(p[0] - other[0], p[1] - other[1]); };
      pointers.set(event.pointerId, now);
      return zoomBy(distance(now) / Math.max(1, distance(last)));
    }
    azimuth += (now[0] - last[0]) * 0.008;
    elevation = Math.min(1.57, Math.max(-1.57, elevation + (now[1] - last[1]) * 0.008));
    pointers.set(event.pointerId, now);
    draw();
  });
  ["pointerup", "pointercancel"].forEach(function (name) {
    canvas.addEventListener(name, function (event) { pointers.delete(event.pointerId); });
  });
  document.querySelectorAll("[data-zoom]").forEach(function (button) {
    button.addEventListener("click", function () { zoomBy(Number(button.dataset.zoom)); });
  });
  window.addEventListener("resize", draw);
  window.addEventListener("beforeprint", draw);
  draw();
})();

// A click on a column's head sorts the table; a second one turns the order.
document.addEventListener("click", function (event) {
  var head = event.target.closest(".sortable thead th");
  if (!head) return;
  var body = head.closest("table").tBodies[0], column = head.cellIndex;
  var order = head.dataset.order === "1" ? -1 : 1;
  head.dataset.order = order;
  var key = function (row) {
    var text = row.cells[column].textContent.trim(), number = parseFloat(text);
    return isNaN(number) ? text : number;
  };
  Array.from(body.rows).sort(function (a, b) {
    var x = key(a), y = key(b);
    if (typeof x === "number" && typeof y === "number") return order * (x - y);
    return order * String(x).localeCompare(String(y));
  }).forEach(function (row) { body.appendChild(row); });
});

document.getElementById("camera-filter").addEventListener("input", function () {
  var text = this.value.toLowerCase();
  document.querySelectorAll(".card").forEach(function (card) {
    card.hidden = !card.dataset.name.toLowerCase().includes(text);
  });
  if (text) document.querySelectorAll("#cameras details").forEach(function (d) { d.open = true; });
});

// A link to something that is folded up unfolds it.
function unfold() {
  var target = document.getElementById(location.hash.slice(1));
  for (var node = target; node; node = node.parentElement) {
    if (node.tagName === "DETAILS") node.open = true;
  }
  if (target) target.scrollIntoView();
}
window.addEventListener("hashchange", unfold);
if (location.hash) unfold();

// Print has everything.
window.addEventListener("beforeprint", function () {
  document.querySelectorAll("details").forEach(function (d) { d.open = true; });
});

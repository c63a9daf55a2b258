// Runs in the report, after its own script; the answer is in #check-result.
(function () {
  var problems = window.checkErrors.slice();
  function expect(condition, text) {
    if (!condition && problems.length < 20) problems.push(text);
  }
  function at(pointer) {
    return pointer.split("/").slice(1).reduce(function (value, key) {
      return value === undefined || value === null ? undefined : value[key];
    }, window.checkSummary);
  }
  ["verdict", "changes", "array", "cameras", "residuals", "frames", "held-out", "weak-modes",
    "convergence", "examples", "static", "run"].forEach(function (id) {
    var section = document.getElementById(id);
    expect(section && section.querySelector("h2").textContent, "no section " + id);
  });
  document.querySelectorAll("nav a").forEach(function (link) {
    expect(document.querySelector(link.getAttribute("href")), "dead link " + link.href);
  });
  var fields = document.querySelectorAll("[data-field]");
  fields.forEach(function (field) {
    var value = at(field.dataset.field), shown = parseFloat(field.textContent);
    var text = field.textContent, digits = (text.split(".")[1] || "").length;
    var half = 0.5000001 * Math.pow(10, -digits);
    expect(value === Number(field.value), field.dataset.field + " is not " + field.value);
    expect(Math.abs(shown - value) <= half || Math.abs(shown - 100 * value) <= half,
      field.dataset.field + ": " + text + " is not " + value);
  });
  document.querySelectorAll("[data-text]").forEach(function (field) {
    expect(field.textContent === at(field.dataset.text),
      field.dataset.text + ": '" + field.textContent + "'");
  });
  var cameras = window.checkSummary.cameras;
  expect(fields.length > 15 * cameras.length, "only " + fields.length + " fields");
  expect(document.querySelectorAll(".card").length === cameras.length, "cards are missing");
  // Names have <u>, <xmp> and quotes in them.
  expect(document.querySelectorAll("u, xmp").length === 0, "a name has become markup");
  expect(document.querySelectorAll("svg").length > 4 * cameras.length, "pictures are missing");
  document.querySelectorAll("path, polyline").forEach(function (shape) {
    expect(!/nan|inf/.test(shape.getAttribute("d") || shape.getAttribute("points") || ""),
      "a picture has coordinates that are no numbers");
  });
  var canvas = document.getElementById("array-view");
  var pixels = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  var drawn = 0;
  for (var i = 3; i < pixels.length; i += 4) drawn += pixels[i] > 0;
  expect(drawn > 500, "the array is empty");
  expect(performance.getEntriesByType("resource").every(function (resource) {
    return resource.name.indexOf("data:") === 0;
  }), "the page loads something");
  expect(document.documentElement.scrollWidth <= window.innerWidth,
    "wider than the window: " + document.documentElement.scrollWidth + " of " + window.innerWidth);
  // Sorting, filter and unfolding.
  var table = document.querySelector("#changes .sortable");
  var head = table.tHead.rows[0].cells[1];
  head.click();
  var values = Array.from(table.tBodies[0].rows).map(function (row) {
    return parseFloat(row.cells[1].textContent);
  });
  expect(values.every(function (v, i) { return i === 0 || values[i - 1] <= v; }), "not sorted");
  var filter = document.getElementById("camera-filter");
  filter.value = cameras[0].name;
  filter.dispatchEvent(new Event("input"));
  var shown = document.querySelectorAll(".card:not([hidden])");
  expect(shown.length >= 1 && shown.length < cameras.length, "the filter does not filter");
  var pre = document.createElement("pre");
  pre.id = "check-result";
  pre.textContent = window.innerWidth + " px; " + fields.length + " fields; problems: " +
    (problems.join("; ") || "none");
  document.body.appendChild(pre);
  parent.postMessage(pre.outerHTML, "*");
})();

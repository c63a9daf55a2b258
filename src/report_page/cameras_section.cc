#include <algorithm>
#include <cmath>
#include <numeric>

#include "src/parallel/parallel_for.h"
#include "src/report/camera_figures.h"
#include "src/report/camera_maps.h"
#include "src/report/health.h"
#include "src/report/html.h"
#include "src/report_page/sections.h"

namespace mfir {
namespace {

// Up to here all cards are open on the screen.
constexpr size_t kMaxOpenCards = 40;

std::string Pointer(size_t camera_idx, const std::string& field) {
  return "/cameras/" + std::to_string(camera_idx) + "/" + field;
}

// All parameters with their standard deviations and starts.
std::string ParamsTable(const Report& report, size_t camera_idx) {
  const ReportCamera& camera = report.cameras[camera_idx];
  std::vector<std::string> names = {""};
  std::vector<std::string> now = {"now"};
  std::vector<std::string> stds = {"&plusmn;"};
  std::vector<std::string> before = {"start"};
  for (size_t i = 0; i < camera.params.size(); ++i) {
    const auto& extra = camera.model->ExtraParamsIdxs();
    const int digits =
        std::find(extra.begin(), extra.end(), i) == extra.end() ? 2 : 5;
    const std::string idx = "/" + std::to_string(i);
    names.push_back(EscapeHtml(camera.param_names[i]));
    now.push_back(
        Field(report.summary, Pointer(camera_idx, "params" + idx), digits));
    stds.push_back(
        Field(report.summary, Pointer(camera_idx, "params_std" + idx), digits));
    before.push_back(Field(
        report.summary, Pointer(camera_idx, "params_initial" + idx), digits));
  }
  return "<div class=\"scroll\"><table class=\"params\">" + Row(names, "th") +
         Row(now) + Row(stds) + Row(before) + "</table></div>\n";
}

std::string Card(const Report& report,
                 const FigureScales& scales,
                 size_t camera_idx) {
  const ReportCamera& camera = report.cameras[camera_idx];
  const std::vector<Finding> findings = CameraFindings(report, camera_idx);
  const Health health = CameraHealth(report, camera_idx);
  std::string remarks;
  for (const Finding& finding : findings) {
    // A camera's remark is never praise.
    remarks += "<li class=\"" +
               (finding.health == Health::kGood ? std::string("note")
                                                : HealthClass(finding.health)) +
               "\">" + finding.text + "</li>";
  }
  if (!remarks.empty()) {
    remarks = "<ul class=\"findings\">" + remarks + "</ul>\n";
  }
  const std::string name = EscapeHtml(camera.name);
  return "<article class=\"card\" id=\"camera-" + std::to_string(camera_idx) +
         "\" data-name=\"" + name + "\"><h3>" +
         TextField(report.summary, Pointer(camera_idx, "name")) +
         " <span class=\"badge " + HealthClass(health) + "\">" +
         HealthWord(health) + "</span></h3>\n<p>" +
         TextField(report.summary, Pointer(camera_idx, "model")) + ", " +
         Field(report.summary, Pointer(camera_idx, "width"), 0) + " &times; " +
         Field(report.summary, Pointer(camera_idx, "height"), 0) + " px; " +
         Field(report.summary, Pointer(camera_idx, "num_observations"), 0) +
         " observations in " +
         Field(report.summary, Pointer(camera_idx, "num_frames"), 0) +
         " frames; rms " +
         Field(report.summary, Pointer(camera_idx, "rms_px_before"), 2) +
         " &rarr; <b>" +
         Field(report.summary, Pointer(camera_idx, "rms_px_after"), 3) +
         " px</b></p>\n" + remarks + ParamsTable(report, camera_idx) +
         "<div class=\"figures\">" +
         ResidualFigure(report, scales, camera_idx) +
         CoverageFigure(report, scales, camera_idx) +
         UncertaintyFigure(report, scales, camera_idx) +
         DisplacementFigure(report, scales, camera_idx) +
         DistortionFigure(report, camera_idx) +
         HistoryFigure(report, camera_idx) + "</div></article>\n";
}

}  // namespace

std::string CamerasSection(const Report& report) {
  const FigureScales scales = MakeFigureScales(report);
  std::vector<size_t> order(report.cameras.size());
  std::iota(order.begin(), order.end(), 0);
  std::vector<Health> health(report.cameras.size());
  std::vector<std::string> cards(report.cameras.size());
  ParallelFor(report.cameras.size(), -1, [&](size_t i) {
    health[i] = CameraHealth(report, i);
    cards[i] = Card(report, scales, i);
  });
  std::stable_sort(order.begin(), order.end(), [&](size_t a, size_t b) {
    return static_cast<int>(health[a]) > static_cast<int>(health[b]);
  });
  std::string open;
  std::string folded;
  size_t num_open = 0;
  for (const size_t i : order) {
    const bool is_open =
        num_open < kMaxOpenCards &&
        (order.size() <= kMaxOpenCards || health[i] != Health::kGood);
    (is_open ? open : folded) += cards[i];
    num_open += is_open;
  }
  if (!folded.empty()) {
    folded = Folded("The other " + Count(order.size() - num_open) + " cameras",
                    folded);
  }
  return "<section id=\"cameras\"><h2>Each camera</h2>\n<p>Cameras with a "
         "remark come first. <b>Mean residuals</b>: how far projections lie "
         "from keypoints, averaged over each cell; arrows without a pattern "
         "are noise, a pattern means that the lens model or the pose does not "
         "fit. <b>Coverage</b>: where the points are; the lens is not measured "
         "where there are none. <b>Uncertainty</b>: standard deviation of "
         "where "
         "a known ray is seen, in its worst direction. <b>Change</b>: how far "
         "the same ray has moved in the image.</p>\n"
         "<p class=\"screen\"><label>Show cameras whose name contains <input "
         "id=\"camera-filter\" type=\"search\"></label></p>\n" +
         open + folded + "</section>\n";
}

}  // namespace mfir

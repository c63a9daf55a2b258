#include <cmath>

#include "src/report/health.h"
#include "src/report/html.h"
#include "src/report_page/sections.h"

namespace mfir {
namespace {

using Json = nlohmann::ordered_json;

// A number large enough to be read across the room.
std::string Tile(const std::string& value,
                 const std::string& unit,
                 const std::string& text) {
  return "<div class=\"tile\"><b>" + value + "<small>" + unit +
         "</small></b><span>" + text + "</span></div>\n";
}

std::string Tiles(const Report& report) {
  const Json& summary = report.summary;
  std::string tiles =
      Tile(Field(summary, "/result/rms_px_before", 2) + " &rarr; " +
               Field(summary, "/result/rms_px_after", 3),
           " px",
           "reprojection error (rms), before and after");
  if (std::isfinite(NumberAt(summary, "/result/held_out_rms_px"))) {
    tiles += Tile(Field(summary, "/result/held_out_rms_px", 3),
                  " px",
                  "on tracks that took no part");
  }
  tiles +=
      Tile(Field(summary, "/result/modes/common_focal_scale_std_permille", 2),
           " &permil;",
           "uncertainty of the common focal scale");
  size_t num_good = 0;
  for (size_t i = 0; i < report.cameras.size(); ++i) {
    num_good += CameraHealth(report, i) == Health::kGood;
  }
  tiles += Tile(Count(num_good) + " of " + Count(report.cameras.size()),
                "",
                "cameras without a remark");
  return "<div class=\"tiles\">" + tiles + "</div>\n";
}

std::string Headline(Health health, const Report& report) {
  if (health == Health::kGood) return "This calibration can be used.";
  if (health == Health::kLook) {
    return "This calibration can be used; look at the remarks below.";
  }
  return TextAt(report.summary, "/result/status") == "converged"
             ? "Some cameras of this calibration must not be used."
             : "Do not use this calibration.";
}

}  // namespace

std::string VerdictSection(const Report& report) {
  const std::vector<Finding> findings = ResultFindings(report);
  const Health health = findings.front().health;
  std::string list;
  for (const Finding& finding : findings) {
    list += "<li class=\"" + HealthClass(finding.health) + "\">" +
            finding.text + "</li>\n";
  }
  return "<section id=\"verdict\" class=\"verdict " + HealthClass(health) +
         "\"><h2>" + Headline(health, report) + "</h2>\n" + Tiles(report) +
         "<ul class=\"findings\">" + list + "</ul>\n" +
         "<p class=\"note\">These numbers assume that the extrinsics of RIG "
         "are right" +
         std::string(TextAt(report.summary, "/result/extrinsics") == "corrected"
                         ? " to the standard deviations that were given"
                         : "") +
         ". Small errors of the known poses end up in the intrinsics, and no "
         "standard deviation here contains them.</p></section>\n";
}

}  // namespace mfir

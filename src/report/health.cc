#include "src/report/health.h"

#include <algorithm>
#include <cmath>

#include "src/report/html.h"
#include "src/util/median.h"

namespace mfir {
namespace {

using Json = nlohmann::ordered_json;

// A camera's rms above this multiple of the median of all is worth a look.
constexpr double kHighRms = 2.0;
// Held-out tracks fit this much worse than fitted ones: intrinsics follow the
// noise of the tracks that they were fitted to.
constexpr double kHighHeldOut = 1.3;
// Standard deviation of the common focal scale, permille.
constexpr double kWeakFocalScale = 2.0;
// Ratio of fx to fy less 1 of the median camera, permille.
constexpr double kOddAspect = 10.0;
// Share of the cells of the image grid without any observation.
constexpr double kPoorCoverage = 0.6;

std::string CameraPointer(size_t camera_idx, const std::string& field) {
  return "/cameras/" + std::to_string(camera_idx) + "/" + field;
}

double MedianRms(const Report& report) {
  std::vector<double> rms;
  for (size_t i = 0; i < report.cameras.size(); ++i) {
    const double value =
        NumberAt(report.summary, CameraPointer(i, "rms_px_after"));
    if (std::isfinite(value)) rms.push_back(value);
  }
  return rms.empty() ? std::nan("") : Median(rms);
}

std::string FlagText(const Report& report,
                     size_t camera_idx,
                     const std::string& flag,
                     Health* health) {
  *health = Health::kLook;
  if (flag == "contradicts_extrinsics") {
    *health = Health::kBad;
    return "contradicts its pose in RIG: its intrinsics are worthless. Was it "
           "moved, or has it another camera's name?";
  }
  if (flag == "moved") {
    *health = Health::kBad;
    return "has moved: in the frames it is turned by " +
           Field(report.summary, CameraPointer(camera_idx, "moved_deg"), 2) +
           "&deg; against RIG. Correct its pose in RIG";
  }
  if (flag == "no_observations") {
    *health = Health::kBad;
    return "has no observations: its intrinsics are those of the start";
  }
  if (flag == "unusual_drift") {
    return "has changed far more than the others: was it bumped, or its focus "
           "touched?";
  }
  if (flag == "weakly_determined") {
    return "is weakly determined: too few points in its view";
  }
  if (flag == "held_at_start") {
    return "has parameters that the data do not determine; they stay at the "
           "start";
  }
  if (flag == "single_frame") {
    *health = Health::kGood;
    return "is in one frame only";
  }
  if (flag == "constant") {
    *health = Health::kGood;
    return "was held constant, as asked for";
  }
  return "has the flag " + EscapeHtml(flag);
}

double EmptyShare(const ResidualMap& map) {
  const auto num_empty = std::count_if(
      map.cells.begin(), map.cells.end(), [](const ResidualCell& c) {
        return c.num_inliers == 0;
      });
  return static_cast<double>(num_empty) / static_cast<double>(map.cells.size());
}

void SortByGravity(std::vector<Finding>* findings) {
  std::stable_sort(findings->begin(),
                   findings->end(),
                   [](const Finding& a, const Finding& b) {
                     return static_cast<int>(a.health) >
                            static_cast<int>(b.health);
                   });
}

Finding StatusFinding(const Report& report) {
  const std::string status = TextAt(report.summary, "/result/status");
  if (status == "converged") {
    return {Health::kGood,
            "The optimisation converged: a further step would move no "
            "parameter by more than " +
                std::string("0.0001 of its standard deviation.")};
  }
  if (status == "contradicting_extrinsics") {
    return {Health::kBad,
            "The frames contradict the extrinsics of RIG. Wrong or exchanged "
            "cameras have spoilt the result; correct RIG and run again."};
  }
  return {Health::kBad,
          "The optimisation did not converge. These numbers are not a "
          "calibration."};
}

Finding HeldOutFinding(const Report& report) {
  const Json& summary = report.summary;
  const double fitted = NumberAt(summary, "/result/rms_px_after");
  const double held_out = NumberAt(summary, "/result/held_out_rms_px");
  const std::string fitted_text =
      Field(summary, "/result/rms_px_after", 3) + " px rms";
  if (!std::isfinite(held_out)) {
    return {Health::kGood,
            "Points are reprojected to " + fitted_text +
                ". No tracks were held out, so there is no independent check "
                "(<code>held_out_share</code>)."};
  }
  const std::string both = "Tracks that took no part fit to " +
                           Field(summary, "/result/held_out_rms_px", 3) +
                           " px rms, those that did "
                           "to " +
                           fitted_text;
  if (held_out > kHighHeldOut * fitted) {
    return {Health::kLook,
            both +
                ". That is much worse: the intrinsics follow the noise. "
                "Use more frames or a simpler lens model."};
  }
  return {Health::kGood,
          both + ": the intrinsics explain what they were not fitted to."};
}

Finding ModesFinding(const Report& report) {
  const Json& summary = report.summary;
  const std::string pointer = "/result/modes/common_focal_scale_std_permille";
  const double std_permille = NumberAt(summary, pointer);
  if (!std::isfinite(std_permille)) {
    return {Health::kLook,
            "The focal scale that all cameras share is not determined."};
  }
  const std::string text =
      "The weakest combination, one focal scale that all cameras share, is "
      "known to " +
      Field(summary, pointer, 2) + " &permil;";
  if (std_permille > kWeakFocalScale) {
    return {
        Health::kLook,
        text + ". More frames and more depth range in the scene would help."};
  }
  return {Health::kGood, text + "."};
}

// Pixels are square today. Where all cameras seem to have others, the known
// poses do not fit the images.
void AddAspectFinding(const Report& report, std::vector<Finding>* findings) {
  std::vector<double> aspects;
  for (const ReportCamera& camera : report.cameras) {
    const std::vector<size_t>& idxs = camera.model->FocalLengthIdxs();
    if (idxs.size() < 2) continue;
    aspects.push_back(1000.0 *
                      (camera.params[idxs[0]] / camera.params[idxs[1]] - 1.0));
  }
  if (aspects.empty() || !(std::abs(Median(aspects)) > kOddAspect)) return;
  findings->push_back(
      {Health::kLook,
       "The focal lengths along x and y of the median camera differ by " +
           Signed(Median(aspects), 1) +
           " &permil;. Pixels are usually square; errors of the known poses "
           "look like this. Say how exact they are "
           "(<code>extrinsics_rotation_std_deg</code>)."});
}

// Cameras with findings of this health.
std::string NamesOf(const Report& report, Health health, size_t* count) {
  std::string names;
  *count = 0;
  for (size_t i = 0; i < report.cameras.size(); ++i) {
    if (CameraHealth(report, i) != health) continue;
    if (++*count > 12) continue;
    names += (names.empty() ? "" : ", ") + std::string("<a href=\"#camera-") +
             std::to_string(i) + "\">" + EscapeHtml(report.cameras[i].name) +
             "</a>";
  }
  if (*count > 12) names += " and " + Count(*count - 12) + " more";
  return names;
}

void AddCameraFindings(const Report& report, std::vector<Finding>* findings) {
  size_t num_bad = 0;
  size_t num_look = 0;
  const std::string bad = NamesOf(report, Health::kBad, &num_bad);
  const std::string look = NamesOf(report, Health::kLook, &num_look);
  if (num_bad > 0) {
    findings->push_back({Health::kBad,
                         Plural(num_bad, "camera") +
                             " cannot be used as they are: " + bad + "."});
  }
  if (num_look > 0) {
    findings->push_back(
        {Health::kLook,
         Plural(num_look, "camera") + " to look at: " + look + "."});
  }
  if (num_bad + num_look == 0) {
    findings->push_back({Health::kGood,
                         "Nothing is unusual about any of the " +
                             Plural(report.cameras.size(), "camera") + "."});
  }
}

// What is outside of the limits that the user has set.
void AddLimitFinding(const Report& report, std::vector<Finding>* findings) {
  constexpr size_t kMaxShown = 12;
  const Json violations =
      report.summary["result"].value("limits_exceeded", Json::array());
  if (violations.empty()) return;
  std::string list;
  for (size_t i = 0; i < std::min(kMaxShown, violations.size()); ++i) {
    const std::string pointer =
        "/result/limits_exceeded/" + std::to_string(i) + "/";
    list += (i == 0 ? "" : "; ") +
            TextField(report.summary, pointer + "camera") + ", <code>" +
            TextField(report.summary, pointer + "limit") + "</code> " +
            Field(report.summary, pointer + "value", 3) + " &gt; " +
            Field(report.summary, pointer + "max", 3);
  }
  if (violations.size() > kMaxShown) {
    list += " and " + Count(violations.size() - kMaxShown) + " more";
  }
  findings->push_back(
      {Health::kLook, "Outside of the limits that were set: " + list + "."});
}

void AddInputFindings(const Report& report, std::vector<Finding>* findings) {
  const Json& summary = report.summary;
  size_t num_skipped = 0;
  for (const Json& frame : summary["frames"]) {
    num_skipped += TextAt(frame, "/status") != "used";
  }
  if (num_skipped > 0) {
    findings->push_back({Health::kLook,
                         Plural(num_skipped, "frame") +
                             " could not be used, see <a "
                             "href=\"#frames\">frames and cameras</a>."});
  }
  const Json inputs = summary.value("inputs", Json::object());
  const auto count = [&](const char* name) {
    return inputs.contains(name) ? inputs[name].size() : 0;
  };
  if (count("cameras_without_images") > 0) {
    findings->push_back({Health::kLook,
                         Plural(count("cameras_without_images"), "camera") +
                             " of RIG have no images and are not in the "
                             "result, see <a href=\"#run\">this run</a>."});
  }
  if (count("images_without_camera") > 0) {
    findings->push_back({Health::kLook,
                         Plural(count("images_without_camera"), "image") +
                             " belong to no camera of RIG and were left out, "
                             "see <a href=\"#run\">this run</a>."});
  }
}

}  // namespace

std::string HealthClass(Health health) {
  return health == Health::kBad    ? "bad"
         : health == Health::kLook ? "look"
                                   : "good";
}

std::string HealthWord(Health health) {
  return health == Health::kBad    ? "not usable"
         : health == Health::kLook ? "look at it"
                                   : "good";
}

std::vector<Finding> CameraFindings(const Report& report, size_t camera_idx) {
  std::vector<Finding> findings;
  const ReportCamera& camera = report.cameras[camera_idx];
  for (const std::string& flag : camera.flags) {
    Finding finding;
    finding.text = FlagText(report, camera_idx, flag, &finding.health);
    findings.push_back(finding);
  }
  const std::string rms_pointer = CameraPointer(camera_idx, "rms_px_after");
  const double rms = NumberAt(report.summary, rms_pointer);
  const double median_rms = MedianRms(report);
  if (rms > kHighRms * median_rms) {
    findings.push_back({Health::kLook,
                        "fits to " + Field(report.summary, rms_pointer, 3) +
                            " px rms, the median camera to " +
                            Fixed(median_rms, 3) +
                            " px: is its pose right, is it in focus?"});
  }
  for (const Comparison& earlier : report.earlier) {
    const std::optional<CameraDrift>& drift = earlier.drifts[camera_idx];
    if (drift && drift->is_unusual) {
      findings.push_back({Health::kLook,
                          "has changed far more than the others since " +
                              EscapeHtml(earlier.label)});
    }
  }
  if (EmptyShare(camera.residuals) > kPoorCoverage) {
    findings.push_back({Health::kGood,
                        "has points in a small part of its image only: the "
                        "uncertainty map tells where that matters"});
  }
  SortByGravity(&findings);
  return findings;
}

Health CameraHealth(const Report& report, size_t camera_idx) {
  const std::vector<Finding> findings = CameraFindings(report, camera_idx);
  return findings.empty() ? Health::kGood : findings.front().health;
}

std::vector<Finding> ResultFindings(const Report& report) {
  std::vector<Finding> findings = {
      StatusFinding(report), HeldOutFinding(report), ModesFinding(report)};
  AddCameraFindings(report, &findings);
  AddLimitFinding(report, &findings);
  AddAspectFinding(report, &findings);
  AddInputFindings(report, &findings);
  SortByGravity(&findings);
  return findings;
}

}  // namespace mfir

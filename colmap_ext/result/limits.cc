#include "colmap_ext/result/limits.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "colmap_ext/host/util.h"
#include "colmap_ext/models/camera_models.h"
#include "src/util/errors.h"
#include "src/util/parse_number.h"

namespace mfir {
namespace {

using Json = nlohmann::ordered_json;

// NaN for null.
double Number(const Json& value) {
  return value.is_number() ? value.get<double>() : std::nan("");
}

// The larger absolute value; NaN if one is.
double Larger(double a, double b) {
  return std::isnan(a)   ? a
         : std::isnan(b) ? b
                         : std::max(std::abs(a), std::abs(b));
}

// Of focal lengths in permille of them, of principal points in pixels.
std::pair<double, double> Stds(const Json& camera) {
  const CameraModel& model =
      *FindCameraModel(camera["model"].get<std::string>());
  double focal = 0.0;
  for (const size_t idx : model.FocalLengthIdxs()) {
    focal = Larger(focal,
                   1000.0 * Number(camera["params_std"][idx]) /
                       Number(camera["params"][idx]));
  }
  double principal_point = 0.0;
  for (const size_t idx : model.PrincipalPointIdxs()) {
    principal_point =
        Larger(principal_point, Number(camera["params_std"][idx]));
  }
  return {focal, principal_point};
}

bool HasFlag(const Json& camera, const std::string& flag) {
  const Json& flags = camera["flags"];
  return std::find(flags.begin(), flags.end(), flag) != flags.end();
}

class ViolationFinder {
 public:
  void Check(const Json& camera,
             const std::string& limit,
             double value,
             double max) {
    // Also for NaN.
    if (max > 0.0 && !(std::abs(value) <= max)) {
      violations.push_back(
          {camera["name"].get<std::string>(), limit, value, max});
    }
  }

  std::vector<LimitViolation> violations;
};

}  // namespace

void Limits::Check() const {
  const std::vector<std::pair<const char*, double>> limits = {
      {"max_rms_px", max_rms_px},
      {"max_focal_std_permille", max_focal_std_permille},
      {"max_principal_point_std_px", max_principal_point_std_px},
      {"max_focal_drift_permille", max_focal_drift_permille},
      {"max_principal_point_drift_px", max_principal_point_drift_px}};
  for (const auto& [name, value] : limits) {
    if (!(value >= 0.0) || !std::isfinite(value)) {
      throw UsageError(std::string("--MultiFrame.") + name + " " +
                       FormatNumber(value) + " must be 0 (none) or more.");
    }
  }
}

std::vector<LimitViolation> FindViolations(const Limits& limits,
                                           const Json& cameras) {
  ViolationFinder finder;
  for (const Json& camera : cameras) {
    finder.Check(camera,
                 "max_rms_px",
                 Number(camera["rms_px_after"]),
                 limits.max_rms_px);
    if (!HasFlag(camera, "constant")) {
      const auto [focal, principal_point] = Stds(camera);
      finder.Check(camera,
                   "max_focal_std_permille",
                   focal,
                   limits.max_focal_std_permille);
      finder.Check(camera,
                   "max_principal_point_std_px",
                   principal_point,
                   limits.max_principal_point_std_px);
    }
    const Json& from_rig = camera["drift"]["from_rig"];
    const Json& drift =
        from_rig.is_null() ? camera["drift"]["from_start"] : from_rig;
    if (drift.is_null()) continue;
    finder.Check(camera,
                 "max_focal_drift_permille",
                 Number(drift["focal_permille"]),
                 limits.max_focal_drift_permille);
    finder.Check(camera,
                 "max_principal_point_drift_px",
                 Larger(Number(drift["principal_point_px"][0]),
                        Number(drift["principal_point_px"][1])),
                 limits.max_principal_point_drift_px);
  }
  return finder.violations;
}

Json ViolationsToJson(const std::vector<LimitViolation>& violations) {
  Json list = Json::array();
  for (const LimitViolation& violation : violations) {
    list.push_back(
        {{"camera", violation.camera},
         {"limit", violation.limit},
         {"value",
          std::isfinite(violation.value) ? Json(violation.value) : Json()},
         {"max", violation.max}});
  }
  return list;
}

void ThrowIfOutsideLimits(const std::vector<LimitViolation>& violations,
                          const std::string& path) {
  if (violations.empty()) return;
  constexpr size_t kMaxShown = 10;
  std::string list;
  for (size_t i = 0; i < std::min(violations.size(), kMaxShown); ++i) {
    const LimitViolation& violation = violations[i];
    list += (i > 0 ? "; " : "") +
            host::StringPrintf("camera '%s': %s %.4g, allowed %g",
                               violation.camera.c_str(),
                               violation.limit.c_str(),
                               violation.value,
                               violation.max);
  }
  if (violations.size() > kMaxShown) {
    list += "; and " + std::to_string(violations.size() - kMaxShown) + " more";
  }
  throw Error(kExitOutsideLimits,
              "The result is written to " + path +
                  ", but outside of the limits that were set: " + list +
                  ". See result.limits_exceeded in summary.json.");
}

}  // namespace mfir

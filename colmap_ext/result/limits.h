// Limits that automation sets on a result.

#pragma once

#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace mfir {

// 0: none.
struct Limits {
  double max_rms_px = 0.0;
  // Standard deviations, the larger of both axes.
  double max_focal_std_permille = 0.0;
  double max_principal_point_std_px = 0.0;
  // Changes since the intrinsics of RIG, where it has some, else since the
  // start.
  double max_focal_drift_permille = 0.0;
  double max_principal_point_drift_px = 0.0;

  // Throws UsageError for a limit that is negative or not finite.
  void Check() const;
};

struct LimitViolation {
  std::string camera;
  std::string limit;   // name of the option
  double value = 0.0;  // NaN: not determined, which is outside, too
  double max = 0.0;
};

// By camera, in the order of `cameras`, the field of summary.json. Cameras that
// are held constant have no standard deviations to be judged.
std::vector<LimitViolation> FindViolations(
    const Limits& limits, const nlohmann::ordered_json& cameras);

// [{"camera", "limit", "value", "max"}]
nlohmann::ordered_json ViolationsToJson(
    const std::vector<LimitViolation>& violations);

// Throws Error with kExitOutsideLimits if there are any, naming the first ten.
// `path`: where the result is.
void ThrowIfOutsideLimits(const std::vector<LimitViolation>& violations,
                          const std::string& path);

}  // namespace mfir

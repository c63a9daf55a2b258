#include "colmap_ext/result/limits.h"

#include <cmath>

#include <gtest/gtest.h>

#include "src/util/errors.h"

namespace mfir {
namespace {

using Json = nlohmann::ordered_json;

// Focal std 2 and 3 permille, principal point std 0.4 px, drift 5 permille and
// -2 px since RIG.
Json Camera(const std::string& name) {
  return {{"name", name},
          {"model", "PINHOLE"},
          {"params", {1000.0, 1000.0, 500.0, 500.0}},
          {"params_std", {2.0, 3.0, 0.4, 0.1}},
          {"rms_px_after", 0.5},
          {"drift",
           {{"from_start",
             {{"focal_permille", 50.0}, {"principal_point_px", {9.0, 9.0}}}},
            {"from_rig",
             {{"focal_permille", -5.0}, {"principal_point_px", {1.0, -2.0}}}}}},
          {"flags", Json::array()}};
}

std::vector<std::string> Violated(const Limits& limits, const Json& camera) {
  std::vector<std::string> names;
  for (const LimitViolation& violation :
       FindViolations(limits, Json::array({camera}))) {
    EXPECT_EQ(violation.camera, "cam");
    names.push_back(violation.limit);
  }
  return names;
}

TEST(Limits, EachLimitOnItsOwn) {
  using Names = std::vector<std::string>;
  EXPECT_EQ(Violated({}, Camera("cam")), Names());
  EXPECT_EQ(Violated({0.5, 3.0, 0.4, 5.0, 2.0}, Camera("cam")), Names());
  EXPECT_EQ(Violated({0.49, 2.9, 0.39, 4.9, 1.9}, Camera("cam")),
            Names({"max_rms_px",
                   "max_focal_std_permille",
                   "max_principal_point_std_px",
                   "max_focal_drift_permille",
                   "max_principal_point_drift_px"}));
  EXPECT_EQ(Violated({0.0, 0.0, 0.0, 4.9, 0.0}, Camera("cam")),
            Names({"max_focal_drift_permille"}));
}

TEST(Limits, WithoutRigTheStartCounts) {
  Json camera = Camera("cam");
  camera["drift"]["from_rig"] = nullptr;
  EXPECT_EQ(Violated({0.0, 0.0, 0.0, 49.0, 9.0}, camera),
            std::vector<std::string>({"max_focal_drift_permille"}));
  camera["drift"]["from_start"] = nullptr;
  EXPECT_TRUE(Violated({0.0, 0.0, 0.0, 49.0, 9.0}, camera).empty());
}

TEST(Limits, WhatIsNotDeterminedIsOutside) {
  Json camera = Camera("cam");
  camera["params_std"] = {nullptr, nullptr, nullptr, nullptr};
  EXPECT_EQ(Violated({0.0, 100.0, 0.0, 0.0, 0.0}, camera),
            std::vector<std::string>({"max_focal_std_permille"}));
  camera["flags"] = {"constant"};
  EXPECT_TRUE(Violated({0.0, 100.0, 100.0, 0.0, 0.0}, camera).empty());
}

TEST(Limits, ErrorNamesCamerasAndValues) {
  const auto violations =
      FindViolations({0.1, 0.0, 0.0, 0.0, 0.0}, Json::array({Camera("cam")}));
  EXPECT_EQ(ViolationsToJson(violations).dump(),
            "[{\"camera\":\"cam\",\"limit\":\"max_rms_px\",\"value\":0.5,"
            "\"max\":0.1}]");
  EXPECT_NO_THROW(ThrowIfOutsideLimits({}, "out"));
  try {
    ThrowIfOutsideLimits(violations, "out");
    ADD_FAILURE();
  } catch (const Error& error) {
    EXPECT_EQ(error.exit_code, 5);
    EXPECT_NE(std::string(error.what())
                  .find("camera 'cam': max_rms_px 0.5, allowed 0.1"),
              std::string::npos)
        << error.what();
  }
  EXPECT_THROW(Limits({-1.0}).Check(), UsageError);
  EXPECT_THROW(Limits({0.0, std::nan("")}).Check(), UsageError);
}

}  // namespace
}  // namespace mfir

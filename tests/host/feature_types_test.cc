#include <string>
#include <utility>

#include <gtest/gtest.h>

#include "colmap_ext/host/feature.h"
#include "colmap_ext/host/util.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

// The message of the error, empty if there is none.
std::string SetTypes(const std::string& extractor, const std::string& matcher) {
  host::FeatureExtractionOptions extraction;
  host::FeatureMatchingOptions matching;
  try {
    host::SetFeatureTypes({extractor, matcher}, &extraction, &matching);
  } catch (const UsageError& error) {
    return error.what();
  }
  return "";
}

bool Contains(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

TEST(SetFeatureTypes, DefaultIsSiftWithItsNearestNeighbours) {
  host::FeatureExtractionOptions extraction;
  host::FeatureMatchingOptions matching;
  host::SetFeatureTypes(host::FeatureTypes(), &extraction, &matching);
  EXPECT_TRUE(host::IsSift(extraction));
  EXPECT_TRUE(host::MatchesNearestSift(matching));
}

// Of COLMAP 4; in 3.8 the options do not exist.
class FeatureTypesTest : public testing::Test {
 protected:
  void SetUp() override {
    if (host::VersionInfo().rfind("COLMAP 3.8", 0) == 0) {
      GTEST_SKIP() << "COLMAP 3.8 has SIFT only";
    }
  }
};

TEST_F(FeatureTypesTest, UnknownNamesAreErrors) {
  EXPECT_EQ(SetTypes("SIFT", "SIFT_BRUTEFORCE"), "");
  EXPECT_TRUE(Contains(SetTypes("SURF", ""), "--FeatureExtraction.type SURF"));
  EXPECT_TRUE(Contains(SetTypes("SIFT", "FLANN"), "--FeatureMatching.type"));
}

TEST_F(FeatureTypesTest, NetworksNeedAColmapWithThem) {
  for (const auto& [extractor, matcher] :
       {std::make_pair("ALIKED_N16ROT", ""),
        std::make_pair("ALIKED_N32", "ALIKED_BRUTEFORCE"),
        std::make_pair("SIFT", "SIFT_LIGHTGLUE")}) {
    const std::string message = SetTypes(extractor, matcher);
    if (message.empty()) GTEST_SKIP() << "this COLMAP is built with ONNX";
    EXPECT_TRUE(Contains(message, "is built with ONNX")) << message;
    EXPECT_EQ(message.find('\n'), std::string::npos) << message;
  }
}

TEST_F(FeatureTypesTest, MatchersAreForTheirFeatures) {
  // Where there is no ONNX, that is the message.
  EXPECT_NE(SetTypes("ALIKED_N32", "SIFT_BRUTEFORCE"), "");
  EXPECT_NE(SetTypes("SIFT", "ALIKED_BRUTEFORCE"), "");
}

}  // namespace
}  // namespace mfir

#include "src/sensor/unmatched_names.h"

#include <sstream>

#include <gtest/gtest.h>

#include "src/util/edit_distance.h"

namespace mfir {
namespace {

std::vector<std::string> Warnings(const std::vector<std::string>& cameras,
                                  const ImageOfName& images) {
  std::stringstream stream;
  WarnOfUnmatchedNames(cameras, images, stream);
  std::vector<std::string> lines;
  for (std::string line; std::getline(stream, line);) lines.push_back(line);
  return lines;
}

TEST(EditDistance, CountsChanges) {
  EXPECT_EQ(EditDistance("", ""), 0);
  EXPECT_EQ(EditDistance("camera", "camera"), 0);
  EXPECT_EQ(EditDistance("", "abc"), 3);
  EXPECT_EQ(EditDistance("kitten", "sitting"), 3);
  EXPECT_EQ(EditDistance("sitting", "kitten"), 3);
}

TEST(WarnOfUnmatchedNames, NothingWithoutBothSides) {
  EXPECT_TRUE(Warnings({}, {{"cam7", "f/cam7.png"}}).empty());
  EXPECT_TRUE(Warnings({"cam07"}, {}).empty());
}

TEST(WarnOfUnmatchedNames, ShowsTheNearestName) {
  const ImageOfName images = {{"cam1", "f/cam1.png"},
                              {"cam17", "f/cam17.png"},
                              {"CAM-07", "f/CAM-07.png"},
                              {"", "f/top.png"}};
  const std::vector<std::string> warnings =
      Warnings({"cam07", "Cam_0017", "kam01"}, images);
  ASSERT_EQ(warnings.size(), 4);
  EXPECT_EQ(warnings[0],
            "WARNING: camera 'cam07' of RIG has no image; nearest among the "
            "images without camera: 'f/CAM-07.png', camera 'CAM-07'");
  EXPECT_NE(warnings[1].find("camera 'cam17'"), std::string::npos);
  EXPECT_NE(warnings[2].find("camera 'cam1'"), std::string::npos);
  EXPECT_NE(warnings[3].find("camera_name_regex"), std::string::npos);
  EXPECT_NE(Warnings({"x"}, {{"", "f/top.png"}})[0].find(
                "'f/top.png', without camera name"),
            std::string::npos);
}

TEST(WarnOfUnmatchedNames, IsBounded) {
  std::vector<std::string> cameras;
  for (int i = 0; i < 500; ++i) cameras.push_back("cam" + std::to_string(i));
  const std::vector<std::string> warnings =
      Warnings(cameras, {{"a", "f/a.png"}});
  ASSERT_EQ(warnings.size(), 11);
  EXPECT_EQ(warnings[10].find("WARNING: 490 more cameras"), 0);
}

}  // namespace
}  // namespace mfir

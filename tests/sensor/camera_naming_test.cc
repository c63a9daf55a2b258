#include "src/sensor/camera_naming.h"

#include <algorithm>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "src/util/errors.h"

namespace mfir {
namespace {

using Names = std::vector<std::string>;

TEST(CameraNaming, PaperNames) {
  EXPECT_EQ(CameraNaming().Names({"camera0007_frame000012.png",
                                  "a/camera400015_frame000012.jpg"}),
            Names({"7", "400015"}));
}

TEST(CameraNaming, FileStem) {
  EXPECT_EQ(CameraNaming().Names({"cam07.png", "cam08.v2.png", ".cam09"}),
            Names({"cam07", "cam08.v2", ".cam09"}));
  EXPECT_EQ(CameraNaming().Names({"images/0000.jpg", "images/0012.jpg"}),
            Names({"0", "12"}));
}

TEST(CameraNaming, FirstFolder) {
  EXPECT_EQ(CameraNaming().Names({"cam07/000123.jpg", "cam08/000123.jpg"}),
            Names({"cam07", "cam08"}));
  EXPECT_EQ(CameraNaming().Names({"/007/a/1.jpg", "\\008\\a\\1.jpg"}),
            Names({"7", "8"}));
}

TEST(CameraNaming, PaperNamesMustApplyToAll) {
  EXPECT_EQ(CameraNaming().Names({"camera1_frame2.png", "extra.png"}),
            Names({"camera1_frame2", "extra"}));
}

TEST(CameraNaming, DuplicatesByTheFirstApplicableRule) {
  EXPECT_EQ(CameraNaming().Names({"a/1.jpg", "a/1.png", "b/2.jpg"}),
            Names({"1", "1", "2"}));
  EXPECT_EQ(CameraNaming().Names({"camera1_frame2.png", "camera1_frame3.png"}),
            Names({"camera1_frame2", "camera1_frame3"}));
}

TEST(CameraNaming, NothingAndNamelessImages) {
  EXPECT_EQ(CameraNaming().Names({}), Names());
  EXPECT_EQ(CameraNaming().Names({"", "cam1.png"}), Names({"", "cam1"}));
}

TEST(CameraNaming, Regex) {
  EXPECT_EQ(CameraNaming("cam_([a-z0-9]+)_")
                .Names({"x/cam_007_a.png", "cam_b2_a.png", "other.png"}),
            Names({"7", "b2", ""}));
  // A group that takes no part in the match is no name.
  EXPECT_EQ(CameraNaming("other|cam(\\d+)").Names({"other", "cam3"}),
            Names({"", "3"}));
}

TEST(CameraNaming, CameraName) {
  EXPECT_EQ(CameraNaming().CameraName("0012"), "12");
  EXPECT_EQ(CameraNaming().CameraName("192.168.1.10"), "192.168.1.10");
  EXPECT_EQ(CameraNaming("cam(\\d+)").CameraName("cam007"), "7");
  EXPECT_EQ(CameraNaming("cam(\\d+)").CameraName("400015"), "400015");
}

TEST(CameraNaming, BadRegex) {
  for (const std::string regex : {"(", "[", "cam", "(a)(b)", "(a", "*"}) {
    try {
      CameraNaming naming(regex);
      ADD_FAILURE() << regex;
    } catch (const UsageError& error) {
      EXPECT_NE(std::string(error.what()).find(regex), std::string::npos);
    }
  }
  EXPECT_NO_THROW(CameraNaming("(?:a|b)(c)"));
}

// std::regex overflows the stack on the first, and never ends on the second.
TEST(CameraNaming, RegexesAndNamesThatTakeForEver) {
  const std::string long_name(60000, 'x');
  EXPECT_EQ(CameraNaming("(.*)").Names({long_name}), Names({long_name}));
  EXPECT_EQ(CameraNaming().Names({long_name}), Names({long_name}));
  for (const std::string& name :
       {std::string(64, 'a'), std::string(60000, 'a')}) {
    try {
      CameraNaming("((?:a+)+)b").Names({name});
      ADD_FAILURE();
    } catch (const UsageError& error) {
      const std::string message = error.what();
      EXPECT_NE(message.find("((?:a+)+)b"), std::string::npos) << message;
      EXPECT_NE(message.find(std::string(64, 'a')), std::string::npos);
      EXPECT_LT(message.size(), 400u);
    }
  }
}

TEST(CanonicalCameraName, NumbersWithoutLeadingZeros) {
  EXPECT_EQ(CanonicalCameraName("000012"), "12");
  EXPECT_EQ(CanonicalCameraName("12"), "12");
  EXPECT_EQ(CanonicalCameraName("0000"), "0");
  EXPECT_EQ(CanonicalCameraName(""), "");
  EXPECT_EQ(CanonicalCameraName("cam07"), "cam07");
  EXPECT_EQ(CanonicalCameraName("007a"), "007a");
  EXPECT_EQ(CanonicalCameraName("000099999999999999999999"),
            "99999999999999999999");
}

TEST(CameraNameLess, NumbersByValueBeforeText) {
  Names names = {"b",
                 "10",
                 "cam2",
                 "9",
                 "cam10",
                 "0",
                 "400015",
                 "a",
                 "99999999999999999999"};
  std::sort(names.begin(), names.end(), CameraNameLess);
  EXPECT_EQ(names,
            Names({"0",
                   "9",
                   "10",
                   "400015",
                   "99999999999999999999",
                   "a",
                   "b",
                   "cam10",
                   "cam2"}));
  EXPECT_FALSE(CameraNameLess("007", "7"));
  EXPECT_FALSE(CameraNameLess("7", "007"));
}

}  // namespace
}  // namespace mfir

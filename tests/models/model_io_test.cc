#include "colmap_ext/models/model_io.h"

#include <cstring>
#include <limits>
#include <random>

#include "colmap_ext/host/reconstruction.h"
#include "colmap_ext/models/model_check.h"
#include "tests/support/test_data.h"
#include "tests/support/test_files.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

const std::string kCameras =
    "# comment\n"
    "1 PINHOLE 640 480 500.25 501.5 320 240\n"
    "7 OPENCV 1920 1080 1000 1001 960 540 0.1 -0.2 0.001 0.002\n";
const std::string kImages =
    "# comment\n"
    "1 1 0 0 0 0.5 -1.5 2 1 cam1.png\n"
    "10 20 3 30 40 -1 50 60 4\n"
    "\n"
    "2 0.5 0.5 0.5 0.5 1 2 3 7 empty.png\n"
    "\n"
    "9 0 1 0 0 4 5 6 7 cam9.png\n"
    "11 21 3 31 41 4\n";
const std::string kPoints3D =
    "3 0.1 0.2 5 255 0 1 0.7 1 0 9 0\n"
    "4 1 2 6 0 0 0 -1 1 2 9 1\n";

void WriteTextModel(const std::string& folder,
                    const std::string& cameras = kCameras,
                    const std::string& images = kImages,
                    const std::string& points3D = kPoints3D) {
  WriteFile(folder + "/cameras.txt", cameras);
  WriteFile(folder + "/images.txt", images);
  WriteFile(folder + "/points3D.txt", points3D);
}

host::Reconstruction Read(const std::string& folder,
                          bool require_points = true) {
  host::Reconstruction reconstruction;
  ReadModel(folder, require_points, &reconstruction);
  return reconstruction;
}

void WriteBinaryModel(const std::string& folder) {
  const TemporaryFolder text;
  WriteTextModel(text.Path());
  fs::create_directories(folder);
  Read(text.Path()).WriteBinary(folder);
}

void ExpectIsTestModel(const host::Reconstruction& model) {
  EXPECT_EQ(model.NumCameras(), 2);
  EXPECT_EQ(
      host::Params(model.Camera(7)),
      std::vector<double>({1000, 1001, 960, 540, 0.1, -0.2, 0.001, 0.002}));
  EXPECT_EQ(model.NumImages(), 3);
  EXPECT_EQ(model.NumRegImages(), 3);
  EXPECT_EQ(model.Image(1).Name(), "cam1.png");
  EXPECT_EQ(model.Image(1).NumPoints2D(), 3);
  EXPECT_EQ(model.Image(2).NumPoints2D(), 0);
  EXPECT_EQ(host::Point3DId(model.Image(9).Point2D(1)), 4);
  EXPECT_EQ(host::CamFromWorld(model.Image(9)).translation,
            Eigen::Vector3d(4, 5, 6));
  EXPECT_EQ(model.NumPoints3D(), 2);
  EXPECT_EQ(host::Xyz(model.Point3D(3)), Eigen::Vector3d(0.1, 0.2, 5));
  EXPECT_EQ(host::TrackOf(model.Point3D(4)).Length(), 2);
}

TEST(ReadModel, TextAndBinary) {
  const TemporaryFolder folder;
  WriteTextModel(folder / "text");
  ExpectIsTestModel(Read(folder / "text"));
  WriteBinaryModel(folder / "binary");
  ExpectIsTestModel(Read(folder / "binary"));
  // Replaces what was there before.
  host::Reconstruction twice = Read(folder / "binary");
  ReadModel(folder / "binary", true, &twice);
  ExpectIsTestModel(twice);
}

TEST(ReadModel, TextIsReadBitForBit) {
  const TemporaryFolder folder;
  WriteTextModel(folder / "a",
                 Replaced(kCameras, "500.25", "500.1234567890123"),
                 kImages,
                 Replaced(kPoints3D, "0.1 0.2 5", "0.1 1e-300 5"));
  const host::Reconstruction a = Read(folder / "a");
  EXPECT_EQ(host::Params(a.Camera(1))[0], 500.1234567890123);
  fs::create_directories(folder / "b");
  a.WriteText(folder / "b");
  const host::Reconstruction b = Read(folder / "b");
  EXPECT_EQ(host::Params(b.Camera(1)), host::Params(a.Camera(1)));
  EXPECT_EQ(host::Xyz(b.Point3D(3)), host::Xyz(a.Point3D(3)));
}

TEST(ReadModel, WindowsLineEndsAndCommentsBetween) {
  const TemporaryFolder folder;
  std::string images = kImages;
  for (size_t i = 0; (i = images.find('\n', i)) != std::string::npos; i += 2) {
    images.replace(i, 1, "\r\n");
  }
  WriteTextModel(folder / "text",
                 kCameras,
                 Replaced(images, "2 0.5", "# comment\r\n\r\n2 0.5"));
  ExpectIsTestModel(Read(folder / "text"));
}

TEST(ReadModel, InvisibleCharacters) {
  const TemporaryFolder folder;
  // The mark may stand before data, too.
  WriteTextModel(folder / "all",
                 WithInvisibles(Replaced(kCameras, "# comment\n", "")),
                 WithInvisibles(kImages),
                 WithInvisibles(kPoints3D));
  ExpectIsTestModel(Read(folder / "all"));
  WriteTextModel(folder / "one", kCameras, kImages, WithInvisibles(kPoints3D));
  ExpectIsTestModel(Read(folder / "one"));
  WriteFile(folder / "utf16/cameras.txt", "\xff\xfe#");
  WriteFile(folder / "utf16/images.txt", "");
  ExpectInputError([&] { Read(folder / "utf16", false); },
                   {"utf16/cameras.txt", "UTF-8"});
}

TEST(ReadModel, LastImageWithoutObservations) {
  const TemporaryFolder folder;
  const std::string images = "1 1 0 0 0 0 0 0 1 a.png\n\n";
  WriteTextModel(folder.Path(), kCameras, images, "");
  EXPECT_EQ(Read(folder.Path()).NumImages(), 1);
  WriteTextModel(
      folder.Path(), kCameras, images.substr(0, images.size() - 1), "");
  ExpectInputError([&] { Read(folder.Path()); },
                   {"images.txt:1:", "second line of the last image"});
}

TEST(ReadModel, WithoutPoints) {
  const TemporaryFolder folder;
  WriteTextModel(folder / "text");
  WriteBinaryModel(folder / "binary");
  fs::remove(folder / "text/points3D.txt");
  fs::remove(folder / "binary/points3D.bin");
  for (const std::string name : {"text", "binary"}) {
    ExpectInputError([&] { Read(folder / name); }, {name, "points3D"});
    const host::Reconstruction model = Read(folder / name, false);
    EXPECT_EQ(model.NumImages(), 3);
    EXPECT_EQ(model.NumPoints3D(), 0);
    EXPECT_EQ(model.Image(1).NumPoints2D(), 3);
    EXPECT_EQ(model.Image(1).NumPoints3D(), 0);
  }
  // Text with points wins over binary without, as in COLMAP.
  WriteTextModel(folder / "binary");
  ExpectIsTestModel(Read(folder / "binary"));
  // The observations of points that are no more.
  WriteTextModel(folder / "empty", kCameras, kImages, "");
  EXPECT_EQ(Read(folder / "empty", false).Image(1).NumPoints3D(), 0);
  ExpectInputError([&] { Read(folder / "empty"); }, {"unknown point"});
}

TEST(ReadModel, NoModel) {
  const TemporaryFolder folder;
  ExpectInputError([&] { Read(folder / "no"); }, {"no such folder", "/no"});
  ExpectInputError([&] { Read(folder.Path()); }, {"no COLMAP model"});
  WriteFile(folder / "cameras.bin", "");
  WriteFile(folder / "images.txt", "");
  fs::create_directories(folder / "images.bin");
  fs::create_directories(folder / "points3D.bin");
  EXPECT_FALSE(IsModelFolder(folder.Path()));
  ExpectInputError([&] { Read(folder.Path()); }, {"no COLMAP model"});
}

struct BadText {
  std::string file;
  std::string from;
  std::string to;
  std::vector<std::string> message;
};

std::ostream& operator<<(std::ostream& stream, const BadText& bad) {
  return stream << bad.file << ": '" << bad.from << "' -> '" << bad.to << "'";
}

class BadTextTest : public testing::TestWithParam<BadText> {};

TEST_P(BadTextTest, IsAnInputError) {
  const BadText& bad = GetParam();
  const TemporaryFolder folder;
  WriteTextModel(folder.Path());
  const std::string path = folder / bad.file;
  WriteFile(path, Replaced(ReadFile(path), bad.from, bad.to));
  std::vector<std::string> message = bad.message;
  message.push_back(folder.Path());
  ExpectInputError([&] { Read(folder.Path()); }, message);
}

INSTANTIATE_TEST_SUITE_P(
    Cameras,
    BadTextTest,
    testing::ValuesIn(std::vector<BadText>{
        {"cameras.txt", "PINHOLE", "PINHOLES", {"cameras.txt:2:", "PINHOLES"}},
        {"cameras.txt", " 320 240", " 320", {"cameras.txt:2:", "missing"}},
        {"cameras.txt", " 320 240", " 320 240 1", {"cameras.txt:2:", "'1'"}},
        {"cameras.txt", "501.5", "501,5", {"cameras.txt:2:", "501,5"}},
        {"cameras.txt", "501.5", "nan", {"cameras.txt:2:", "not finite"}},
        {"cameras.txt", "501.5", "inf", {"cameras.txt:2:", "not finite"}},
        {"cameras.txt", "501.5", "1e999", {"cameras.txt:2:", "1e999"}},
        {"cameras.txt", "501.5", "0", {"cameras.txt", "camera 1", "focal"}},
        {"cameras.txt", "501.5", "-1", {"cameras.txt", "camera 1", "focal"}},
        {"cameras.txt", "640 480", "0 480", {"camera 1", "image size"}},
        {"cameras.txt", "640 480", "-640 480", {"cameras.txt:2:", "WIDTH"}},
        {"cameras.txt", "640 480", "640 9999999", {"camera 1", "image size"}},
        {"cameras.txt", "640 480", "640  480", {"cameras.txt:2:", "HEIGHT"}},
        {"cameras.txt", "640 480", "640\t480", {"cameras.txt:2:", "WIDTH"}},
        {"cameras.txt", "7 OPENCV", "1 OPENCV", {"cameras.txt:3:", "second"}},
        {"cameras.txt", "7 OPENCV", "-7 OPENCV", {"cameras.txt:3:", "-7"}},
        {"cameras.txt", "7 OPENCV", "4294967295 OPENCV", {"cameras.txt:3:"}},
        {"cameras.txt", "7 OPENCV", "8 OPENCV", {"images.txt:5:", "camera 7"}},
        {"cameras.txt", "# comment", "comment", {"cameras.txt:1:"}}}));

INSTANTIATE_TEST_SUITE_P(
    Images,
    BadTextTest,
    testing::ValuesIn(std::vector<BadText>{
        {"images.txt", "0 0 0 0.5", "0 0 x 0.5", {"images.txt:2:", "QZ"}},
        {"images.txt", "1 1 0 0 0", "1 0 0 0 0", {"images.txt:2:", "zero"}},
        {"images.txt", "1 1 0 0 0", "1 nan 0 0 0", {"images.txt:2:", "QW"}},
        {"images.txt",
         "1 1 0 0 0",
         "1 1e200 0 0 0",
         {"images.txt", "rotation"}},
        {"images.txt", "-1.5", "inf", {"images.txt:2:", "TY"}},
        {"images.txt", "cam1.png", "cam 1.png", {"images.txt:2:", "spaces"}},
        {"images.txt", "cam1.png", "", {"images.txt:2:", "NAME"}},
        {"images.txt", "cam1.png", "cam9.png", {"images.txt", "same name"}},
        {"images.txt", "2 1 cam1", "2 3 cam1", {"images.txt:2:", "camera 3"}},
        {"images.txt", "9 0 1", "2 0 1", {"images.txt:7:", "second time"}},
        {"images.txt", "60 4", "60", {"images.txt:3:", "POINT3D_ID"}},
        {"images.txt", "60 4", "60 4 5", {"images.txt:3:", "Y of"}},
        {"images.txt", "60 4", "60 -2", {"images.txt:3:", "-2"}},
        {"images.txt", "60 4", "60 4.5", {"images.txt:3:", "4.5"}},
        {"images.txt", "60 4", "60 5", {"point 4", "another point"}},
        {"images.txt", "60 4", "60 3", {"point 4", "another point"}},
        {"images.txt", "40 -1", "40 3", {"images.txt", "not of one model"}},
        {"images.txt", "40 -1", "40 5", {"image 1", "unknown point 5"}},
        {"images.txt", "40 -1", "nan -1", {"images.txt:3:", "not finite"}},
        // A pose without its line of observations.
        {"images.txt", "\n\n9 0", "\n9 0", {"images.txt:6:", "second line"}}}));

INSTANTIATE_TEST_SUITE_P(
    Points3D,
    BadTextTest,
    testing::ValuesIn(std::vector<BadText>{
        {"points3D.txt", "0.1 0.2 5", "0.1 0.2 inf", {"points3D.txt:1:", "Z"}},
        {"points3D.txt", "255 0 1", "256 0 1", {"points3D.txt:1:", "256"}},
        {"points3D.txt", " 0.7 1 0 9 0", "", {"points3D.txt:1:", "ERROR"}},
        {"points3D.txt", "1 0 9 0", "1 0 9", {"points3D.txt:1:", "TRACK"}},
        {"points3D.txt", "1 0 9 0", "1 0 9 -1", {"points3D.txt:1:", "-1"}},
        {"points3D.txt", "1 0 9 0", "1 0 8 0", {"point 3", "unknown image 8"}},
        {"points3D.txt", "1 0 9 0", "1 0 9 2", {"point 3", "has only 2"}},
        {"points3D.txt", "1 0 9 0", "1 0 1 0", {"point 3", "twice"}},
        {"points3D.txt", "1 0 9 0", "1 0 9 1", {"point 3", "another point"}},
        {"points3D.txt", "1 0 9 0", "1 0", {"not of one model"}},
        {"points3D.txt", "4 1 2 6", "3 1 2 6", {"points3D.txt:2:", "second"}},
        {"points3D.txt", "4 1 2 6", "-4 1 2 6", {"points3D.txt:2:", "-4"}}}));

class BinaryModelTest : public testing::Test {
 protected:
  BinaryModelTest() {
    WriteBinaryModel(folder_.Path());
    for (const char* name : {"cameras.bin", "images.bin", "points3D.bin"}) {
      contents_.emplace_back(name, ReadFile(folder_ / name));
    }
  }

  // Whether the changed model is valid; anything but an InputError fails.
  bool IsReadable() const {
    try {
      Read(folder_.Path());
      return true;
    } catch (const InputError& error) {
      EXPECT_NE(std::string(error.what()).find(folder_.Path()),
                std::string::npos)
          << error.what();
      return false;
    }
  }

  template <typename T>
  void ExpectErrorWith(const std::string& name,
                       size_t position,
                       T value,
                       const std::vector<std::string>& message) const {
    const std::string content = ReadFile(folder_ / name);
    std::string changed = content;
    std::memcpy(&changed[position], &value, sizeof(T));
    WriteFile(folder_ / name, changed);
    ExpectInputError([&] { Read(folder_.Path()); }, message);
    WriteFile(folder_ / name, content);
  }

  const TemporaryFolder folder_;
  std::vector<std::pair<std::string, std::string>> contents_;
};

TEST_F(BinaryModelTest, TruncatedAnywhere) {
  for (const auto& [name, content] : contents_) {
    for (size_t size = 0; size < content.size(); ++size) {
      WriteFile(folder_ / name, content.substr(0, size));
      ExpectInputError([&] { Read(folder_.Path()); }, {name, "byte"});
    }
    WriteFile(folder_ / name, content);
  }
  EXPECT_TRUE(IsReadable());
}

TEST_F(BinaryModelTest, TrailingBytes) {
  for (const auto& [name, content] : contents_) {
    WriteFile(folder_ / name, content + "x");
    ExpectInputError([&] { Read(folder_.Path()); }, {name, "1 bytes too many"});
    WriteFile(folder_ / name, content);
  }
}

TEST_F(BinaryModelTest, RandomBytesNeverCrash) {
  std::mt19937 random(1);
  size_t num_errors = 0;
  const size_t kNumTrials = 1500;
  for (size_t trial = 0; trial < kNumTrials; ++trial) {
    const auto& [name, content] = contents_[random() % contents_.size()];
    std::string changed = content;
    for (size_t i = 0; i <= random() % 3; ++i) {
      changed[random() % changed.size()] =
          random() % 2 == 0 ? static_cast<char>(random())
                            : (random() % 2 == 0 ? '\xff' : '\0');
    }
    WriteFile(folder_ / name, changed);
    num_errors += IsReadable() ? 0 : 1;
    WriteFile(folder_ / name, content);
  }
  EXPECT_GT(num_errors, kNumTrials / 10);
  EXPECT_LT(num_errors, kNumTrials);
}

TEST_F(BinaryModelTest, HugeCounts) {
  for (const auto& [name, content] : contents_) {
    for (const uint64_t count : {uint64_t(1) << 40, ~uint64_t(0)}) {
      ExpectErrorWith(name, 0, count, {name, std::to_string(count)});
    }
  }
}

TEST_F(BinaryModelTest, BadValues) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  // First camera: id, model, width, height, parameters.
  ExpectErrorWith("cameras.bin", 12, int32_t(99), {"camera 1 of 2", "99"});
  ExpectErrorWith("cameras.bin", 12, int32_t(-1), {"camera 1 of 2", "-1"});
  ExpectErrorWith("cameras.bin", 16, uint64_t(0), {"image size"});
  ExpectErrorWith("cameras.bin", 32, nan, {"parameter 1"});
  ExpectErrorWith("cameras.bin", 32, 0.0, {"focal length"});
  // First image: id, quaternion, translation, camera id, name.
  for (int i = 0; i < 7; ++i) {
    ExpectErrorWith(
        "images.bin", 12 + 8 * i, nan, {"image", i < 4 ? "not finite" : "nan"});
  }
  ExpectErrorWith("images.bin", 68, uint32_t(5), {"no camera 5"});
  ExpectErrorWith("images.bin", 72, '\0', {"images.bin"});
  ExpectErrorWith("images.bin", 72, '\n', {"image name"});
  // First point: id, position.
  ExpectErrorWith("points3D.bin", 8, ~uint64_t(0), {"invalid"});
  ExpectErrorWith("points3D.bin", 16, nan, {"point", "nan"});
}

TEST_F(BinaryModelTest, DuplicateIds) {
  uint32_t camera_id;
  std::memcpy(&camera_id, contents_[0].second.data() + 8, sizeof(camera_id));
  const size_t second_camera = 32 + 8 * (camera_id == 1 ? 4 : 8);
  ExpectErrorWith(
      "cameras.bin", second_camera, camera_id, {"camera 2 of 2", "twice"});
  uint64_t point3D_id;
  std::memcpy(&point3D_id, contents_[2].second.data() + 8, sizeof(point3D_id));
  const size_t second_point = 8 + (8 + 24 + 3 + 8 + 8) + 2 * 8;
  ExpectErrorWith(
      "points3D.bin", second_point, point3D_id, {"point 2 of 2", "twice"});
}

TEST(ReadModel, TruncatedTextNeverCrashes) {
  const TemporaryFolder folder;
  for (const std::string name : {"cameras.txt", "images.txt", "points3D.txt"}) {
    WriteTextModel(folder.Path());
    const std::string content = ReadFile(folder / name);
    for (size_t size = 0; size < content.size(); ++size) {
      WriteFile(folder / name, content.substr(0, size));
      try {
        Read(folder.Path());
      } catch (const InputError&) {
      }
    }
  }
}

TEST(ReadModel, RandomTextNeverCrashes) {
  const TemporaryFolder folder;
  const std::string characters = "0123456789 \n-+.e#x\t\r\x80";
  std::mt19937 random(2);
  for (size_t trial = 0; trial < 1000; ++trial) {
    std::vector<std::string> contents = {kCameras, kImages, kPoints3D};
    std::string& changed = contents[random() % 3];
    for (size_t i = 0; i <= random() % 3; ++i) {
      changed[random() % changed.size()] =
          characters[random() % characters.size()];
    }
    WriteTextModel(folder.Path(), contents[0], contents[1], contents[2]);
    try {
      Read(folder.Path());
    } catch (const InputError&) {
    }
  }
}

TEST(FindSparseModel, MostImagesElseFirst) {
  const TemporaryFolder folder;
  EXPECT_EQ(FindSparseModel(folder / "none"), "");
  EXPECT_EQ(FindSparseModel(folder.Path()), "");
  const std::string one_image = "1 1 0 0 0 0 0 0 1 a.png\n\n";
  for (const char* name : {"a/sparse/0", "b/0", "c/sparse", "d/refined", "e"}) {
    WriteTextModel(folder / name, kCameras, one_image, "");
    const std::string frame = std::string(name).substr(0, 1);
    EXPECT_EQ(FindSparseModel(folder / frame), folder / name);
  }
  WriteTextModel(folder / "a/refined", kCameras, one_image, "");
  EXPECT_EQ(FindSparseModel(folder / "a"), folder / "a/sparse/0");
  WriteBinaryModel(folder / "a/sparse/10");
  WriteBinaryModel(folder / "a/sparse/2");
  EXPECT_EQ(FindSparseModel(folder / "a"), folder / "a/sparse/2");
  WriteTextModel(folder / "b/3");
  EXPECT_EQ(FindSparseModel(folder / "b"), folder / "b/3");
  WriteFile(folder / "b/3/images.txt", "garbage");
  ExpectInputError([&] { FindSparseModel(folder / "b"); },
                   {"b/3/images.txt:1:"});
}

TEST(ReadModel, RealCaptures) {
  MFIR_REQUIRE_TEST_DATA("panoptic31/frames_triangulated");
  size_t num_models = 0;
  for (const auto& entry : fs::recursive_directory_iterator(TestDataFolder())) {
    if (entry.is_directory() && IsModelFolder(entry.path().string())) {
      EXPECT_GT(Read(entry.path().string()).NumImages(), 0) << entry.path();
      ++num_models;
    }
  }
  EXPECT_GT(num_models, 10);
}

}  // namespace
}  // namespace mfir

#include "colmap_ext/feature/feature_database.h"

#include <random>

#include <gtest/gtest.h>

#include "tests/support/test_files.h"

namespace mfir {
namespace {

// Gives what it is told to.
class FixedSource : public DenseFeatureSource {
 public:
  DenseFeaturePatches Extract(const DenseFeatureRequest&) override {
    return patches;
  }
  void Finish() override { finished = true; }
  DenseFeaturePatches patches;
  bool finished = false;
};

DenseFeatureRequest Request(const std::string& frame_name,
                            const std::string& camera_name) {
  return {frame_name,
          camera_name,
          "image.png",
          200,
          100,
          {{20.0, 30.0}, {50.2, 60.9}, {150.0, 10.0}},
          {3, 1, 40}};
}

DenseFeaturePatches RandomPatches(int patch_size,
                                  int num_channels,
                                  double pixel_size,
                                  int seed) {
  const DenseFeatureRequest request = Request("", "");
  DenseFeaturePatches patches =
      PlacePatches(request, patch_size, num_channels, pixel_size);
  std::mt19937 random(seed);
  for (uint16_t& value : patches.data) value = random() % 0x7C00;
  patches.valid[1] = false;
  const size_t size = patches.PatchNumElements();
  std::fill_n(patches.data.begin() + size, size, 0);
  patches.corners[1].setZero();
  return patches;
}

void ExpectEqual(const DenseFeaturePatches& a, const DenseFeaturePatches& b) {
  EXPECT_EQ(a.patch_size, b.patch_size);
  EXPECT_EQ(a.num_channels, b.num_channels);
  EXPECT_EQ(a.pixel_size, b.pixel_size);
  EXPECT_EQ(a.corners, b.corners);
  EXPECT_EQ(a.valid, b.valid);
  EXPECT_TRUE(a.data == b.data);
}

void WriteFeatures(const std::string& path,
                   const DenseFeatureRequest& request,
                   const DenseFeaturePatches& patches) {
  auto source = std::make_unique<FixedSource>();
  source->patches = patches;
  const auto writer = MakeWritingFeatureSource(std::move(source), path);
  writer->Extract(request);
  writer->Finish();
}

class FeatureDatabaseTest : public testing::Test {
 protected:
  // A file as the paper's programs write it, with one small change.
  void Execute(const std::string& sql) {
    SqliteFile file(path_, SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE);
    file.Execute(sql);
  }

  void MakePaperFile() {
    Execute(
        "CREATE TABLE dense_features(frame_name INTEGER, camera_name INTEGER, "
        "keypoint_id INTEGER, corner_x INTEGER, corner_y INTEGER, "
        "dense_feature BLOB, PRIMARY KEY (frame_name, camera_name, "
        "keypoint_id))");
    Execute(
        "INSERT INTO dense_features VALUES (100, 7, 3, 12, 22, "
        "zeroblob(65536))");
  }

  void ExpectExtractFails(const std::string& change,
                          const std::vector<std::string>& parts) {
    std::filesystem::remove(path_);
    MakePaperFile();
    Execute(change);
    ExpectInputError(
        [this] { FeatureDatabase(path_).Extract(Request("100", "7")); }, parts);
  }

  const TemporaryFolder folder_;
  const std::string path_ = folder_ / "features.sqlite";
};

TEST_F(FeatureDatabaseTest, RoundTrip) {
  for (const auto& [patch_size, num_channels, pixel_size] :
       {std::tuple(16, 128, 1.0),
        std::tuple(8, 5, 2.0),
        std::tuple(12, 64, 1.0)}) {
    auto fixed = std::make_unique<FixedSource>();
    FixedSource* source = fixed.get();
    const auto writer = MakeWritingFeatureSource(std::move(fixed), path_);
    std::vector<DenseFeaturePatches> written;
    const std::vector<std::pair<std::string, std::string>> names = {
        {"000012", "cam07"}, {"12_b", "007"}, {"1e5", "1.50"}, {"'; --", "x"}};
    for (const auto& [frame_name, camera_name] : names) {
      source->patches = RandomPatches(patch_size,
                                      num_channels,
                                      pixel_size,
                                      static_cast<int>(written.size()));
      written.push_back(writer->Extract(Request(frame_name, camera_name)));
      // As when patches are not kept.
      writer->Extract(Request(frame_name, camera_name));
    }
    writer->Finish();
    EXPECT_TRUE(source->finished);
    FeatureDatabase database(path_);
    for (size_t i = 0; i < names.size(); ++i) {
      const auto& [frame_name, camera_name] = names[i];
      EXPECT_TRUE(database.HasImage(frame_name, camera_name));
      ExpectEqual(database.Extract(Request(frame_name, camera_name)),
                  written[i]);
    }
    ExpectEqual(database.Extract(Request("12", "cam07")), written[0]);
    ExpectEqual(database.Extract(Request("12_b", "7")), written[1]);
    EXPECT_FALSE(database.HasImage("100000", "1.50"));
  }
}

TEST_F(FeatureDatabaseTest, FilesOfThePaper) {
  MakePaperFile();
  FeatureDatabase database(path_);
  for (const char* frame_name : {"100", "000100", "frame000100", "frame100"}) {
    const DenseFeaturePatches patches =
        database.Extract(Request(frame_name, "007"));
    EXPECT_EQ(patches.patch_size, 16);
    EXPECT_EQ(patches.num_channels, 128);
    EXPECT_EQ(patches.pixel_size, 1.0);
    EXPECT_EQ(patches.valid, std::vector<bool>({true, false, false}));
    EXPECT_EQ(patches.corners[0], Eigen::Vector2i(12, 22));
  }
  const DenseFeaturePatches none = database.Extract(Request("101", "7"));
  EXPECT_EQ(none.valid, std::vector<bool>(3, false));
  EXPECT_TRUE(none.data.empty());
  EXPECT_FALSE(database.HasImage("frames100", "7"));
}

TEST_F(FeatureDatabaseTest, NamesStoredAsText) {
  Execute(
      "CREATE TABLE dense_features(frame_name TEXT, camera_name TEXT, "
      "keypoint_id INTEGER, corner_x INTEGER, corner_y INTEGER, dense_feature "
      "BLOB)");
  Execute(
      "INSERT INTO dense_features VALUES ('frame_000100', '00007', 3, 12, 22, "
      "zeroblob(65536))");
  FeatureDatabase database(path_);
  EXPECT_TRUE(database.Extract(Request("frame_000100", "7")).valid[0]);
  EXPECT_FALSE(database.HasImage("100", "7"));
}

TEST_F(FeatureDatabaseTest, FeaturesThatAreNotFiniteAreLeftOut) {
  MakePaperFile();
  // The last number is infinite.
  std::string hex(2 * 65536, '0');
  hex.replace(hex.size() - 4, 4, "007C");
  Execute("UPDATE dense_features SET dense_feature = x'" + hex + "'");
  FeatureDatabase database(path_);
  EXPECT_FALSE(database.Extract(Request("100", "7")).valid[0]);
}

TEST_F(FeatureDatabaseTest, BadFiles) {
  ExpectInputError([this] { FeatureDatabase database(path_); },
                   {path_, "there is no such file"});
  WriteFile(path_, "no database, and long enough to have a header of one");
  ExpectInputError([this] { FeatureDatabase database(path_); },
                   {path_, "not a database"});
  WriteFile(path_, "");
  ExpectInputError([this] { FeatureDatabase database(path_); },
                   {path_, "no table dense_features"});
  Execute("CREATE TABLE dense_features(frame_name)");
  ExpectInputError([this] { FeatureDatabase database(path_); },
                   {path_, "camera_name"});
  std::filesystem::remove(path_);
  MakePaperFile();
  Execute("DELETE FROM dense_features");
  ExpectInputError([this] { FeatureDatabase database(path_); },
                   {path_, "is empty"});
}

TEST_F(FeatureDatabaseTest, BadRows) {
  ExpectExtractFails(
      "UPDATE dense_features SET dense_feature = zeroblob(65534)",
      {"frame '100', camera '7', keypoint 3", "65534 bytes", "65536"});
  ExpectExtractFails("UPDATE dense_features SET dense_feature = NULL",
                     {"keypoint 3", "0 bytes"});
  ExpectExtractFails("UPDATE dense_features SET dense_feature = 1.5",
                     {"keypoint 3", "bytes"});
  for (const char* corner : {"40", "'x'", "NULL", "-9223372036854775808"}) {
    ExpectExtractFails(
        "UPDATE dense_features SET corner_x = " + std::string(corner),
        {"keypoint 3", "does not contain the keypoint", "another model"});
  }
  ExpectExtractFails(
      "CREATE TABLE dense_feature_info(patch_size, num_channels, pixel_size)",
      {"dense_feature_info is empty"});
  for (const char* values :
       {"0 AS patch_size, 128 AS num_channels, 1 AS pixel_size",
        "16 AS patch_size, -1 AS num_channels, 1 AS pixel_size",
        "16 AS patch_size, 128 AS num_channels, 0 AS pixel_size",
        "99999 AS patch_size, 128 AS num_channels, 1 AS pixel_size",
        "16 AS patch_size, 128 AS num_channels, 'x' AS pixel_size"}) {
    ExpectExtractFails(
        "CREATE TABLE dense_feature_info AS SELECT " + std::string(values),
        {"dense_feature_info are impossible"});
  }
}

TEST_F(FeatureDatabaseTest, NamesThatAreTheSameNumber) {
  Execute(
      "CREATE TABLE dense_features(frame_name, camera_name, keypoint_id, "
      "corner_x, corner_y, dense_feature)");
  Execute("INSERT INTO dense_features VALUES (100, 7, 3, 12, 22, x'00')");
  Execute("INSERT INTO dense_features VALUES ('0100', 7, 3, 12, 22, x'00')");
  ExpectInputError([this] { FeatureDatabase database(path_); },
                   {"two names", "'100'"});
}

TEST_F(FeatureDatabaseTest, UnfinishedWritersLeaveTheEarlierFile) {
  const DenseFeaturePatches first = RandomPatches(8, 4, 1.0, 1);
  WriteFeatures(path_, Request("1", "2"), first);
  const std::string before = ReadFile(path_);
  {
    auto source = std::make_unique<FixedSource>();
    source->patches = RandomPatches(8, 4, 1.0, 2);
    const auto writer = MakeWritingFeatureSource(std::move(source), path_);
    writer->Extract(Request("1", "2"));
    EXPECT_TRUE(ReadFile(path_) == before);
  }
  EXPECT_TRUE(ReadFile(path_) == before);
  size_t num_files = 0;
  for ([[maybe_unused]] const auto& entry :
       std::filesystem::directory_iterator(folder_.Path())) {
    ++num_files;
  }
  EXPECT_EQ(num_files, 1u);
  const DenseFeaturePatches second = RandomPatches(8, 4, 1.0, 3);
  WriteFeatures(path_, Request("1", "2"), second);
  ExpectEqual(FeatureDatabase(path_).Extract(Request("1", "2")), second);
}

TEST_F(FeatureDatabaseTest, WhatCannotBeWritten) {
  const auto expect_error = [](const std::string& path,
                               const std::string& part) {
    try {
      WriteFeatures(path, Request("1", "2"), RandomPatches(8, 4, 1.0, 1));
      ADD_FAILURE() << path;
    } catch (const OutputError& error) {
      EXPECT_NE(std::string(error.what()).find(part), std::string::npos)
          << error.what();
    }
  };
  expect_error(folder_ / "missing/features.sqlite", "cannot write");
  expect_error(folder_.Path(), "no database of dense features");
  WriteFile(path_, "my thesis");
  expect_error(path_, "no database of dense features");
  EXPECT_EQ(ReadFile(path_), "my thesis");
  // The same image twice.
  auto source = std::make_unique<FixedSource>();
  source->patches = RandomPatches(8, 4, 1.0, 1);
  const auto writer =
      MakeWritingFeatureSource(std::move(source), folder_ / "twice.sqlite");
  writer->Extract(Request("12", "1"));
  EXPECT_THROW(writer->Extract(Request("frame0012", "1")), OutputError);
}

}  // namespace
}  // namespace mfir

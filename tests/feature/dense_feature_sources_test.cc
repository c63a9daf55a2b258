// The choice of the source, and where images are found.

#include "colmap_ext/feature/dense_feature_sources.h"

#include <gtest/gtest.h>

#include "colmap_ext/feature/image_folder.h"
#include "tests/support/feature_images.h"
#include "tests/support/onnx_builder.h"
#include "tests/support/test_files.h"

namespace mfir {
namespace {

class DenseFeatureSourcesTest : public testing::Test {
 protected:
  DenseFeatureSourcesTest() {
    options_.dense_features = "sift";
    image_.Write(folder_ / "0.png");
    std::filesystem::create_directories(folder_ / "000012/a");
    image_.Write(folder_ / "000012/a/1.png");
    requests_ = {Request("0.png"), Request("a/1.png")};
    requests_[1].camera_name = "8";
  }

  DenseFeatureRequest Request(const std::string& image_name) const {
    return image_.Request(image_name, {{30.0, 30.0}, {20.5, 40.1}});
  }

  std::unique_ptr<DenseFeatureSource> Make() {
    log_.clear();
    return MakeDenseFeatureSource(
        options_, image_path_, requests_, [this](const std::string& line) {
          log_ += line;
        });
  }

  template <typename ErrorType>
  void ExpectError(const std::string& part) {
    try {
      Make();
      ADD_FAILURE() << "no error: " << part;
    } catch (const ErrorType& error) {
      EXPECT_NE(std::string(error.what()).find(part), std::string::npos)
          << error.what();
    }
  }

  const TemporaryFolder folder_;
  const TestImage image_ = TestImage::Texture(64, 64, 0.0, 0.0);
  std::string image_path_ = folder_.Path();
  MultiFrameOptions options_;
  DenseFeatureOptions& features_ = options_.features;
  std::vector<DenseFeatureRequest> requests_;
  std::string log_;
};

TEST_F(DenseFeatureSourcesTest, ImagesOfTheFrameComeFirst) {
  const ImageFolder images(folder_.Path());
  const auto find = [&images](const std::string& frame,
                              const std::string& image,
                              const std::string& camera = "none") {
    DenseFeatureRequest request;
    request.frame_name = frame;
    request.camera_name = camera;
    request.image_name = image;
    return images.Find(request);
  };
  EXPECT_EQ(find("000012", "0.png"), folder_ / "0.png");
  EXPECT_EQ(find("000012", "a/1.png"), folder_ / "000012/a/1.png");
  EXPECT_EQ(find("000013", "a/1.png"), "");
  image_.Write(folder_ / "000012/0.png");
  EXPECT_EQ(find("000012", "0.png"), folder_ / "000012/0.png");
  EXPECT_EQ(find("000013", "0.png"), folder_ / "0.png");
  EXPECT_EQ(find("000012", "a"), "");
}

TEST_F(DenseFeatureSourcesTest, ImagesByCameraAndInOneFolder) {
  const TemporaryFolder by_camera;
  std::filesystem::create_directories(by_camera / "cam07");
  std::filesystem::create_directories(by_camera / "008");
  image_.Write(by_camera / "cam07/000012.png");
  image_.Write(by_camera / "008/008_000012.png");
  const TemporaryFolder flat;
  image_.Write(flat / "cam_07_000012.png");
  image_.Write(flat / "000013_008.png");
  const auto find = [](const TemporaryFolder& folder,
                       const std::string& frame,
                       const std::string& camera) {
    DenseFeatureRequest request;
    request.frame_name = frame;
    request.camera_name = camera;
    request.image_name = camera + ".png";
    return ImageFolder(folder.Path()).Find(request);
  };
  EXPECT_EQ(find(by_camera, "000012", "cam07"), by_camera / "cam07/000012.png");
  EXPECT_EQ(find(by_camera, "000012", "8"), by_camera / "008/008_000012.png");
  EXPECT_EQ(find(by_camera, "000013", "cam07"), "");
  EXPECT_EQ(find(flat, "000012", "cam_07"), flat / "cam_07_000012.png");
  EXPECT_EQ(find(flat, "000013", "8"), flat / "000013_008.png");
  EXPECT_EQ(find(flat, "000012", "8"), "");
}

TEST_F(DenseFeatureSourcesTest, Sift) {
  features_.patch_size = 10;
  const auto source = Make();
  EXPECT_EQ(log_, "");
  for (const DenseFeatureRequest& request : requests_) {
    const DenseFeaturePatches patches = source->Extract(request);
    EXPECT_EQ(patches.valid, std::vector<bool>(2, true));
    EXPECT_EQ(patches.patch_size, 10);
    EXPECT_EQ(patches.num_channels, 128);
  }
}

TEST_F(DenseFeatureSourcesTest, Onnx) {
  OnnxBuilder builder(3);
  builder.Conv("image", "map", 3, 2, 1, 1, 0, {1, 0, 0, 0, 1, 0});
  builder.Output("map", 2);
  WriteFile(folder_ / "network.onnx", builder.Str());
  options_.dense_features = "onnx";
  features_.onnx.path = folder_ / "network.onnx";
  EXPECT_EQ(Make()->Extract(requests_[0]).num_channels, 2);
}

TEST_F(DenseFeatureSourcesTest, WrittenFeaturesAreReadAgain) {
  features_.write_path = folder_ / "features.sqlite";
  std::vector<DenseFeaturePatches> written;
  {
    const auto source = Make();
    // What is written are patches, also where a GPU needs none.
    SiftImage image;
    DenseFeaturePatches places;
    EXPECT_FALSE(source->ReadSiftImage(requests_[0], &image, &places));
    written.push_back(source->Extract(requests_[0]));
    source->Finish();
  }
  options_.dense_features = "database";
  ExpectError<UsageError>("dense_feature_path");
  features_.database_path = folder_ / "features.sqlite";
  ExpectError<UsageError>("must not be the file");
  features_.write_path = "";
  image_path_ = "";
  const auto source = Make();
  EXPECT_NE(log_.find("1 of 2 images"), std::string::npos) << log_;
  EXPECT_NE(log_.find("a/1.png"), std::string::npos) << log_;
  const DenseFeaturePatches read = source->Extract(requests_[0]);
  EXPECT_EQ(read.corners, written[0].corners);
  EXPECT_TRUE(read.data == written[0].data);
  EXPECT_EQ(source->Extract(requests_[1]).valid, std::vector<bool>(2, false));
  requests_ = {requests_[1]};
  ExpectError<InputError>("None of the 1 images");
}

TEST_F(DenseFeatureSourcesTest, MissingImages) {
  requests_.push_back(Request("missing.png"));
  const auto source = Make();
  EXPECT_NE(log_.find("1 of 3 images"), std::string::npos) << log_;
  EXPECT_NE(log_.find("missing.png"), std::string::npos) << log_;
  EXPECT_EQ(source->Extract(requests_[2]).valid, std::vector<bool>(2, false));
  requests_ = {requests_[2]};
  ExpectError<InputError>("None of the 1 images");
  image_path_ = "";
  ExpectError<UsageError>("--image_path");
}

}  // namespace
}  // namespace mfir

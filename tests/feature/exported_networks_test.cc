// The networks of tools/networks.py, exported to ONNX and run by our source,
// against PyTorch. Needs the Debian packages python3-torch and python3-onnx;
// published weights are looked for in the folder MFIR_MODELS_DIR.

#include <sys/wait.h>

#include <cstdlib>
#include <cstring>

#include <gtest/gtest.h>

#include "colmap_ext/feature/onnx_feature_source.h"
#include "tests/support/feature_images.h"
#include "tests/support/test_files.h"

namespace mfir {
namespace {

struct ExportedNetwork {
  const char* name;
  const char* weights;  // file name, "-": random
  const char* mean;
  const char* std;
  int tile_size;
  int tile_overlap;
};

class ExportedNetworksTest : public testing::TestWithParam<ExportedNetwork> {
 protected:
  // Weights of the network; empty if they are not there.
  static std::string WeightsPath() {
    if (std::string(GetParam().weights) == "-") return "-";
    const char* folder = std::getenv("MFIR_MODELS_DIR");
    const std::filesystem::path path =
        (folder != nullptr
             ? std::filesystem::path(folder)
             : std::filesystem::path(MFIR_SOURCE_DIR) / "../shared/models") /
        GetParam().weights;
    return std::filesystem::exists(path) ? path.string() : "";
  }

  // The exit code of the script.
  int Export(const std::string& weights) {
    const std::vector<double> mean = ParseNumberList("", GetParam().mean);
    const std::vector<double> std = ParseNumberList("", GetParam().std);
    std::vector<float> input;
    for (int c = 0; c < 3; ++c) {
      for (int y = 0; y < image_.height; ++y) {
        for (int x = 0; x < image_.width; ++x) {
          input.push_back(static_cast<float>(
              (image_.Pixel(x, y, c) / 255.0 - mean[c]) / std[c]));
        }
      }
    }
    WriteFile(folder_ / "input",
              std::string(reinterpret_cast<const char*>(input.data()),
                          input.size() * sizeof(float)));
    std::string command = "/usr/bin/python3 '" MFIR_SOURCE_DIR
                          "/tests/export_network.py' " +
                          std::string(GetParam().name);
    for (const std::string& argument : {weights,
                                        folder_ / "input",
                                        std::to_string(image_.width),
                                        std::to_string(image_.height),
                                        folder_ / "network.onnx",
                                        folder_ / "output"}) {
      command += " '" + argument + "'";
    }
    return WEXITSTATUS(std::system(command.c_str()));
  }

  const TemporaryFolder folder_;
  const TestImage image_ = TestImage::Texture(352, 288, 0.0, 0.0, 3);
};

TEST_P(ExportedNetworksTest, AgreesWithPyTorch) {
  const std::string weights = WeightsPath();
  if (weights.empty()) {
    GTEST_SKIP() << "there is no " << GetParam().weights
                 << " in the folder that MFIR_MODELS_DIR names";
  }
  const int exit_code = Export(weights);
  if (exit_code == 77) {
    GTEST_SKIP() << "needs the packages python3-torch and python3-onnx";
  }
  ASSERT_EQ(exit_code, 0);
  OnnxFeatureOptions options;
  options.path = folder_ / "network.onnx";
  options.mean = GetParam().mean;
  options.std = GetParam().std;
  options.tile_size = GetParam().tile_size;
  options.tile_overlap = GetParam().tile_overlap;
  image_.Write(folder_ / "image.png");
  Keypoints keypoints;
  for (int y = 0; y < image_.height; y += 16) {
    for (int x = 0; x < image_.width; x += 16) keypoints.emplace_back(x, y);
  }
  const DenseFeaturePatches patches =
      MakeOnnxFeatureSource(options, 16, 2, folder_.Path())
          ->Extract(image_.Request("image.png", keypoints));
  ASSERT_EQ(patches.num_channels, 128);
  ASSERT_EQ(patches.pixel_size, 1.0);
  const std::string bytes = ReadFile(folder_ / "output");
  const size_t num_pixels = static_cast<size_t>(image_.width) * image_.height;
  ASSERT_EQ(bytes.size(), 128 * num_pixels * sizeof(float));
  std::vector<float> expected(128 * num_pixels);
  std::memcpy(expected.data(), bytes.data(), bytes.size());
  double max_difference = 0.0;
  for (size_t i = 0; i < keypoints.size(); ++i) {
    ASSERT_TRUE(patches.valid[i]);
    for (int k = 0; k < 256; ++k) {
      const std::vector<float> feature = Descriptor(patches, i, k % 16, k / 16);
      const size_t pixel =
          static_cast<size_t>(patches.corners[i].y() + k / 16) * image_.width +
          patches.corners[i].x() + k % 16;
      for (int c = 0; c < 128; ++c) {
        max_difference = std::max<double>(
            max_difference,
            std::abs(feature[c] - expected[c * num_pixels + pixel]));
      }
    }
  }
  // Half precision alone makes 2^-12 for values between 0.5 and 1.
  RecordProperty("max_difference", std::to_string(max_difference));
  std::cout << GetParam().name << ": largest difference " << max_difference
            << std::endl;
  EXPECT_LT(max_difference, 4e-4);
}

INSTANTIATE_TEST_SUITE_P(
    All,
    ExportedNetworksTest,
    testing::Values(
        ExportedNetwork{
            "s2dnet", "-", "0.485,0.456,0.406", "0.229,0.224,0.225", 128, 4},
        ExportedNetwork{"r2d2",
                        "r2d2_WASF_N16.pt",
                        "0.485,0.456,0.406",
                        "0.229,0.224,0.225",
                        224,
                        25},
        // Its upsampling depends on the size of the input: one tile.
        ExportedNetwork{"alike", "alike-n.pth", "0,0,0", "1,1,1", 1024, 0}),
    [](const auto& info) { return std::string(info.param.name); });

}  // namespace
}  // namespace mfir

// COLMAP specializes std::vector for some Eigen types: before any use of them.
#include "colmap_ext/host/reconstruction.h"

#include <gtest/gtest.h>

#include "src/dense/cost_maps.h"
#include "src/util/errors.h"
#include "src/util/gpu_choice.h"
#include "src/util/random.h"
#include "tests/support/serial_sift.h"

namespace mfir {
namespace {

constexpr int kWidth = 60;
constexpr int kHeight = 50;
constexpr int kSiftPatchSize = 8;
constexpr size_t kNumCameras = 3;
constexpr size_t kNumFrames = 2;

// Dense SIFT of images of noise; those of camera 2 do not exist in frame 1.
class NoiseSource : public DenseFeatureSource {
 public:
  DenseFeaturePatches Extract(const DenseFeatureRequest& request) override {
    ++num_extractions_;
    SiftImage image;
    DenseFeaturePatches patches;
    ReadImage(request, &image, &patches);
    if (patches.patch_size == 0) return patches;
    std::vector<SiftCorner> corners;
    for (const Eigen::Vector2i& corner : patches.corners) {
      corners.push_back({corner.x(), corner.y()});
    }
    patches.data = SerialSiftPatches(image, corners, kSiftPatchSize);
    return patches;
  }

  bool ReadSiftImage(const DenseFeatureRequest& request,
                     SiftImage* image,
                     DenseFeaturePatches* patches) override {
    ++num_images_;
    ReadImage(request, image, patches);
    return true;
  }

  size_t num_extractions_ = 0;
  size_t num_images_ = 0;

 private:
  static void ReadImage(const DenseFeatureRequest& request,
                        SiftImage* image,
                        DenseFeaturePatches* patches) {
    if (request.camera_name == "2" && request.frame_name == "1") {
      *patches = NoPatches(request);
      return;
    }
    *image = {request.width, request.height, 4, {}};
    Random random({static_cast<uint64_t>(std::stoi(request.camera_name))});
    for (int i = 0; i < kWidth * kHeight; ++i) {
      image->grey.push_back(static_cast<float>(random.Uniform(0.0, 255.0)));
    }
    *patches =
        PlaceEmptyPatches(request, kSiftPatchSize, kNumSiftChannels, 1.0);
  }
};

// A GPU that computes on the CPU, and fails when its calls are used up.
class TestGpu : public CostMapBackend {
 public:
  explicit TestGpu(int num_calls)
      : calls_left_(std::make_shared<int>(num_calls)) {}

  std::string Name() const override { return "test GPU"; }
  std::vector<int64_t> FindReferences(const std::vector<uint16_t>& features,
                                      const std::vector<int64_t>& track_begins,
                                      int num_channels,
                                      float loss_scale) override {
    return cpu_->FindReferences(
        features, track_begins, num_channels, loss_scale);
  }
  void ComputeMaps(const PatchShape&,
                   float,
                   const std::vector<CostMapJob>&) override {
    ADD_FAILURE() << "patches come from the host";
  }
  bool ComputesSift() const override { return true; }
  std::unique_ptr<DeviceSift> LoadSift(const SiftImage& image) override {
    Count(calls_left_.get());
    return std::make_unique<Sift>(image, calls_left_);
  }

 private:
  class Sift final : public SerialSift {
   public:
    Sift(const SiftImage& image, std::shared_ptr<int> calls_left)
        : SerialSift(image), calls_left_(std::move(calls_left)) {}
    void Interpolate(const std::vector<DenseSiftKeypoint>& keypoints,
                     uint16_t* features) override {
      Count(calls_left_.get());
      SerialSift::Interpolate(keypoints, features);
    }
    void ComputeMaps(int patch_size,
                     const std::vector<SiftMapJob>& jobs) override {
      Count(calls_left_.get());
      SerialSift::ComputeMaps(patch_size, jobs);
    }

   private:
    const std::shared_ptr<int> calls_left_;
  };

  static void Count(int* calls_left) {
    if ((*calls_left)-- == 0) throw GpuError("it is broken");
  }

  const std::unique_ptr<CostMapBackend> cpu_ = CreateCpuCostMapBackend(1);
  const std::shared_ptr<int> calls_left_;
};

Scene MakeScene() {
  Random random({3});
  Scene scene;
  for (size_t i = 0; i < kNumCameras; ++i) {
    RigCamera camera;
    camera.name = std::to_string(i);
    camera.width = kWidth;
    camera.height = kHeight;
    scene.cameras.push_back(camera);
  }
  for (size_t f = 0; f < kNumFrames; ++f) {
    Frame frame;
    frame.name = std::to_string(f);
    for (size_t i = 0; i < kNumCameras; ++i) {
      frame.images.push_back({i, std::to_string(i) + ".png"});
    }
    for (uint32_t k = 0; k < 12; ++k) {
      for (size_t i = 0; i < kNumCameras; ++i) {
        // Some outside of the image.
        Observation observation;
        observation.image_idx = i;
        observation.xy = {random.Uniform(-2.0, kWidth + 2.0),
                          random.Uniform(0.0, kHeight)};
        observation.keypoint_idx = k;
        frame.observations.push_back(observation);
      }
      frame.track_begins.push_back(frame.observations.size());
    }
    scene.frames.push_back(frame);
  }
  return scene;
}

struct Result {
  Scene scene;
  std::vector<CostMapSummary> summaries;
  NoiseSource source;
};

constexpr int kUnlimited = 1000;

Result Compute(int use_gpu,
               int num_gpu_calls = kUnlimited,
               size_t max_kept_bytes = size_t{1} << 30) {
  CostMapOptions options;
  options.use_gpu = use_gpu;
  options.num_threads = 1;
  options.max_kept_bytes = max_kept_bytes;
  Result result;
  result.scene = ComputeCostMaps(
      options,
      &result.source,
      [&](size_t, const CostMapSummary& summary) {
        result.summaries.push_back(summary);
      },
      MakeScene(),
      [&](int, int) { return std::make_unique<TestGpu>(num_gpu_calls); });
  return result;
}

void ExpectEqual(const Scene& a, const Scene& b) {
  for (size_t f = 0; f < kNumFrames; ++f) {
    const Frame& frame = a.frames[f];
    for (size_t k = 0; k < frame.observations.size(); ++k) {
      ASSERT_EQ(frame.observations[k].cost_map_idx,
                b.frames[f].observations[k].cost_map_idx);
    }
    const CostMaps& maps = *frame.cost_maps;
    ASSERT_GT(maps.placements.size(), 10u);
    ASSERT_EQ(maps.placements.size(), b.frames[f].cost_maps->placements.size());
    for (size_t i = 0; i < maps.placements.size(); ++i) {
      EXPECT_EQ(maps.placements[i].origin,
                b.frames[f].cost_maps->placements[i].origin);
    }
    ASSERT_EQ(maps.data.size(), b.frames[f].cost_maps->data.size());
    for (size_t i = 0; i < maps.data.size(); ++i) {
      // Weights of the interpolation are rounded in another order.
      ASSERT_NEAR(HalfToFloat(maps.data[i]),
                  HalfToFloat(b.frames[f].cost_maps->data[i]),
                  4e-3)
          << i;
    }
  }
}

TEST(SiftCostMaps, OnAGpuEqualThoseOfPatches) {
  const Result cpu = Compute(0);
  EXPECT_EQ(cpu.source.num_images_, 0u);
  EXPECT_EQ(cpu.summaries[0].device, "CPU");
  for (const int use_gpu : {-1, 1}) {
    const Result gpu = Compute(use_gpu);
    EXPECT_EQ(gpu.source.num_extractions_, 0u);
    EXPECT_EQ(gpu.source.num_images_, kNumFrames * kNumCameras);
    EXPECT_EQ(gpu.summaries[1].device, "test GPU");
    EXPECT_EQ(gpu.summaries[1].fallback, "");
    ExpectEqual(gpu.scene, cpu.scene);
  }
}

TEST(SiftCostMaps, ImagesThatAreNotKeptAreReadAgain) {
  constexpr size_t kImageBytes = kWidth * kHeight * sizeof(float);
  const Result none = Compute(1, kUnlimited, 0);
  // All but the one that does not exist.
  EXPECT_EQ(none.source.num_images_, 2 * kNumFrames * kNumCameras - 1);
  const Result one = Compute(1, kUnlimited, 2 * kImageBytes - 1);
  EXPECT_EQ(one.source.num_images_, none.source.num_images_ - kNumFrames);
  ExpectEqual(none.scene, Compute(1).scene);
}

TEST(SiftCostMaps, AGpuThatFailsIsReplacedByTheCpu) {
  const Result cpu = Compute(0);
  // Per frame: two for each image, then one for each.
  constexpr int kNumCalls = 9 + 6;
  for (int num_calls = 0; num_calls < kNumCalls; ++num_calls) {
    const Result result = Compute(-1, num_calls);
    EXPECT_GT(result.source.num_extractions_, 0u) << num_calls;
    ExpectEqual(result.scene, cpu.scene);
    EXPECT_EQ(result.summaries[1].device, "CPU");
    EXPECT_EQ(result.summaries[0].fallback + result.summaries[1].fallback,
              "Cost maps are computed on the CPU: it is broken");
    EXPECT_THROW(Compute(1, num_calls), UsageError);
  }
  EXPECT_EQ(Compute(-1, kNumCalls).source.num_extractions_, 0u);
}

}  // namespace
}  // namespace mfir

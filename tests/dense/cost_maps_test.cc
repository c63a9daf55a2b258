// COLMAP specializes std::vector for some Eigen types: before any use of them.
#include "colmap_ext/host/reconstruction.h"

#include "src/dense/cost_maps.h"

#include <cmath>
#include <functional>
#include <limits>
#include <set>

#include <gtest/gtest.h>

#include "src/dense/cost_map_kernels.h"
#include "src/residuals/featuremetric_residual.h"
#include "src/util/errors.h"
#include "tests/support/test_features.h"
#include "tests/support/test_scenes.h"

namespace mfir {
namespace {

// Of the field, and one for each camera.
constexpr int kNumFieldChannels = 24;
constexpr int kNumChannels = kNumFieldChannels + 5;

// Features that depend smoothly on where, relative to the true projection, a
// pixel lies. Every camera sees the same surface, turned by an angle of its
// own: the mistake of a constant offset in all images does not cancel.
class FieldSource : public DenseFeatureSource {
 public:
  // `true_xy` by frame, image and keypoint.
  using TruePositions =
      std::map<std::string,
               std::map<std::string, std::map<uint32_t, Eigen::Vector2d>>>;

  explicit FieldSource(TruePositions true_xy) : true_xy_(std::move(true_xy)) {}

  DenseFeaturePatches Extract(const DenseFeatureRequest& request) override {
    ++num_extractions_;
    DenseFeaturePatches patches;
    patches.patch_size = patch_size_;
    patches.num_channels = kNumChannels;
    patches.pixel_size = pixel_size_;
    std::vector<double> data;
    for (size_t i = 0; i < request.keypoints.size(); ++i) {
      const Eigen::Vector2d corner =
          request.keypoints[i] / pixel_size_ -
          0.5 * patch_size_ * Eigen::Vector2d::Ones();
      patches.corners.push_back(corner.array().round().matrix().cast<int>());
      patches.valid.push_back(true);
      AddPatch(request, i, patches.corners[i].cast<double>(), &data);
    }
    patches.data = ToHalf(data);
    edit_(request, &patches);
    return patches;
  }

  int patch_size_ = 16;
  bool RepeatsCheaply() const override { return repeats_cheaply_; }

  bool repeats_cheaply_ = false;
  double pixel_size_ = 1.0;
  // The mistake of taking pixel i for image coordinate i.
  double pixel_center_ = 0.5;
  std::function<void(const DenseFeatureRequest&, DenseFeaturePatches*)> edit_ =
      [](const DenseFeatureRequest&, DenseFeaturePatches*) {};
  size_t num_extractions_ = 0;

 private:
  void AddPatch(const DenseFeatureRequest& request,
                size_t idx,
                const Eigen::Vector2d& corner,
                std::vector<double>* data) {
    const uint32_t id = request.keypoint_ids[idx];
    const int camera = request.image_name[6] - '0';
    const double angle = 1.3 * camera;
    const Eigen::Vector2d& true_xy =
        true_xy_.at(request.frame_name).at(request.image_name).at(id);
    for (int row = 0; row < patch_size_; ++row) {
      for (int column = 0; column < patch_size_; ++column) {
        const Eigen::Vector2d center =
            pixel_size_ * (corner + Eigen::Vector2d(column + pixel_center_,
                                                    row + pixel_center_));
        Random random({77});  // the same field everywhere
        for (int c = 0; c < kNumFieldChannels; ++c) {
          const double phase = random.Uniform(0.0, 6.28);
          const double x = random.Normal(0.0, 0.15);
          const double y = random.Normal(0.0, 0.15);
          const Eigen::Vector2d d =
              Eigen::Rotation2Dd(angle) * (center - true_xy);
          data->push_back(std::cos(phase + x * d.x() + y * d.y()) /
                          std::sqrt(0.5 * kNumFieldChannels));
        }
        // Views differ, as they do in reality.
        for (int c = 0; c < 5; ++c) data->push_back(c == camera ? 0.5 : 0.0);
      }
    }
  }

  TruePositions true_xy_;
};

struct FeatureScene {
  Scene scene;  // exact keypoints
  FieldSource source;
};

FeatureScene MakeFeatureScene() {
  TestSceneOptions options;
  options.num_cameras = 5;
  options.num_points = 30;
  options.track_length = 4;
  Scene scene = MakeTestScene(options).truth.scene;
  FieldSource::TruePositions true_xy;
  for (size_t f = 0; f < scene.frames.size(); ++f) {
    Frame& frame = scene.frames[f];
    frame.name = "frame" + std::to_string(f);
    for (FrameImage& image : frame.images) {
      image.name = "camera" + std::to_string(image.camera_idx) + ".png";
    }
    for (size_t k = 0; k < frame.observations.size(); ++k) {
      Observation& observation = frame.observations[k];
      observation.keypoint_idx = static_cast<uint32_t>(1000 + 3 * k);
      true_xy[frame.name][frame.images[observation.image_idx].name]
             [observation.keypoint_idx] = observation.xy;
    }
  }
  return {scene, FieldSource(true_xy)};
}

std::vector<CostMapSummary> Compute(const CostMapOptions& options,
                                    FeatureScene* setup) {
  std::vector<CostMapSummary> summaries;
  setup->scene = ComputeCostMaps(
      options,
      &setup->source,
      [&](size_t frame_idx, const CostMapSummary& summary) {
        EXPECT_EQ(frame_idx, summaries.size());
        summaries.push_back(summary);
      },
      std::move(setup->scene));
  return summaries;
}

CostMapOptions CpuOptions() {
  CostMapOptions options;
  options.use_gpu = 0;
  options.num_threads = 2;
  return options;
}

// Position (in steps of 0.01 px) around `xy` where the distance is least.
Eigen::Vector2d Minimum(const CostMaps& maps,
                        size_t idx,
                        const Eigen::Vector2d& xy) {
  Eigen::Vector2d best;
  double min_distance = std::numeric_limits<double>::infinity();
  for (double dx = -1.0; dx <= 1.0; dx += 0.02) {
    for (double dy = -1.0; dy <= 1.0; dy += 0.02) {
      Eigen::Vector3d residual;
      EvaluateFeaturemetric(
          maps, idx, xy + Eigen::Vector2d(dx, dy), &residual, nullptr);
      if (residual(0) < min_distance) {
        min_distance = residual(0);
        best = xy + Eigen::Vector2d(dx, dy);
      }
    }
  }
  return best;
}

// Largest distance (px) of the minima of the cost maps from the keypoints.
double MaxMinimumOffset(const Scene& scene) {
  double max_offset = 0.0;
  for (const Frame& frame : scene.frames) {
    for (size_t k = 0; k < 16; ++k) {
      const Observation& observation = frame.observations[k];
      EXPECT_GE(observation.cost_map_idx, 0);
      const Eigen::Vector2d minimum =
          Minimum(*frame.cost_maps,
                  static_cast<size_t>(observation.cost_map_idx),
                  observation.xy);
      // The distance from an own feature has a kink at zero, which the
      // interpolation cannot follow: its minimum is off by up to 0.4 px.
      Eigen::Vector3d residual;
      EvaluateFeaturemetric(*frame.cost_maps,
                            static_cast<size_t>(observation.cost_map_idx),
                            minimum,
                            &residual,
                            nullptr);
      if (residual(0) < 0.5) continue;
      max_offset = std::max(max_offset, (minimum - observation.xy).norm());
    }
  }
  return max_offset;
}

TEST(CostMaps, LeastAtTheTrueProjections) {
  for (const double pixel_size : {1.0, 1.5}) {
    FeatureScene setup = MakeFeatureScene();
    setup.source.pixel_size_ = pixel_size;
    const auto summaries = Compute(CpuOptions(), &setup);
    ASSERT_EQ(summaries.size(), 2u);
    for (const CostMapSummary& summary : summaries) {
      EXPECT_EQ(summary.num_observations, 120u);
      EXPECT_EQ(summary.num_cost_maps, 120u);
      EXPECT_EQ(summary.device, "CPU");
      EXPECT_EQ(summary.fallback, "");
    }
    EXPECT_LT(MaxMinimumOffset(setup.scene), 0.15 * pixel_size);
  }
}

TEST(CostMaps, NoneWithoutKeypoint) {
  FeatureScene setup = MakeFeatureScene();
  std::vector<Observation>& observations = setup.scene.frames[1].observations;
  observations[5].keypoint_idx = kNoKeypoint;
  EXPECT_EQ(Compute(CpuOptions(), &setup)[1].num_cost_maps, 119u);
  EXPECT_EQ(observations[5].cost_map_idx, -1);
}

TEST(CostMaps, HalfPixelMistakeShows) {
  FeatureScene setup = MakeFeatureScene();
  setup.source.pixel_center_ = 0.0;
  Compute(CpuOptions(), &setup);
  EXPECT_GT(MaxMinimumOffset(setup.scene), 0.5);
}

TEST(CostMaps, EqualThoseOfTheirPatches) {
  FeatureScene setup = MakeFeatureScene();
  std::map<std::pair<std::string, uint32_t>, std::vector<uint16_t>> patches;
  setup.source.edit_ = [&](const DenseFeatureRequest& request,
                           DenseFeaturePatches* extracted) {
    for (size_t i = 0; i < request.keypoints.size(); ++i) {
      const auto begin =
          extracted->data.begin() + i * extracted->PatchNumElements();
      patches[{request.frame_name, request.keypoint_ids[i]}].assign(
          begin, begin + extracted->PatchNumElements());
    }
  };
  Compute(CpuOptions(), &setup);
  const PatchShape shape = {16, kNumChannels};
  const Frame& frame = setup.scene.frames[1];
  for (size_t k = 0; k < frame.observations.size(); ++k) {
    const Observation& observation = frame.observations[k];
    const std::vector<uint16_t>& patch =
        patches.at({frame.name, observation.keypoint_idx});
    const uint16_t* map =
        frame.cost_maps->Data(static_cast<size_t>(observation.cost_map_idx));
    // Distances of two pixels from the reference obey the triangle inequality.
    const Eigen::MatrixXd features =
        ToMatrix(patch.data(), shape.num_channels, shape.NumPixels());
    for (int pixel = 1; pixel < shape.NumPixels(); ++pixel) {
      const double distance = (features.col(pixel) - features.col(0)).norm();
      const double first = HalfToFloat(map[0]);
      const double other = HalfToFloat(map[3 * pixel]);
      ASSERT_LE(std::abs(first - other), distance + 2e-3);
      ASSERT_GE(first + other, distance - 2e-3);
    }
  }
}

TEST(CostMaps, SameWhetherPatchesAreKeptOrAskedForAgain) {
  FeatureScene kept = MakeFeatureScene();
  FeatureScene again = MakeFeatureScene();
  CostMapOptions options = CpuOptions();
  EXPECT_EQ(Compute(options, &kept)[0].num_extractions, 5u);
  options.max_kept_bytes = 0;
  EXPECT_EQ(Compute(options, &again)[0].num_extractions, 10u);
  for (size_t f = 0; f < 2; ++f) {
    EXPECT_EQ(kept.scene.frames[f].cost_maps->data,
              again.scene.frames[f].cost_maps->data);
  }
  // Room for the patches of two images.
  FeatureScene some = MakeFeatureScene();
  options.max_kept_bytes = 2 * 30 * 256 * kNumChannels * 2;
  EXPECT_EQ(Compute(options, &some)[0].num_extractions, 8u);
  FeatureScene cheap = MakeFeatureScene();
  cheap.source.repeats_cheaply_ = true;
  EXPECT_EQ(Compute(CpuOptions(), &cheap)[0].num_extractions, 10u);
}

TEST(CostMaps, AtMost1600BytesPerObservation) {
  FeatureScene setup = MakeFeatureScene();
  Compute(CpuOptions(), &setup);
  const CostMaps& maps = *setup.scene.frames[0].cost_maps;
  const size_t bytes = maps.data.size() * sizeof(uint16_t) +
                       maps.placements.size() * sizeof(CostMaps::Placement);
  EXPECT_LE(bytes, 1600 * setup.scene.frames[0].observations.size());
}

TEST(CostMaps, ObservationsWithoutFeatureHaveNone) {
  FeatureScene setup = MakeFeatureScene();
  Frame& frame = setup.scene.frames[0];
  // Track 0: no feature at its first observation; track 1: NaN at the keypoint;
  // track 2: NaN elsewhere in the patch; track 3: one feature only.
  const auto id = [&](size_t track, size_t i) {
    return frame.observations[frame.track_begins[track] + i].keypoint_idx;
  };
  const std::set<uint32_t> invalid = {id(0, 0), id(3, 0), id(3, 1), id(3, 2)};
  setup.source.edit_ = [&](const DenseFeatureRequest& request,
                           DenseFeaturePatches* patches) {
    if (request.frame_name != frame.name) return;
    const size_t size = patches->PatchNumElements();
    for (size_t i = 0; i < request.keypoints.size(); ++i) {
      uint16_t* patch = patches->data.data() + i * size;
      if (invalid.count(request.keypoint_ids[i]) > 0) {
        patches->valid[i] = false;
        std::fill(patch, patch + size, 0);
      } else if (request.keypoint_ids[i] == id(1, 1)) {
        std::fill(patch, patch + size, 0x7e00);
      } else if (request.keypoint_ids[i] == id(2, 2)) {
        patch[5] = 0x7e00;
      }
    }
  };
  const auto summaries = Compute(CpuOptions(), &setup);
  EXPECT_EQ(summaries[0].num_cost_maps, 120u - 3u - 4u);
  EXPECT_EQ(summaries[1].num_cost_maps, 120u);
  std::set<int64_t> idxs;
  for (size_t track = 0; track < frame.NumPoints(); ++track) {
    for (size_t i = 0; i < 4; ++i) {
      const bool expected = !(track == 3 || (track == 0 && i == 0) ||
                              (track == 1 && i == 1) || (track == 2 && i == 2));
      const int64_t idx =
          frame.observations[frame.track_begins[track] + i].cost_map_idx;
      EXPECT_EQ(idx >= 0, expected) << track << " " << i;
      if (idx >= 0) {
        EXPECT_TRUE(idxs.insert(idx).second);
      }
    }
  }
}

TEST(CostMaps, SourceWithoutAnyFeature) {
  FeatureScene setup = MakeFeatureScene();
  setup.source.edit_ = [](const DenseFeatureRequest& request,
                          DenseFeaturePatches* patches) {
    const size_t count = request.keypoints.size();
    *patches = DenseFeaturePatches();
    patches->valid.assign(count, false);
    patches->corners.assign(count, Eigen::Vector2i::Zero());
  };
  EXPECT_EQ(Compute(CpuOptions(), &setup)[0].num_cost_maps, 0u);
  EXPECT_EQ(setup.scene.frames[0].cost_maps, nullptr);
}

TEST(CostMaps, BadPatchesAreErrors) {
  using Edit = std::function<void(DenseFeaturePatches*)>;
  for (const Edit& edit : {
           Edit([](DenseFeaturePatches* p) { p->valid.pop_back(); }),
           Edit([](DenseFeaturePatches* p) { p->data.pop_back(); }),
           Edit([](DenseFeaturePatches* p) { p->pixel_size = 0.0; }),
           Edit([](DenseFeaturePatches* p) {
             p->patch_size = 32;
             p->num_channels /= 4;
           }),
           Edit([](DenseFeaturePatches* p) {
             p->patch_size = 8;
             p->num_channels *= 4;
           }),
       }) {
    FeatureScene setup = MakeFeatureScene();
    setup.source.edit_ = [&](const DenseFeatureRequest& request,
                             DenseFeaturePatches* patches) {
      if (request.image_name == "camera2.png") edit(patches);
    };
    try {
      Compute(CpuOptions(), &setup);
      ADD_FAILURE() << "no error";
    } catch (const InputError& error) {
      EXPECT_NE(std::string(error.what()).find("camera2.png"),
                std::string::npos);
    }
  }
}

TEST(CostMaps, WithoutGpuOneLineOrAnError) {
  FeatureScene setup = MakeFeatureScene();
  CostMapOptions options = CpuOptions();
  options.gpu_index = 1000;
  options.use_gpu = -1;
  const auto summaries = Compute(options, &setup);
  EXPECT_EQ(summaries[0].device, "CPU");
  EXPECT_NE(summaries[0].fallback, "");
  EXPECT_EQ(summaries[0].fallback.find('\n'), std::string::npos);
  EXPECT_EQ(summaries[1].fallback, "");
  options.use_gpu = 1;
  EXPECT_THROW(Compute(options, &setup), UsageError);
}

}  // namespace
}  // namespace mfir

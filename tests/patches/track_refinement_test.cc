#include "src/patches/track_refinement.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "colmap_ext/models/camera_models.h"
#include "cuda/patch_alignment_gpu.h"
#include "src/simulation/image_renderer.h"
#include "src/simulation/synthetic_surface.h"
#include "src/util/gpu_choice.h"
#include "src/util/random.h"
#include "tests/support/patch_images.h"
#include "tests/support/test_scenes.h"

namespace mfir {
namespace {

constexpr size_t kNumCameras = 6;
constexpr size_t kNumTracks = 60;
constexpr double kFocalLength = 800.0;
constexpr size_t kViewWidth = 280;
constexpr size_t kViewHeight = 240;
constexpr double kKeypointNoise = 0.4;  // px per axis

// The head of the simulator in front of an arc of cameras, with exact truth.
struct Head {
  std::vector<PatchCamera> cameras;
  std::vector<SplineImage> images;
  std::vector<PatchTrack> tracks;  // in the first three cameras
  std::vector<Eigen::Vector3d> points;
};

Eigen::Vector3d CameraCenter(size_t i) {
  const double azimuth = 0.28 * (static_cast<double>(i) - 1.0);
  return {std::sin(azimuth), i % 2 == 0 ? -0.15 : 0.1, -std::cos(azimuth)};
}

Head MakeHead(double image_noise) {
  const SyntheticSurface surface(5, 0, 1.0, 3.0 / kFocalLength);
  const CameraModel* model = FindCameraModel("OPENCV");
  Head head;
  for (size_t i = 0; i < kNumCameras; ++i) {
    RigCamera camera;
    camera.model = model;
    camera.width = kViewWidth;
    camera.height = kViewHeight;
    camera.cam_from_world = LookAtOrigin(CameraCenter(i));
    camera.params = {kFocalLength + 3.0 * static_cast<double>(i),
                     kFocalLength,
                     143.0,
                     118.0,
                     -0.1,
                     0.05,
                     0.001,
                     -0.001};
    Random random({7, i});
    const GreyImage image =
        RenderImage(surface, camera, 0.5, image_noise, &random);
    head.cameras.push_back({model, camera.cam_from_world, camera.params});
    head.images.emplace_back(
        camera.width,
        camera.height,
        std::vector<float>(image.pixels.begin(), image.pixels.end()));
  }
  Random random({8});
  while (head.tracks.size() < kNumTracks) {
    // On the face, within 35 degrees of the direction to the middle camera.
    const Eigen::Vector3d direction =
        Eigen::Vector3d(
            random.Uniform(-0.5, 0.5), random.Uniform(-0.3, 0.3), -1.0)
            .normalized();
    const Eigen::Vector3d x = surface.Radius(direction) * direction;
    PatchTrack track;
    track.xyz = x + RandomVector(&random, 5e-4);
    for (size_t i = 0; i < 3; ++i) {
      const Eigen::Vector2d noise(random.Normal(0.0, kKeypointNoise),
                                  random.Normal(0.0, kKeypointNoise));
      track.observations.push_back(
          {i, ProjectInto(head.cameras[i], x) + noise});
    }
    head.points.push_back(x);
    head.tracks.push_back(track);
  }
  return head;
}

const Head& SharedHead() {
  static const Head& head = *new Head(MakeHead(2.0));
  return head;
}

// The surface point at a keypoint, by the ray through it.
Eigen::Vector3d SurfacePoint(const PatchCamera& camera,
                             const Eigen::Vector2d& xy) {
  const SyntheticSurface surface(5, 0, 1.0, 3.0 / kFocalLength);
  double uv[2];
  camera.model->Unproject(camera.params.data(), xy.x(), xy.y(), uv);
  const Eigen::Vector3d center = camera.cam_from_world.Center();
  const Eigen::Vector3d ray = (camera.cam_from_world.rotation.conjugate() *
                               Eigen::Vector3d(uv[0], uv[1], 1.0))
                                  .normalized();
  return center + *surface.Intersect(center, ray) * ray;
}

// Distances of observations with an outcome from where the reference keypoint's
// surface point is seen.
std::vector<double> Errors(const Head& head,
                           const TrackRefinement& refinement,
                           PatchOutcome outcome,
                           Eigen::Vector2d* mean) {
  std::vector<double> errors;
  *mean = Eigen::Vector2d::Zero();
  for (const RefinedTrack& track : refinement.tracks) {
    for (const RefinedObservation& reference : track.observations) {
      if (reference.outcome != PatchOutcome::kReference) continue;
      const Eigen::Vector3d point =
          SurfacePoint(head.cameras[reference.camera_idx], reference.xy);
      for (const RefinedObservation& observation : track.observations) {
        if (observation.outcome != outcome) continue;
        const Eigen::Vector2d error =
            observation.xy -
            ProjectInto(head.cameras[observation.camera_idx], point);
        errors.push_back(error.norm());
        *mean += error;
      }
    }
  }
  if (!errors.empty()) *mean /= static_cast<double>(errors.size());
  return errors;
}

double Quantile(std::vector<double> values, double q) {
  std::sort(values.begin(), values.end());
  return values[static_cast<size_t>(q * (values.size() - 1))];
}

TEST(RefinePatchTracks, AlignsKeypointsAndCompletesTracks) {
  const Head& head = SharedHead();
  const TrackRefinement refinement =
      RefinePatchTracks({}, head.cameras, head.images, head.tracks);
  EXPECT_FALSE(refinement.unchanged);
  EXPECT_GT(refinement.num_refined_tracks, kNumTracks / 2);
  Eigen::Vector2d mean;
  const std::vector<double> aligned =
      Errors(head, refinement, PatchOutcome::kAligned, &mean);
  ASSERT_GT(aligned.size(), kNumTracks / 2);
  // Before: noise of two keypoints, 0.4 * sqrt(2) per axis.
  EXPECT_LT(Quantile(aligned, 0.5), 0.1);
  EXPECT_LT(Quantile(aligned, 0.9), 0.25);
  EXPECT_LT(mean.norm(), 0.04);
  const std::vector<double> added =
      Errors(head, refinement, PatchOutcome::kAdded, &mean);
  ASSERT_GT(added.size(), kNumTracks / 2);
  EXPECT_LT(Quantile(added, 0.5), 0.17);
  EXPECT_LT(Quantile(added, 0.9), 0.5);
  EXPECT_LT(mean.norm(), 0.1);
}

TEST(RefinePatchTracks, CountsEveryObservationOnce) {
  const Head& head = SharedHead();
  const TrackRefinement refinement =
      RefinePatchTracks({}, head.cameras, head.images, head.tracks);
  size_t sum = 0;
  for (const size_t count : refinement.num_observations) sum += count;
  EXPECT_EQ(sum,
            3 * kNumTracks + refinement.NumObservations(PatchOutcome::kAdded));
  size_t num_left = 0;
  for (const RefinedTrack& track : refinement.tracks) {
    num_left += track.observations.size();
    EXPECT_GE(track.observations.size(), 2u);
    std::set<size_t> seen;
    for (const RefinedObservation& observation : track.observations) {
      EXPECT_FALSE(IsDropped(observation.outcome));
      EXPECT_TRUE(seen.insert(observation.camera_idx).second);
      if (observation.outcome == PatchOutcome::kReference) {
        EXPECT_EQ(observation.xy,
                  head.tracks[track.source_idx]
                      .observations[observation.source_idx]
                      .xy);
      }
    }
  }
  EXPECT_EQ(num_left, sum - refinement.NumDropped());
  for (size_t i = 0; i < kNumCameras; ++i) {
    EXPECT_EQ(refinement.num_before[i], i < 3 ? kNumTracks : 0);
  }
}

void ExpectSame(const TrackRefinement& one, const TrackRefinement& other) {
  EXPECT_EQ(one.num_observations, other.num_observations);
  ASSERT_EQ(one.tracks.size(), other.tracks.size());
  for (size_t i = 0; i < one.tracks.size(); ++i) {
    ASSERT_EQ(one.tracks[i].observations.size(),
              other.tracks[i].observations.size());
    EXPECT_EQ(one.tracks[i].xyz, other.tracks[i].xyz);
    for (size_t k = 0; k < one.tracks[i].observations.size(); ++k) {
      EXPECT_EQ(one.tracks[i].observations[k].xy,
                other.tracks[i].observations[k].xy);
    }
  }
}

TEST(RefinePatchTracks, ThreadsDoNotMatter) {
  const Head& head = SharedHead();
  TrackRefinementOptions options;
  options.num_threads = 1;
  const TrackRefinement one =
      RefinePatchTracks(options, head.cameras, head.images, head.tracks);
  options.num_threads = 3;
  const TrackRefinement three =
      RefinePatchTracks(options, head.cameras, head.images, head.tracks);
  ExpectSame(one, three);
}

// Some whose first reference, or all, are at the border; some with an
// observation more in a camera that has one.
std::vector<PatchTrack> DamagedTracks(std::vector<PatchTrack> tracks) {
  for (size_t i = 0; i < tracks.size(); ++i) {
    std::vector<PatchObservation>& observations = tracks[i].observations;
    if (i % 3 == 0) observations.push_back({0, {50.0, 50.0}});
    if (i % 4 == 0) observations[1].xy.x() = 3.0;
    if (i % 8 == 0) observations[0].xy.x() = observations[2].xy.x() = 3.0;
    if (i % 5 == 0) observations[2].xy.y() += 2.0;
  }
  return tracks;
}

// As they are on a GPU, beside one at a time.
TEST(RefinePatchTracks, AllTracksTogetherGiveTheSame) {
  const Head& head = SharedHead();
  const std::vector<PatchTrack> tracks = DamagedTracks(head.tracks);
  for (const bool refine_keypoints : {true, false}) {
    TrackRefinementOptions options;
    options.refine_keypoints = refine_keypoints;
    options.num_threads = 2;
    CpuPatchBackend together;
    const TrackRefinement one =
        RefinePatchTracks(options, head.cameras, head.images, tracks);
    const TrackRefinement all = RefinePatchTracks(
        options, head.cameras, head.images, tracks, &together);
    EXPECT_GT(one.num_refined_tracks, kNumTracks / 2);
    EXPECT_LT(one.num_refined_tracks, kNumTracks);
    ExpectSame(one, all);
  }
}

// Fails late, with a part of the work done.
class BrokenGpu final : public PatchBackend {
 public:
  explicit BrokenGpu(int* num_calls) : num_calls_(num_calls) {}
  std::string Name() const override { return "broken"; }
  void SetImages(const std::vector<SplineImage>& images) override {
    cpu_.SetImages(images);
  }
  void SetTemplates(const std::vector<PatchTemplate>& templates) override {
    cpu_.SetTemplates(templates);
  }
  void Fit(const std::vector<PatchJob>& jobs,
           std::vector<PatchFit>* results) override {
    cpu_.Fit(jobs, results);
  }
  void Align(const std::vector<PatchJob>& jobs,
             std::vector<AlignedPatch>* results) override {
    cpu_.Align(jobs, results);
  }
  void Search(const std::vector<PatchJob>&, std::vector<FoundPatch>*) override {
    ++*num_calls_;
    throw GpuError("it broke");
  }

 private:
  int* num_calls_;
  CpuPatchBackend cpu_;
};

TEST(RefinePatchTracks, WhereAGpuFailsTheCpuRepeatsTheFrame) {
  const Head& head = SharedHead();
  int num_calls = 0;
  GpuChoice<PatchBackend> gpu(-1, "Keypoints are refined on the CPU", [&] {
    return std::make_unique<BrokenGpu>(&num_calls);
  });
  TrackRefinement refinement;
  gpu.Call([&](PatchBackend* backend) {
    refinement =
        RefinePatchTracks({}, head.cameras, head.images, head.tracks, backend);
  });
  EXPECT_EQ(num_calls, 1);
  EXPECT_EQ(gpu.TakeFallback(), "Keypoints are refined on the CPU: it broke");
  ExpectSame(refinement,
             RefinePatchTracks({}, head.cameras, head.images, head.tracks));
}

// The twin of the GPU, where there is one.
TEST(RefinePatchTracks, OnAGpuAsOnTheCpu) {
  std::unique_ptr<PatchBackend> gpu;
  try {
    gpu = CreateGpuPatchBackend(-1);
  } catch (const GpuError& error) {
    GTEST_SKIP() << "no GPU: " << error.what();
  }
  const Head& head = SharedHead();
  const TrackRefinement expected =
      RefinePatchTracks({}, head.cameras, head.images, head.tracks);
  const TrackRefinement refinement =
      RefinePatchTracks({}, head.cameras, head.images, head.tracks, gpu.get());
  const auto positions = [](const TrackRefinement& result) {
    std::map<std::pair<size_t, size_t>, Eigen::Vector2d> map;
    for (const RefinedTrack& track : result.tracks) {
      for (const RefinedObservation& observation : track.observations) {
        map[{track.source_idx, observation.camera_idx}] = observation.xy;
      }
    }
    return map;
  };
  const auto expected_positions = positions(expected);
  std::vector<double> distances;
  for (const auto& [key, xy] : positions(refinement)) {
    const auto it = expected_positions.find(key);
    if (it != expected_positions.end()) {
      distances.push_back((it->second - xy).norm());
    }
  }
  // All but a few at the limits.
  EXPECT_GT(distances.size(), expected_positions.size() * 98 / 100);
  EXPECT_LT(Quantile(distances, 0.5), 1e-4);
  EXPECT_LT(Quantile(distances, 0.98), 2e-3);
}

TEST(RefinePatchTracks, EachOptionDoesItsPart) {
  const Head& head = SharedHead();
  TrackRefinementOptions options;
  options.complete_tracks = false;
  const TrackRefinement aligned =
      RefinePatchTracks(options, head.cameras, head.images, head.tracks);
  EXPECT_GT(aligned.NumObservations(PatchOutcome::kAligned), 0u);
  EXPECT_EQ(aligned.NumObservations(PatchOutcome::kAdded), 0u);
  options = {};
  options.refine_keypoints = false;
  const TrackRefinement completed =
      RefinePatchTracks(options, head.cameras, head.images, head.tracks);
  EXPECT_EQ(completed.NumObservations(PatchOutcome::kAligned), 0u);
  EXPECT_GT(completed.NumObservations(PatchOutcome::kAdded), 0u);
  EXPECT_EQ(completed.NumDropped(), 0u);
  EXPECT_EQ(completed.tracks.size(), kNumTracks);
  for (const RefinedTrack& track : completed.tracks) {
    for (const RefinedObservation& observation : track.observations) {
      if (observation.source_idx == kNoSource) continue;
      EXPECT_EQ(observation.xy,
                head.tracks[track.source_idx]
                    .observations[observation.source_idx]
                    .xy);
    }
  }
}

TEST(RefinePatchTracks, CamerasWithoutImageKeepTheirKeypoints) {
  const Head& head = SharedHead();
  std::vector<SplineImage> images = head.images;
  images[1] = SplineImage();
  images[5] = SplineImage();
  const TrackRefinement refinement =
      RefinePatchTracks({}, head.cameras, images, head.tracks);
  EXPECT_FALSE(refinement.unchanged);
  size_t num_kept = 0;
  for (const RefinedTrack& track : refinement.tracks) {
    for (const RefinedObservation& observation : track.observations) {
      EXPECT_NE(observation.camera_idx, 5u);
      if (observation.camera_idx != 1) continue;
      ++num_kept;
      EXPECT_EQ(observation.outcome, PatchOutcome::kUntouched);
      EXPECT_EQ(observation.xy,
                head.tracks[track.source_idx].observations[1].xy);
    }
  }
  EXPECT_GT(num_kept, kNumTracks / 2);
  // No image at all.
  const TrackRefinement nothing = RefinePatchTracks(
      {}, head.cameras, std::vector<SplineImage>(kNumCameras), head.tracks);
  EXPECT_TRUE(nothing.unchanged);
  ASSERT_EQ(nothing.tracks.size(), kNumTracks);
  EXPECT_EQ(nothing.tracks[3].observations.size(), 3u);
  EXPECT_EQ(nothing.NumObservations(PatchOutcome::kUntouched), 3 * kNumTracks);
}

TEST(RefinePatchTracks, DefocusedCameraKeepsItsKeypoints) {
  const Head& head = SharedHead();
  std::vector<SplineImage> images = head.images;
  images[2] = RenderFunction(kViewWidth, kViewHeight, [](double x, double y) {
    return 0.1 * x + 0.05 * y;
  });
  const TrackRefinement refinement =
      RefinePatchTracks({}, head.cameras, images, head.tracks);
  EXPECT_TRUE(refinement.is_kept[2]);
  EXPECT_FALSE(refinement.is_kept[0]);
  EXPECT_EQ(refinement.num_refined[2], 0u);
}

TEST(RefinePatchTracks, OtherImagesChangeNothing) {
  const Head& head = SharedHead();
  std::vector<SplineImage> images;
  Random random({9});
  for (size_t i = 0; i < kNumCameras; ++i) {
    images.push_back(
        RenderFunction(kViewWidth, kViewHeight, [&](double, double) {
          return random.Uniform(0.0, 255.0);
        }));
  }
  const TrackRefinement refinement =
      RefinePatchTracks({}, head.cameras, images, head.tracks);
  EXPECT_TRUE(refinement.unchanged);
}

TEST(RefinePatchTracks, PositionsComeFromTheImagesNotFromTheGeometry) {
  const Head& head = SharedHead();
  // 0.2 % of the focal length, up to half a pixel of the principal point.
  std::vector<PatchCamera> cameras = head.cameras;
  Random random({10});
  for (PatchCamera& camera : cameras) {
    camera.params[0] *= 1.002;
    camera.params[1] *= 1.002;
    camera.params[2] += random.Uniform(-0.5, 0.5);
    camera.params[3] += random.Uniform(-0.5, 0.5);
  }
  const TrackRefinement exact =
      RefinePatchTracks({}, head.cameras, head.images, head.tracks);
  const TrackRefinement perturbed =
      RefinePatchTracks({}, cameras, head.images, head.tracks);
  std::map<std::pair<size_t, size_t>, Eigen::Vector2d> positions;
  for (const RefinedTrack& track : exact.tracks) {
    for (const RefinedObservation& observation : track.observations) {
      positions[{track.source_idx, observation.camera_idx}] = observation.xy;
    }
  }
  std::vector<double> distances;
  for (const RefinedTrack& track : perturbed.tracks) {
    for (const RefinedObservation& observation : track.observations) {
      const auto it =
          positions.find({track.source_idx, observation.camera_idx});
      if (it == positions.end()) continue;
      distances.push_back((it->second - observation.xy).norm());
    }
  }
  ASSERT_GT(distances.size(), kNumTracks);
  EXPECT_LT(Quantile(distances, 0.5), 0.01);
  EXPECT_LT(Quantile(distances, 0.9), 0.05);
}

TEST(RefinePatchTracks, NoTracks) {
  const Head& head = SharedHead();
  const TrackRefinement refinement =
      RefinePatchTracks({}, head.cameras, head.images, {});
  EXPECT_TRUE(refinement.tracks.empty());
}

}  // namespace
}  // namespace mfir

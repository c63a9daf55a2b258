#include "colmap_ext/simulation/simulator.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numeric>

#include "colmap_ext/host/bundle_adjustment.h"
#include "colmap_ext/models/camera_models.h"
#include "colmap_ext/simulation/simulated_rig.h"
#include "src/parallel/parallel_for.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

// Keypoints keep this distance from the image border, in pixels.
constexpr double kBorder = 5.0;
// Structure from motion does not register images with fewer observations.
constexpr size_t kMinObservationsPerImage = 10;

struct SurfacePoint {
  Eigen::Vector3d xyz;          // rig coordinates
  double brightness = 0.0;      // [0, 1]
  std::vector<size_t> cameras;  // that observe it, ascending
};

struct Keypoint {
  Eigen::Vector2d true_xy;  // pixels
  Eigen::Vector2d xy;       // with noise or as outlier
  int point_idx = -1;       // -1: unmatched
  bool is_outlier = false;
};

bool IsInside(const RigCamera& camera,
              const Eigen::Vector2d& xy,
              double border) {
  return xy.x() >= border && xy.x() <= camera.width - border &&
         xy.y() >= border && xy.y() <= camera.height - border;
}

// Whether `camera` sees the surface point `xyz`: in the image and the part of
// the lens model that can be inverted, not too obliquely, and with nothing in
// front of it.
bool IsVisible(const SyntheticSurface& surface,
               const RigCamera& camera,
               const Eigen::Vector3d& xyz,
               const Eigen::Vector3d& normal,
               double min_cos_angle) {
  const Eigen::Vector3d center = camera.cam_from_world.Center();
  const Eigen::Vector3d ray = (xyz - center).normalized();
  const Eigen::Vector3d xyz_cam = camera.cam_from_world * xyz;
  if (-ray.dot(normal) < min_cos_angle || xyz_cam.z() <= 0.0) {
    return false;
  }
  const Eigen::Vector2d uv = xyz_cam.hnormalized();
  Eigen::Vector2d xy, uv_back;
  camera.model->Project(camera.params.data(), uv.x(), uv.y(), xy.data());
  if (!IsInside(camera, xy, kBorder)) {
    return false;
  }
  camera.model->Unproject(camera.params.data(), xy.x(), xy.y(), uv_back.data());
  if (!((uv_back - uv).norm() < 1e-6)) {
    return false;
  }
  const double distance = (xyz - center).norm();
  const auto hit = surface.Intersect(center, ray);
  return hit && std::abs(*hit - distance) < 1e-4 * distance;
}

// A camera among `visible` and those nearest to it: matching works between
// neighbouring views, and not always with the very next.
std::vector<size_t> SelectViews(const SimulatorOptions& options,
                                const std::vector<RigCamera>& cameras,
                                const std::vector<size_t>& visible,
                                Random* random) {
  const int num_visible = static_cast<int>(visible.size());
  const int num_views = std::min(
      num_visible, random->Integer(options.min_views, options.max_views));
  const Eigen::Vector3d first_center =
      cameras[visible[random->Integer(0, num_visible - 1)]]
          .cam_from_world.Center();
  std::vector<std::pair<double, size_t>> distances;
  for (const size_t camera_idx : visible) {
    const Eigen::Vector3d center = cameras[camera_idx].cam_from_world.Center();
    distances.emplace_back(
        (center - first_center).norm() * random->Uniform(0.6, 1.4), camera_idx);
  }
  std::sort(distances.begin(), distances.end());
  std::vector<size_t> views;
  for (int i = 0; i < num_views; ++i) {
    views.push_back(distances[i].second);
  }
  std::sort(views.begin(), views.end());
  return views;
}

std::vector<SurfacePoint> SamplePoints(const SimulatorOptions& options,
                                       const std::vector<RigCamera>& cameras,
                                       const std::vector<bool>& has_image,
                                       size_t frame_idx) {
  const SyntheticSurface surface = SimulatedSurface(options, frame_idx);
  const double min_cos_angle = std::cos(options.max_view_angle * M_PI / 180.0);
  Random random({static_cast<uint64_t>(options.seed), kPointStream, frame_idx});
  std::vector<SurfacePoint> points;
  const size_t num_points = options.num_points;
  const size_t max_num_trials = 1000 + 200 * num_points;
  for (size_t trial = 0; points.size() < num_points; ++trial) {
    if (trial == max_num_trials) {
      throw UsageError(
          "Frame " + std::to_string(frame_idx) + ": only " +
          std::to_string(points.size()) + " of " + std::to_string(num_points) +
          " surface points are seen by " + std::to_string(options.min_views) +
          " or more cameras. Raise --Simulator.num_cameras or max_view_angle, "
          "or lower min_views, azimuth, missing_share or focal_length.");
    }
    const Eigen::Vector3d direction =
        Eigen::Vector3d{random.Normal(), random.Normal(), random.Normal()}
            .normalized();
    const Eigen::Vector3d xyz = surface.Radius(direction) * direction;
    const Eigen::Vector3d normal = surface.Normal(direction);
    std::vector<size_t> visible;
    for (size_t i = 0; i < cameras.size(); ++i) {
      if (has_image[i] &&
          IsVisible(surface, cameras[i], xyz, normal, min_cos_angle)) {
        visible.push_back(i);
      }
    }
    if (visible.size() >= static_cast<size_t>(options.min_views)) {
      points.push_back({xyz,
                        surface.Brightness(direction),
                        SelectViews(options, cameras, visible, &random)});
    }
  }
  return points;
}

// Removes the observations of images with too few of them, and points that are
// left with fewer than two, until none is left.
void RemoveWeakImages(size_t num_cameras, std::vector<SurfacePoint>* points) {
  for (bool changed = true; changed;) {
    changed = false;
    std::vector<size_t> num_observations(num_cameras, 0);
    for (const SurfacePoint& point : *points) {
      for (const size_t camera_idx : point.cameras) {
        ++num_observations[camera_idx];
      }
    }
    for (SurfacePoint& point : *points) {
      const auto end = std::remove_if(
          point.cameras.begin(), point.cameras.end(), [&](size_t camera_idx) {
            return num_observations[camera_idx] < kMinObservationsPerImage;
          });
      changed |= end != point.cameras.end();
      point.cameras.erase(end, point.cameras.end());
    }
    points->erase(std::remove_if(points->begin(),
                                 points->end(),
                                 [](const SurfacePoint& point) {
                                   return point.cameras.size() < 2;
                                 }),
                  points->end());
  }
}

// What the detector finds around `true_xy`.
Eigen::Vector2d DisturbKeypoint(const SimulatorOptions& options,
                                const RigCamera& camera,
                                const Eigen::Vector2d& true_xy,
                                bool is_outlier,
                                Random* random) {
  Eigen::Vector2d xy;
  // Repeats until the result lies in the image; the limits on noise and
  // outliers leave at least a quarter of all directions.
  do {
    if (is_outlier) {
      const double angle = random->Uniform(0.0, 2.0 * M_PI);
      const double radius =
          random->Uniform(options.min_outlier, options.max_outlier);
      xy = true_xy + radius * Eigen::Vector2d(std::cos(angle), std::sin(angle));
    } else {
      xy = true_xy + Eigen::Vector2d{random->Normal(0.0, options.noise),
                                     random->Normal(0.0, options.noise)};
    }
  } while (!IsInside(camera, xy, 0.0));
  return xy;
}

// Keypoints of an image in random order; those without a point at random
// places.
std::vector<Keypoint> MakeKeypoints(const SimulatorOptions& options,
                                    const RigCamera& camera,
                                    size_t camera_idx,
                                    const std::vector<SurfacePoint>& points,
                                    Random* random) {
  std::vector<Keypoint> keypoints;
  for (size_t i = 0; i < points.size(); ++i) {
    const std::vector<size_t>& views = points[i].cameras;
    if (!std::binary_search(views.begin(), views.end(), camera_idx)) {
      continue;
    }
    Keypoint keypoint;
    keypoint.point_idx = static_cast<int>(i);
    const Eigen::Vector2d uv =
        (camera.cam_from_world * points[i].xyz).hnormalized();
    camera.model->Project(
        camera.params.data(), uv.x(), uv.y(), keypoint.true_xy.data());
    keypoint.is_outlier = random->Uniform() < options.outlier_share;
    keypoint.xy = DisturbKeypoint(
        options, camera, keypoint.true_xy, keypoint.is_outlier, random);
    keypoints.push_back(keypoint);
  }
  const size_t num_unmatched = static_cast<size_t>(
      std::round(options.unmatched_share * keypoints.size()));
  for (size_t i = 0; i < num_unmatched; ++i) {
    Keypoint keypoint;
    keypoint.xy = Eigen::Vector2d{random->Uniform(0.0, camera.width),
                                  random->Uniform(0.0, camera.height)};
    keypoint.true_xy = keypoint.xy;
    keypoints.push_back(keypoint);
  }
  for (size_t i = keypoints.size(); i > 1; --i) {
    std::swap(keypoints[i - 1],
              keypoints[random->Integer(0, static_cast<int>(i) - 1)]);
  }
  return keypoints;
}

// The model of the images that have keypoints, with poses and points as they
// truly are.
host::Reconstruction BuildModel(
    const std::vector<RigCamera>& cameras,
    const std::vector<std::vector<double>>& params,
    const std::vector<SurfacePoint>& points,
    const std::vector<std::vector<Keypoint>>& keypoints,
    Eigen::Vector2d Keypoint::*xy) {
  host::Reconstruction model;
  std::vector<host::Track> tracks(points.size());
  for (size_t i = 0; i < cameras.size(); ++i) {
    if (keypoints[i].empty()) {
      continue;
    }
    const auto id = static_cast<host::image_t>(i + 1);
    host::AddCameraWithTrivialRig(
        host::MakeCamera(id,
                         CameraModelId(*cameras[i].model),
                         cameras[i].width,
                         cameras[i].height,
                         params[i]),
        &model);

    host::Image image;
    image.SetImageId(id);
    image.SetCameraId(id);
    image.SetName(cameras[i].name + ".png");
    std::vector<Eigen::Vector2d> points2D;
    for (const Keypoint& keypoint : keypoints[i]) {
      if (keypoint.point_idx >= 0) {
        tracks[keypoint.point_idx].AddElement(i + 1, points2D.size());
      }
      points2D.push_back(keypoint.*xy);
    }
    image.SetPoints2D(points2D);
    host::AddImageWithTrivialFrame(image, cameras[i].cam_from_world, &model);
  }
  for (size_t i = 0; i < points.size(); ++i) {
    const uint8_t grey = static_cast<uint8_t>(255.0 * points[i].brightness);
    model.AddPoint3D(
        points[i].xyz, tracks[i], Eigen::Matrix<uint8_t, 3, 1>::Constant(grey));
  }
  return model;
}

// Sets the mean reprojection error of each point, as structure from motion
// does.
void SetPointErrors(host::Reconstruction* model) {
  for (const host::point3D_t point3D_id : model->Point3DIds()) {
    host::Point3D& point = model->Point3D(point3D_id);
    const host::Track& track = host::TrackOf(point);
    double sum = 0.0;
    for (const host::TrackElement& element : track.Elements()) {
      const host::Image& image = model->Image(element.image_id);
      const host::Camera& camera = model->Camera(image.CameraId());
      const Eigen::Vector2d uv =
          (host::CamFromWorld(image) * host::Xyz(point)).hnormalized();
      Eigen::Vector2d xy;
      FindCameraModel(host::ModelId(camera))
          ->Project(host::Params(camera).data(), uv.x(), uv.y(), xy.data());
      sum += (xy - host::Xy(image.Point2D(element.point2D_idx))).norm();
    }
    host::SetError(sum / track.Length(), &point);
  }
}

// Poses and points that explain the keypoints best with the wrong intrinsics.
void AdjustPosesAndPoints(const std::string& frame_name,
                          host::Reconstruction* model) {
  if (!host::AdjustPosesAndPoints(model)) {
    throw SolverError("Bundle adjustment of " + frame_name +
                      " failed. Use smaller noise or initial errors.");
  }
  SetPointErrors(model);
}

// A coordinate system of its own, as each run of structure from motion chooses.
Similarity3 DrawGauge(const SimulatorOptions& options, size_t frame_idx) {
  Random random({static_cast<uint64_t>(options.seed), kGaugeStream, frame_idx});
  Similarity3 sfm_from_rig;
  sfm_from_rig.scale =
      5.0 * std::exp(random.Normal(0.0, 0.7)) / UnitsPerMetre(options);
  const Eigen::Vector4d q{
      random.Normal(), random.Normal(), random.Normal(), random.Normal()};
  sfm_from_rig.rotation = Eigen::Quaterniond(q.normalized());
  sfm_from_rig.translation =
      2.0 * Eigen::Vector3d{random.Normal(), random.Normal(), random.Normal()};
  return sfm_from_rig;
}

SimulatedFrame SimulateFrame(const SimulatorOptions& options,
                             const std::vector<RigCamera>& cameras,
                             size_t frame_idx) {
  const uint64_t seed = options.seed;
  SimulatedFrame frame;
  char name[32];
  std::snprintf(name, sizeof(name), "frame%06zu", frame_idx);
  frame.name = name;
  Random presence_random({seed, kPresenceStream, frame_idx});
  for (size_t i = 0; i < cameras.size(); ++i) {
    frame.has_image.push_back(presence_random.Uniform() >=
                              options.missing_share);
  }

  std::vector<SurfacePoint> points =
      SamplePoints(options, cameras, frame.has_image, frame_idx);
  RemoveWeakImages(cameras.size(), &points);
  if (points.empty()) {
    throw UsageError("Frame " + std::to_string(frame_idx) + ": no image has " +
                     std::to_string(kMinObservationsPerImage) +
                     " observations. Raise --Simulator.num_points.");
  }

  std::vector<std::vector<Keypoint>> keypoints;
  std::vector<std::vector<double>> true_params, wrong_params;
  for (size_t i = 0; i < cameras.size(); ++i) {
    Random keypoint_random({seed, kKeypointStream, frame_idx, i});
    keypoints.push_back(
        MakeKeypoints(options, cameras[i], i, points, &keypoint_random));
    for (const Keypoint& keypoint : keypoints.back()) {
      frame.num_observations += keypoint.point_idx >= 0;
      frame.num_outliers += keypoint.is_outlier;
    }
    Random drift_random({seed, kDriftStream, frame_idx, i});
    true_params.push_back(cameras[i].params);
    wrong_params.push_back(DriftIntrinsics(options, cameras[i], &drift_random));
  }

  frame.true_model =
      BuildModel(cameras, true_params, points, keypoints, &Keypoint::true_xy);
  SetPointErrors(&frame.true_model);
  frame.sfm_model =
      BuildModel(cameras, wrong_params, points, keypoints, &Keypoint::xy);
  AdjustPosesAndPoints(frame.name, &frame.sfm_model);
  frame.sfm_from_rig = DrawGauge(options, frame_idx);
  host::TransformReconstruction(frame.sfm_from_rig, &frame.sfm_model);
  return frame;
}

}  // namespace

SimulatedCapture SimulateCapture(const SimulatorOptions& options) {
  options.Check();
  SimulatedCapture capture;
  capture.options = options;
  capture.true_cameras = MakeTrueCameras(options);
  capture.known_cameras = MakeKnownCameras(options, capture.true_cameras);
  capture.frames.resize(options.num_frames);
  ParallelFor(capture.frames.size(), options.num_threads, [&](size_t i) {
    capture.frames[i] = SimulateFrame(options, capture.true_cameras, i);
  });
  return capture;
}

SyntheticSurface SimulatedSurface(const SimulatorOptions& options,
                                  size_t frame_idx) {
  // Fine enough for many keypoints, coarse enough for the pixels to resolve.
  constexpr double kFinestTexture = 3.0;  // pixels
  const double unit = UnitsPerMetre(options);
  return SyntheticSurface(
      options.seed,
      frame_idx,
      unit,
      kFinestTexture * options.distance * unit / NominalFocalLength(options),
      options.gloss);
}

GreyImage RenderSimulatedImage(const SimulatedCapture& capture,
                               size_t frame_idx,
                               size_t camera_idx) {
  const SimulatorOptions& options = capture.options;
  Random random({static_cast<uint64_t>(options.seed),
                 kImageStream,
                 frame_idx,
                 camera_idx});
  return RenderImage(SimulatedSurface(options, frame_idx),
                     capture.true_cameras[camera_idx],
                     options.blur,
                     options.image_noise,
                     &random);
}

}  // namespace mfir

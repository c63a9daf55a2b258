// Right and wrong matches of a simulated capture, by its exact truth:
//
//   ninja -C build match_quality
//   build/bin/match_quality --project_path CAPTURE/project.ini
//       --input_path FRAMES [--max_error 3] [--stride 10]
//
// FRAMES are of multi_frame_triangulator. For the verified matches of each
// database:
//
//   precision   share of the matches whose keypoint in image 2 is within
//               max_error pixels of where the surface point of the keypoint in
//               image 1 truly is
//   recall      right matches / keypoints of image 1 whose surface point image
//               2 sees, under an angle of less than 60 degrees between the
//               lines of sight, and has a keypoint there; from every stride-th
//               keypoint
//   noise       of right matches: robust standard deviation per axis, pixels
//   bias        of right matches: mean of keypoint - truth per axis, pixels
//
// and for the model the same precision of the observations of each track
// against its first, and the share of points whose observations are all right.

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <iostream>
#include <map>
#include <optional>

#include "colmap_ext/exe/command.h"
#include "colmap_ext/host/database.h"
#include "colmap_ext/host/log.h"
#include "colmap_ext/models/model_io.h"
#include "colmap_ext/options/option_parser.h"
#include "colmap_ext/simulation/simulated_rig.h"
#include "colmap_ext/simulation/simulator.h"

namespace mfir {
namespace {

struct Options {
  std::string frames_path;
  double max_error = 3.0;
  int stride = 10;
  SimulatorOptions simulator;
};

// An image and the surface points of its keypoints.
struct TrueImage {
  const RigCamera* camera = nullptr;
  std::vector<Eigen::Vector2d> keypoints;
  std::vector<std::optional<Eigen::Vector3d>> points;

  TrueImage() = default;
  TrueImage(const RigCamera& source,
            const SyntheticSurface& surface,
            std::vector<Eigen::Vector2d> xys)
      : camera(&source), keypoints(std::move(xys)) {
    const Eigen::Vector3d center = source.cam_from_world.Center();
    for (const Eigen::Vector2d& xy : keypoints) {
      Eigen::Vector2d uv;
      source.model->Unproject(source.params.data(), xy.x(), xy.y(), uv.data());
      const Eigen::Vector3d ray = source.cam_from_world.rotation.conjugate() *
                                  uv.homogeneous().normalized();
      const std::optional<double> distance = surface.Intersect(center, ray);
      if (distance) {
        points.push_back(center + *distance * ray);
      } else {
        points.push_back(std::nullopt);
      }
    }
  }

  Eigen::Vector2d Project(const Eigen::Vector3d& point) const {
    const Eigen::Vector3d in_camera = camera->cam_from_world * point;
    Eigen::Vector2d xy = Eigen::Vector2d::Constant(-1e9);
    if (in_camera.z() > 0.0) {
      const Eigen::Vector2d uv = in_camera.hnormalized();
      camera->model->Project(camera->params.data(), uv.x(), uv.y(), xy.data());
    }
    return xy;
  }
};

struct Counts {
  size_t num_matches = 0;
  size_t num_right = 0;
  double num_possible = 0.0;
  std::vector<double> abs_errors;
  Eigen::Vector2d error_sum = Eigen::Vector2d::Zero();
};

// Keypoint 2 minus the truth of keypoint 1 in image 2; none off the surface.
std::optional<Eigen::Vector2d> MatchError(const TrueImage& image1,
                                          size_t idx1,
                                          const TrueImage& image2,
                                          size_t idx2) {
  if (!image1.points[idx1]) return std::nullopt;
  return image2.keypoints[idx2] - image2.Project(*image1.points[idx1]);
}

void CountMatches(const Options& options,
                  const TrueImage& image1,
                  const TrueImage& image2,
                  const host::FeatureMatches& matches,
                  Counts* counts) {
  counts->num_matches += matches.size();
  for (const host::FeatureMatch& match : matches) {
    const auto error =
        MatchError(image1, match.point2D_idx1, image2, match.point2D_idx2);
    if (!error || error->norm() > options.max_error) continue;
    ++counts->num_right;
    counts->error_sum += *error;
    counts->abs_errors.push_back(std::abs(error->x()));
    counts->abs_errors.push_back(std::abs(error->y()));
  }
}

// Keypoints by cell.
class KeypointGrid {
 public:
  KeypointGrid(const std::vector<Eigen::Vector2d>& keypoints, double cell_size)
      : keypoints_(keypoints), cell_size_(cell_size) {
    for (size_t i = 0; i < keypoints.size(); ++i) {
      cells_[Cell(keypoints[i])].push_back(i);
    }
  }

  bool HasWithin(const Eigen::Vector2d& xy) const {
    for (int dy = -1; dy <= 1; ++dy) {
      for (int dx = -1; dx <= 1; ++dx) {
        const auto it =
            cells_.find(Cell(xy + cell_size_ * Eigen::Vector2d(dx, dy)));
        if (it == cells_.end()) continue;
        for (const size_t i : it->second) {
          if ((keypoints_[i] - xy).norm() <= cell_size_) return true;
        }
      }
    }
    return false;
  }

 private:
  std::pair<long, long> Cell(const Eigen::Vector2d& xy) const {
    return {std::lround(xy.x() / cell_size_), std::lround(xy.y() / cell_size_)};
  }

  const std::vector<Eigen::Vector2d>& keypoints_;
  const double cell_size_;
  std::map<std::pair<long, long>, std::vector<size_t>> cells_;
};

double CountPossible(const Options& options,
                     const SyntheticSurface& surface,
                     const TrueImage& image1,
                     const TrueImage& image2,
                     const KeypointGrid& grid2) {
  const Eigen::Vector3d center1 = image1.camera->cam_from_world.Center();
  const Eigen::Vector3d center2 = image2.camera->cam_from_world.Center();
  size_t num_possible = 0;
  for (size_t i = 0; i < image1.points.size(); i += options.stride) {
    if (!image1.points[i]) continue;
    const Eigen::Vector3d& point = *image1.points[i];
    const Eigen::Vector3d ray = (point - center2).normalized();
    if (ray.dot((point - center1).normalized()) < 0.5) continue;
    if (!grid2.HasWithin(image2.Project(point))) continue;
    const double distance = (point - center2).norm();
    const std::optional<double> seen = surface.Intersect(center2, ray);
    num_possible += seen && std::abs(*seen - distance) < 1e-3 * distance;
  }
  return static_cast<double>(options.stride * num_possible);
}

void CountTracks(const Options& options,
                 const std::string& model_path,
                 const std::map<host::image_t, TrueImage>& images) {
  host::Reconstruction model;
  ReadModel(model_path, /*require_points=*/true, &model);
  size_t num_observations = 0;
  size_t num_right = 0;
  size_t num_right_points = 0;
  for (const auto& [point_id, point] : model.Points3D()) {
    const auto& elements = host::TrackOf(point).Elements();
    bool all_right = true;
    for (size_t i = 1; i < elements.size(); ++i) {
      const auto error = MatchError(images.at(elements[0].image_id),
                                    elements[0].point2D_idx,
                                    images.at(elements[i].image_id),
                                    elements[i].point2D_idx);
      const bool is_right = error && error->norm() <= options.max_error;
      num_right += is_right;
      all_right &= is_right;
      ++num_observations;
    }
    num_right_points += all_right;
  }
  std::cout << "  tracks: " << model.NumPoints3D() << " points, length "
            << model.ComputeMeanTrackLength() << ", precision "
            << static_cast<double>(num_right) / num_observations
            << ", points without a wrong observation "
            << static_cast<double>(num_right_points) / model.NumPoints3D()
            << std::endl;
}

void CountFrame(const Options& options, size_t frame_idx) {
  char name[32];
  std::snprintf(name, sizeof(name), "frame%06zu", frame_idx);
  const std::filesystem::path folder =
      std::filesystem::path(options.frames_path) / name;
  const std::vector<RigCamera> cameras = MakeTrueCameras(options.simulator);
  const SyntheticSurface surface =
      SimulatedSurface(options.simulator, frame_idx);
  const auto database = host::OpenDatabase(folder / "database.db");
  std::map<host::image_t, TrueImage> images;
  size_t num_keypoints = 0;
  for (const host::Image& image : database->ReadAllImages()) {
    std::vector<Eigen::Vector2d> xys;
    for (const auto& keypoint : database->ReadKeypoints(image.ImageId())) {
      xys.emplace_back(keypoint.x, keypoint.y);
    }
    num_keypoints += xys.size();
    images.emplace(
        image.ImageId(),
        TrueImage(cameras.at(image.ImageId() - 1), surface, std::move(xys)));
  }
  Counts counts;
  for (const auto& [pair_id, matches] : host::ReadInlierMatches(*database)) {
    const auto [id1, id2] = host::PairIdToImagePair(pair_id);
    CountMatches(options, images.at(id1), images.at(id2), matches, &counts);
  }
  for (const auto& [id2, image2] : images) {
    const KeypointGrid grid(image2.keypoints, options.max_error / 2.0);
    for (const auto& [id1, image1] : images) {
      if (id1 >= id2) break;
      counts.num_possible +=
          CountPossible(options, surface, image1, image2, grid);
    }
  }
  auto& errors = counts.abs_errors;
  std::nth_element(
      errors.begin(), errors.begin() + errors.size() / 2, errors.end());
  std::cout << name << ": " << num_keypoints << " keypoints, "
            << counts.num_matches << " matches, precision "
            << static_cast<double>(counts.num_right) / counts.num_matches
            << ", recall " << counts.num_right / counts.num_possible
            << ", right " << counts.num_right << ", noise "
            << 1.4826 * errors[errors.size() / 2] << ", bias "
            << (counts.error_sum / counts.num_right).transpose() << std::endl;
  CountTracks(options, (folder / "sparse" / "0").string(), images);
}

void Measure(int argc, char** argv) {
  Options options;
  std::string capture_path;
  OptionParser parser;
  parser.AddRequired("input_path", &options.frames_path, "folder of frames");
  parser.Add("output_path", &capture_path, "of the capture; not used");
  parser.Add("max_error", &options.max_error, "pixels");
  parser.Add("stride", &options.stride, "of keypoints for the recall");
  VisitSimulatorOptions(
      &options.simulator, [&](const char* name, auto* value, const char* help) {
        parser.Add(std::string("Simulator.") + name, value, help);
      });
  parser.Add("Simulator.num_threads", &options.simulator.num_threads, "");
  parser.Add("Simulator.overwrite", &options.simulator.overwrite, "");
  parser.Add("Simulator.quiet", &options.simulator.quiet, "");
  parser.Parse(argc, argv);
  for (int i = 0; i < options.simulator.num_frames; ++i) CountFrame(options, i);
}

}  // namespace
}  // namespace mfir

int main(int argc, char** argv) {
  mfir::host::InitializeLog(argv);
  return mfir::RunCommand([argc, argv]() { mfir::Measure(argc, argv); });
}

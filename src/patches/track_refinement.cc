#include "src/patches/track_refinement.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include <Eigen/Cholesky>

#include "src/patches/patch_slope.h"
#include "src/util/parallel_for.h"

namespace mfir {
namespace {

// Views tried as the reference.
constexpr size_t kMaxNumReferences = 2;
// Views that the surface's tilt is estimated from, the most different ones.
constexpr size_t kMaxNumSlopeViews = 6;
// Of the second start from the first where the projection is no other place.
constexpr double kStartOffset = 0.7;  // px
// Where the patch would be shrunk more than this along a direction, too few
// pixels show it.
constexpr double kMinAddedScale = 0.35;
// At a whole pixel, half a pixel away at worst.
constexpr float kMinSearchZncc = 0.5f;
constexpr int kMaxNumPointIterations = 5;
// By which a point may move, relative to its distance from the first camera:
// rays that are nearly parallel say little about it.
constexpr double kMaxPointMove = 0.05;
constexpr double kPointLossScale = 0.5;  // px

struct PointObservation {
  size_t camera_idx;
  Eigen::Vector2d xy;
};

// Residual of a point and its derivative; false behind the camera.
bool PointResidual(const PatchCamera& camera,
                   const Eigen::Vector3d& xyz,
                   const Eigen::Vector2d& xy,
                   std::vector<double>* scratch,
                   Eigen::Vector2d* residual,
                   Eigen::Matrix<double, 2, 3>* jacobian) {
  const Eigen::Vector3d p = camera.cam_from_world * xyz;
  if (!(p.z() > 0.0)) return false;
  const double u = p.x() / p.z();
  const double v = p.y() / p.z();
  scratch->resize(2 * camera.model->NumParams());
  Eigen::Vector2d projection;
  Eigen::Matrix<double, 2, 2, Eigen::RowMajor> lens;
  camera.model->ProjectWithJacobian(camera.params.data(),
                                    u,
                                    v,
                                    projection.data(),
                                    lens.data(),
                                    scratch->data());
  Eigen::Matrix<double, 2, 3> perspective;
  perspective << 1.0, 0.0, -u, 0.0, 1.0, -v;
  *residual = projection - xy;
  *jacobian = lens * perspective / p.z() *
              camera.cam_from_world.rotation.toRotationMatrix();
  return residual->allFinite() && jacobian->allFinite();
}

// The point that its observations show best, from a nearby one; that one where
// this fails.
Eigen::Vector3d FitPoint(const std::vector<PatchCamera>& cameras,
                         const std::vector<PointObservation>& observations,
                         const Eigen::Vector3d& start) {
  Eigen::Vector3d xyz = start;
  std::vector<double> scratch;
  for (int i = 0; i < kMaxNumPointIterations; ++i) {
    Eigen::Matrix3d hessian = Eigen::Matrix3d::Zero();
    Eigen::Vector3d gradient = Eigen::Vector3d::Zero();
    for (const PointObservation& observation : observations) {
      Eigen::Vector2d residual;
      Eigen::Matrix<double, 2, 3> jacobian;
      if (!PointResidual(cameras[observation.camera_idx],
                         xyz,
                         observation.xy,
                         &scratch,
                         &residual,
                         &jacobian)) {
        return start;
      }
      const double weight =
          1.0 /
          (1.0 + residual.squaredNorm() / (kPointLossScale * kPointLossScale));
      hessian += weight * jacobian.transpose() * jacobian;
      gradient += weight * jacobian.transpose() * residual;
    }
    const Eigen::Vector3d step = hessian.ldlt().solve(gradient);
    if (!step.allFinite()) return start;
    xyz -= step;
    if (step.dot(hessian * step) < 1e-6) break;
  }
  const double distance =
      (cameras[observations.front().camera_idx].cam_from_world * start).norm();
  return (xyz - start).norm() <= kMaxPointMove * distance ? xyz : start;
}

Eigen::Vector2d Center(const PatchWarp& warp) {
  return {warp.center[0], warp.center[1]};
}

void SetCenter(const Eigen::Vector2d& xy, PatchWarp* warp) {
  warp->center[0] = xy.x();
  warp->center[1] = xy.y();
}

// Smallest singular value of a warp's affine part.
double SmallestScale(const PatchWarp& warp) {
  const double a = warp.affine[0], b = warp.affine[1];
  const double c = warp.affine[2], d = warp.affine[3];
  const double squares = 0.5 * (a * a + b * b + c * c + d * d);
  const double det = a * d - b * c;
  if (!(det > 0.0)) return 0.0;
  return std::sqrt(std::max(
      squares - std::sqrt(std::max(squares * squares - det * det, 0.0)), 0.0));
}

bool IsGood(PatchOutcome outcome) {
  return outcome == PatchOutcome::kReference ||
         outcome == PatchOutcome::kAligned || outcome == PatchOutcome::kAdded;
}

// Works on one track at a time; several threads may use it at once.
class TrackRefiner {
 public:
  TrackRefiner(const TrackRefinementOptions& options,
               const std::vector<PatchCamera>& cameras,
               const std::vector<SplineImage>& images)
      : options_(options), cameras_(cameras), images_(images) {
    for (const PatchCamera& camera : cameras) {
      centers_.push_back(camera.cam_from_world.Center());
    }
  }

  // Outcomes of all observations, and new ones after these.
  RefinedTrack Refine(const PatchTrack& track) const {
    RefinedTrack result;
    result.xyz = track.xyz;
    for (size_t i = 0; i < track.observations.size(); ++i) {
      const PatchObservation& observation = track.observations[i];
      result.observations.push_back({observation.camera_idx,
                                     observation.xy,
                                     PatchOutcome::kUntouched,
                                     i});
    }
    const std::vector<size_t> order = ReferenceOrder(track);
    RefinedTrack first_attempt = result;
    for (size_t i = 0; i < std::min(order.size(), kMaxNumReferences); ++i) {
      RefinedTrack attempt = result;
      if (RefineFrom(track, order[i], &attempt)) return attempt;
      if (i == 0) first_attempt = std::move(attempt);
    }
    for (RefinedObservation& observation : first_attempt.observations) {
      if (IsGood(observation.outcome) ||
          observation.outcome == PatchOutcome::kUntouched) {
        observation.outcome = PatchOutcome::kAlone;
      }
    }
    return first_attempt;
  }

 private:
  Eigen::Vector3d Direction(const PatchTrack& track, size_t camera_idx) const {
    return (centers_[camera_idx] - track.xyz).normalized();
  }

  // Observations that have an image, from the medoid of the viewing directions
  // on. Of several in one camera the first.
  std::vector<size_t> ReferenceOrder(const PatchTrack& track) const {
    std::vector<size_t> idxs;
    std::vector<double> angles(track.observations.size(), 0.0);
    for (size_t i = 0; i < track.observations.size(); ++i) {
      const size_t camera_idx = track.observations[i].camera_idx;
      if (images_[camera_idx].Empty()) continue;
      const bool is_first =
          std::none_of(idxs.begin(), idxs.end(), [&](size_t k) {
            return track.observations[k].camera_idx == camera_idx;
          });
      if (!is_first) continue;
      idxs.push_back(i);
      for (const PatchObservation& other : track.observations) {
        angles[i] +=
            std::acos(std::clamp(Direction(track, camera_idx)
                                     .dot(Direction(track, other.camera_idx)),
                                 -1.0,
                                 1.0));
      }
    }
    std::stable_sort(idxs.begin(), idxs.end(), [&](size_t a, size_t b) {
      return angles[a] < angles[b];
    });
    return idxs;
  }

  // A reference view with its patch.
  struct Reference {
    size_t observation_idx;
    size_t camera_idx;
    ReferencePatch view;
    PatchTemplate patch;
    double depth;
    Eigen::Vector2d slope;
  };

  bool MakeReference(const PatchTrack& track,
                     size_t observation_idx,
                     Reference* reference) const {
    const PatchObservation& observation = track.observations[observation_idx];
    const PatchCamera& camera = cameras_[observation.camera_idx];
    reference->observation_idx = observation_idx;
    reference->camera_idx = observation.camera_idx;
    reference->depth = (camera.cam_from_world * track.xyz).z();
    return reference->depth > 0.0 &&
           MakeReferencePatch(camera, observation.xy, &reference->view) &&
           mfir::MakePatchTemplate(images_[observation.camera_idx],
                                   observation.xy,
                                   &reference->patch);
  }

  Eigen::Vector2d FindSlope(const PatchTrack& track,
                            const std::vector<size_t>& observation_idxs,
                            const Reference& reference) const {
    std::vector<std::pair<double, SlopeView>> views;
    for (const size_t i : observation_idxs) {
      const size_t camera_idx = track.observations[i].camera_idx;
      SlopeView view;
      view.image = &images_[camera_idx];
      view.xy = track.observations[i].xy;
      if (!MakePatchMap(reference.view,
                        cameras_[camera_idx],
                        reference.depth,
                        &view.map)) {
        continue;
      }
      views.emplace_back(Direction(track, camera_idx)
                             .dot(Direction(track, reference.camera_idx)),
                         view);
    }
    std::stable_sort(
        views.begin(), views.end(), [](const auto& a, const auto& b) {
          return a.first < b.first;
        });
    std::vector<SlopeView> chosen;
    for (const auto& [cosine, view] : views) {
      if (chosen.size() < kMaxNumSlopeViews) chosen.push_back(view);
    }
    return EstimateSlope(reference.view, reference.patch, chosen);
  }

  // Aligns from two starts. Which of the rules that the image decides fails, or
  // kAligned.
  PatchOutcome AlignTwice(const Reference& reference,
                          size_t camera_idx,
                          const PatchWarp& first,
                          const Eigen::Vector2d& second_start,
                          double min_zncc,
                          Eigen::Vector2d* xy) const {
    const SplineImage& image = images_[camera_idx];
    PatchWarp warp = first;
    const PatchAlignment alignment =
        mfir::AlignPatch(reference.patch, image, &warp);
    if (alignment.end == PatchEnd::kOutside) return PatchOutcome::kOutside;
    if (alignment.end != PatchEnd::kConverged || alignment.zncc < min_zncc) {
      return PatchOutcome::kDissimilar;
    }
    // Negated, so that NaN fails.
    if (!(PatchStd(alignment) < options_.max_std)) return PatchOutcome::kVague;
    PatchWarp second = first;
    SetCenter(second_start, &second);
    const PatchAlignment other =
        mfir::AlignPatch(reference.patch, image, &second);
    if (other.end != PatchEnd::kConverged ||
        (Center(second) - Center(warp)).norm() > options_.max_start_distance) {
      return PatchOutcome::kAmbiguous;
    }
    *xy = Center(warp);
    return PatchOutcome::kAligned;
  }

  // A start that is not the first: towards `other` if that is elsewhere.
  static Eigen::Vector2d SecondStart(const Eigen::Vector2d& first,
                                     const Eigen::Vector2d& other) {
    const Eigen::Vector2d offset = other - first;
    const double length = offset.norm();
    const Eigen::Vector2d direction =
        length > 0.1 ? Eigen::Vector2d(offset / length)
                     : Eigen::Vector2d(M_SQRT1_2, M_SQRT1_2);
    return first + std::max(std::min(length, 1.5), kStartOffset) * direction;
  }

  PatchOutcome AlignObservation(const Reference& reference,
                                const PatchObservation& observation,
                                Eigen::Vector2d* xy) const {
    PatchWarp warp;
    if (!MakePatchWarp(reference.view,
                       cameras_[observation.camera_idx],
                       reference.depth,
                       reference.slope,
                       &warp)) {
      return PatchOutcome::kOutside;
    }
    const Eigen::Vector2d projection = Center(warp);
    SetCenter(observation.xy, &warp);
    const PatchOutcome outcome =
        AlignTwice(reference,
                   observation.camera_idx,
                   warp,
                   SecondStart(observation.xy, projection),
                   options_.min_zncc,
                   xy);
    if (outcome == PatchOutcome::kAligned &&
        (*xy - observation.xy).norm() > options_.max_shift) {
      return PatchOutcome::kShifted;
    }
    return outcome;
  }

  // Aligns the other observations with the reference; false if none does.
  bool RefineFrom(const PatchTrack& track,
                  size_t reference_idx,
                  RefinedTrack* refined) const {
    Reference reference;
    if (!MakeReference(track, reference_idx, &reference)) return false;
    std::vector<size_t> others;
    for (const size_t i : ReferenceOrder(track)) {
      if (i != reference_idx) others.push_back(i);
    }
    std::sort(others.begin(), others.end());
    reference.slope = FindSlope(track, others, reference);
    std::vector<PointObservation> found = {
        {reference.camera_idx, track.observations[reference_idx].xy}};
    for (const size_t i : others) {
      RefinedObservation& observation = refined->observations[i];
      Eigen::Vector2d xy;
      observation.outcome =
          AlignObservation(reference, track.observations[i], &xy);
      if (observation.outcome != PatchOutcome::kAligned) continue;
      found.push_back({observation.camera_idx, xy});
      observation.xy = xy;
    }
    if (found.size() < 2) return false;
    refined->observations[reference_idx].outcome = PatchOutcome::kReference;
    refined->is_refined = true;
    refined->xyz = FitPoint(cameras_, found, track.xyz);
    if (options_.complete_tracks) {
      Complete(track, reference, &found, refined);
    }
    DropDuplicates(track, refined);
    if (!options_.refine_keypoints) KeepKeypoints(track, refined);
    return true;
  }

  // Of cameras that have several observations, those that took no part.
  void DropDuplicates(const PatchTrack& track, RefinedTrack* refined) const {
    for (size_t i = 0; i < track.observations.size(); ++i) {
      RefinedObservation& observation = refined->observations[i];
      if (observation.outcome == PatchOutcome::kUntouched &&
          !images_[observation.camera_idx].Empty()) {
        observation.outcome = PatchOutcome::kAmbiguous;
      }
    }
  }

  // Completed only: the track's own observations stay as they are.
  static void KeepKeypoints(const PatchTrack& track, RefinedTrack* refined) {
    auto& observations = refined->observations;
    const size_t num_own = track.observations.size();
    std::vector<RefinedObservation> kept;
    for (size_t i = 0; i < observations.size(); ++i) {
      RefinedObservation observation = observations[i];
      if (i < num_own) {
        observation.xy = track.observations[i].xy;
        if (observation.outcome != PatchOutcome::kReference) {
          observation.outcome = PatchOutcome::kUntouched;
        }
      } else if (std::any_of(track.observations.begin(),
                             track.observations.end(),
                             [&](const PatchObservation& own) {
                               return own.camera_idx == observation.camera_idx;
                             })) {
        continue;
      }
      kept.push_back(observation);
    }
    observations = std::move(kept);
  }

  // Looks for the patch in the cameras that have not found it, from the nearest
  // viewing direction on: each new view makes the point, and so the next
  // projection, better.
  void Complete(const PatchTrack& track,
                const Reference& reference,
                std::vector<PointObservation>* found,
                RefinedTrack* refined) const {
    const double min_cosine = std::cos(options_.max_added_angle * M_PI / 180.0);
    const Eigen::Vector3d direction = Direction(track, reference.camera_idx);
    std::vector<std::pair<double, size_t>> candidates;
    for (size_t i = 0; i < cameras_.size(); ++i) {
      const double cosine = direction.dot(Direction(track, i));
      const bool is_found = std::any_of(
          found->begin(), found->end(), [&](const PointObservation& other) {
            return other.camera_idx == i;
          });
      if (cosine >= min_cosine && !is_found && !images_[i].Empty()) {
        candidates.emplace_back(-cosine, i);
      }
    }
    std::sort(candidates.begin(), candidates.end());
    for (const auto& [negative_cosine, camera_idx] : candidates) {
      Eigen::Vector2d xy;
      if (!FindInCamera(reference, refined->xyz, camera_idx, &xy)) continue;
      found->push_back({camera_idx, xy});
      refined->observations.push_back(
          {camera_idx, xy, PatchOutcome::kAdded, kNoSource});
      refined->xyz = FitPoint(cameras_, *found, refined->xyz);
    }
  }

  bool FindInCamera(const Reference& reference,
                    const Eigen::Vector3d& xyz,
                    size_t camera_idx,
                    Eigen::Vector2d* xy) const {
    const SplineImage& image = images_[camera_idx];
    const double depth =
        (cameras_[reference.camera_idx].cam_from_world * xyz).z();
    PatchWarp warp;
    if (!(depth > 0.0) ||
        !MakePatchWarp(reference.view,
                       cameras_[camera_idx],
                       depth,
                       reference.slope,
                       &warp) ||
        !IsPatchInside(image.View(), warp, kPatchRadius) ||
        SmallestScale(warp) < kMinAddedScale) {
      return false;
    }
    const Eigen::Vector2d projection = Center(warp);
    // -1 near a border: then the projection is the start.
    const float zncc = mfir::SearchPatch(reference.patch, image, &warp);
    if (zncc != -1.0f && zncc < kMinSearchZncc) return false;
    const PatchOutcome outcome =
        AlignTwice(reference,
                   camera_idx,
                   warp,
                   SecondStart(Center(warp), projection),
                   options_.min_added_zncc,
                   xy);
    return outcome == PatchOutcome::kAligned &&
           (*xy - projection).norm() <= options_.max_added_shift;
  }

  const TrackRefinementOptions& options_;
  const std::vector<PatchCamera>& cameras_;
  const std::vector<SplineImage>& images_;
  std::vector<Eigen::Vector3d> centers_;
};

// Observations of each camera, before and after.
void CountByCamera(size_t num_cameras,
                   const std::vector<PatchTrack>& tracks,
                   const std::vector<RefinedTrack>& refined,
                   TrackRefinement* result) {
  result->num_before.assign(num_cameras, 0);
  result->num_refined.assign(num_cameras, 0);
  for (const PatchTrack& track : tracks) {
    for (const PatchObservation& observation : track.observations) {
      ++result->num_before[observation.camera_idx];
    }
  }
  for (const RefinedTrack& track : refined) {
    for (const RefinedObservation& observation : track.observations) {
      result->num_refined[observation.camera_idx] +=
          IsGood(observation.outcome);
    }
  }
}

// Observations that do not align stay as they are where their camera keeps its
// keypoints.
void RestoreKept(const TrackRefinementOptions& options,
                 const PatchTrack& track,
                 const std::vector<bool>& is_kept,
                 RefinedTrack* refined) {
  for (RefinedObservation& observation : refined->observations) {
    if (IsGood(observation.outcome)) continue;
    if (is_kept[observation.camera_idx] || !options.refine_keypoints) {
      observation.outcome = PatchOutcome::kUntouched;
      observation.xy = track.observations[observation.source_idx].xy;
    }
  }
}

// Adds the track, or what is left of it, to the result.
void AddTrack(RefinedTrack track, TrackRefinement* result) {
  auto& observations = track.observations;
  const auto num_left =
      std::count_if(observations.begin(),
                    observations.end(),
                    [](const RefinedObservation& observation) {
                      return !IsDropped(observation.outcome);
                    });
  for (RefinedObservation& observation : observations) {
    if (num_left < 2 && !IsDropped(observation.outcome)) {
      observation.outcome = PatchOutcome::kAlone;
    }
    ++result->num_observations[static_cast<size_t>(observation.outcome)];
  }
  if (num_left < 2) return;
  observations.erase(std::remove_if(observations.begin(),
                                    observations.end(),
                                    [](const RefinedObservation& observation) {
                                      return IsDropped(observation.outcome);
                                    }),
                     observations.end());
  result->num_refined_tracks += track.is_refined;
  result->tracks.push_back(std::move(track));
}

// The tracks as they were.
TrackRefinement Unchanged(const std::vector<PatchTrack>& tracks,
                          TrackRefinement result) {
  result.unchanged = true;
  result.tracks.clear();
  result.num_refined_tracks = 0;
  result.num_observations.assign(kNumPatchOutcomes, 0);
  result.num_refined.assign(result.num_refined.size(), 0);
  for (size_t i = 0; i < tracks.size(); ++i) {
    RefinedTrack track;
    track.xyz = tracks[i].xyz;
    track.source_idx = i;
    for (size_t k = 0; k < tracks[i].observations.size(); ++k) {
      track.observations.push_back({tracks[i].observations[k].camera_idx,
                                    tracks[i].observations[k].xy,
                                    PatchOutcome::kUntouched,
                                    k});
    }
    result.num_observations[0] += track.observations.size();
    result.tracks.push_back(std::move(track));
  }
  return result;
}

}  // namespace

size_t TrackRefinement::NumDropped() const {
  size_t sum = 0;
  for (size_t i = 0; i < num_observations.size(); ++i) {
    if (IsDropped(static_cast<PatchOutcome>(i))) sum += num_observations[i];
  }
  return sum;
}

TrackRefinement RefinePatchTracks(const TrackRefinementOptions& options,
                                  const std::vector<PatchCamera>& cameras,
                                  const std::vector<SplineImage>& images,
                                  const std::vector<PatchTrack>& tracks) {
  std::vector<RefinedTrack> refined(tracks.size());
  const TrackRefiner refiner(options, cameras, images);
  ParallelFor(tracks.size(), options.num_threads, [&](size_t i) {
    refined[i] = refiner.Refine(tracks[i]);
    refined[i].source_idx = i;
  });

  TrackRefinement result;
  CountByCamera(cameras.size(), tracks, refined, &result);
  for (size_t i = 0; i < cameras.size(); ++i) {
    result.is_kept.push_back(images[i].Empty() ||
                             static_cast<double>(result.num_refined[i]) <
                                 options.min_camera_share *
                                     static_cast<double>(result.num_before[i]));
  }
  const auto num_refined =
      std::count_if(refined.begin(), refined.end(), [](const auto& track) {
        return track.is_refined;
      });
  if (static_cast<double>(num_refined) <
      options.min_track_share * static_cast<double>(tracks.size())) {
    return Unchanged(tracks, std::move(result));
  }
  for (size_t i = 0; i < tracks.size(); ++i) {
    RestoreKept(options, tracks[i], result.is_kept, &refined[i]);
    AddTrack(std::move(refined[i]), &result);
  }
  return result;
}

}  // namespace mfir

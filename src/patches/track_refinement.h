// Keypoints aligned, and tracks completed, by patches that are warped from one
// view of a track to the others. Needs poses and intrinsics that are nearly
// right, but where a patch is found is decided by the images alone.

#pragma once

#include <cstddef>
#include <limits>
#include <vector>

#include <Eigen/Core>

#include "src/patches/patch_alignment.h"
#include "src/patches/patch_backend.h"
#include "src/patches/patch_warp.h"

namespace mfir {

struct PatchObservation {
  size_t camera_idx = 0;
  Eigen::Vector2d xy = Eigen::Vector2d::Zero();  // pixels
};

// A point and where it was seen.
struct PatchTrack {
  Eigen::Vector3d xyz = Eigen::Vector3d::Zero();
  std::vector<PatchObservation> observations;
};

struct TrackRefinementOptions {
  // Align the keypoints of tracks, and drop those that do not align.
  bool refine_keypoints = true;
  // Look for tracks in further cameras.
  bool complete_tracks = true;
  int num_threads = -1;

  // An alignment counts if two starts end within this distance (px),
  double max_start_distance = 0.1;
  // at a patch as similar as this: of a track's keypoint, and of a new one,
  double min_zncc = 0.8;
  double min_added_zncc = 0.85;
  // whose texture determines the position as well as this (px),
  double max_std = 0.2;
  // and not further from the keypoint, or from the projection (px).
  double max_shift = 1.5;
  double max_added_shift = 2.0;
  // Between the lines of sight of the reference view and a new one (degrees). In
  // rings of 12 cameras, 30 degrees apart, the next but one still counts.
  double max_added_angle = 70.0;

  // A frame stays as it is if fewer of its tracks than this share can be
  // refined, and a camera keeps its keypoints as they are if fewer of them are
  // aligned and added.
  double min_track_share = 0.1;
  double min_camera_share = 0.1;
};

// What became of an observation.
enum class PatchOutcome {
  kUntouched,   // of a track or camera that stays as it is
  kReference,   // the others were aligned with it
  kAligned,     // moved
  kAdded,       // new
  kOutside,     // dropped: the patch leaves the image
  kDissimilar,  // dropped: low ZNCC, or the alignment does not end
  kVague,       // dropped: too little texture
  kShifted,     // dropped: too far from the keypoint
  kAmbiguous,   // dropped: two starts end in different places
  kAlone        // dropped: nothing aligns with it
};
constexpr size_t kNumPatchOutcomes = 10;

inline bool IsDropped(PatchOutcome outcome) {
  return outcome >= PatchOutcome::kOutside;
}

constexpr size_t kNoSource = std::numeric_limits<size_t>::max();

struct RefinedObservation {
  size_t camera_idx = 0;
  Eigen::Vector2d xy = Eigen::Vector2d::Zero();
  PatchOutcome outcome = PatchOutcome::kUntouched;
  // Index within the track before; kNoSource: added.
  size_t source_idx = kNoSource;
};

struct RefinedTrack {
  Eigen::Vector3d xyz = Eigen::Vector3d::Zero();
  std::vector<RefinedObservation> observations;  // without the dropped ones
  size_t source_idx = 0;                         // of the track before
  bool is_refined = false;
};

struct TrackRefinement {
  // Those that keep at least two observations, in the order of the tracks
  // before.
  std::vector<RefinedTrack> tracks;
  size_t num_refined_tracks = 0;
  // Observations by outcome.
  std::vector<size_t> num_observations =
      std::vector<size_t>(kNumPatchOutcomes, 0);
  // By camera: observations before, and those that are reference, aligned or
  // added after.
  std::vector<size_t> num_before;
  std::vector<size_t> num_refined;
  // Cameras that keep their keypoints, because too few could be aligned.
  std::vector<bool> is_kept;
  // Whether everything stays as it was.
  bool unchanged = false;

  size_t NumObservations(PatchOutcome outcome) const {
    return num_observations[static_cast<size_t>(outcome)];
  }
  size_t NumDropped() const;
};

// The tracks of one frame. images[i]: what cameras[i] saw; where it is empty,
// the camera's observations stay as they are and none is added. The result does
// not depend on the number of threads. `gpu`: where patches are aligned; null:
// on the CPU. Throws GpuError if it fails.
TrackRefinement RefinePatchTracks(const TrackRefinementOptions& options,
                                  const std::vector<PatchCamera>& cameras,
                                  const std::vector<SplineImage>& images,
                                  const std::vector<PatchTrack>& tracks,
                                  PatchBackend* gpu = nullptr);

}  // namespace mfir

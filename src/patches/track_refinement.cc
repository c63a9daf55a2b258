#include "src/patches/track_refinement.h"

#include <algorithm>
#include <utility>

#include "src/parallel/parallel_for.h"
#include "src/patches/track_refiner.h"

namespace mfir {
namespace {

// Together, which bounds the memory that they take: about 100 MiB.
constexpr size_t kNumTracksOnGpu = 4096;

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

// All tracks with the outcomes of all observations. On the CPU each track at a
// time: its patches stay in the cache.
std::vector<RefinedTrack> RefineAll(const TrackRefinementOptions& options,
                                    const std::vector<PatchCamera>& cameras,
                                    const std::vector<SplineImage>& images,
                                    const std::vector<PatchTrack>& tracks,
                                    PatchBackend* gpu) {
  std::vector<RefinedTrack> refined(tracks.size());
  const TrackRefiner refiner(options, cameras, images);
  if (gpu != nullptr) {
    gpu->SetImages(images);
    for (size_t i = 0; i < tracks.size(); i += kNumTracksOnGpu) {
      refiner.Refine(&tracks[i],
                     std::min(kNumTracksOnGpu, tracks.size() - i),
                     options.num_threads,
                     gpu,
                     &refined[i]);
    }
  } else {
    ParallelFor(tracks.size(), options.num_threads, [&](size_t i) {
      CpuPatchBackend cpu;
      cpu.SetImages(images);
      refiner.Refine(&tracks[i], 1, 1, &cpu, &refined[i]);
    });
  }
  for (size_t i = 0; i < refined.size(); ++i) refined[i].source_idx = i;
  return refined;
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
                                  const std::vector<PatchTrack>& tracks,
                                  PatchBackend* gpu) {
  std::vector<RefinedTrack> refined =
      RefineAll(options, cameras, images, tracks, gpu);
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

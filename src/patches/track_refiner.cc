#include "src/patches/track_refiner.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>

#include "src/parallel/parallel_for.h"
#include "src/patches/patch_slope.h"
#include "src/patches/point_fit.h"

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

// Of a warp or a result of the backend.
template <typename T>
Eigen::Vector2d Center(const T& patch) {
  return {patch.center[0], patch.center[1]};
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

// The view that the others are aligned with.
struct Reference {
  size_t observation_idx;
  size_t camera_idx;
  ReferencePatch view;
  double depth;
  Eigen::Vector2d slope;
};

// A track in work.
struct TrackWork {
  const PatchTrack* track;
  // Observations in the order in which they are tried as the reference.
  std::vector<size_t> order;
  Reference reference;
  size_t template_idx;
  RefinedTrack refined;  // with the present reference
  RefinedTrack first_attempt;
  std::vector<PointObservation> found;
  // Cameras to look for the patch in, with the negative cosine of their angle.
  std::vector<std::pair<double, size_t>> candidates;
  size_t next_candidate = 0;
};

// An alignment from two starts, with the outcome: which of the rules that the
// image decides fails, or kAligned.
struct AlignmentTask {
  TrackWork* work;
  size_t observation_idx;  // kNoSource: of a new view
  size_t camera_idx;
  Eigen::Vector2d projection;
  PatchWarp first;
  Eigen::Vector2d second_start;
  double min_zncc;
  PatchOutcome outcome;
  Eigen::Vector2d xy;
};

// Works on some tracks together, one step of all at a time.
class TrackGroup {
 public:
  TrackGroup(const TrackRefinementOptions& options,
             const std::vector<PatchCamera>& cameras,
             const std::vector<SplineImage>& images,
             const std::vector<Eigen::Vector3d>& centers,
             int num_threads,
             PatchBackend* backend)
      : options_(options),
        cameras_(cameras),
        images_(images),
        centers_(centers),
        num_threads_(num_threads),
        backend_(backend) {}

  void Refine(const PatchTrack* tracks, size_t count, RefinedTrack* refined) {
    std::vector<TrackWork> works(count);
    for (size_t i = 0; i < count; ++i) works[i].track = &tracks[i];
    ForEach(&works, [&](TrackWork& work) {
      work.order = ReferenceOrder(*work.track);
      work.refined = Untouched(*work.track);
      work.first_attempt = work.refined;
    });
    for (size_t attempt = 0; attempt < kMaxNumReferences; ++attempt) {
      std::vector<TrackWork*> open;
      for (TrackWork& work : works) {
        if (!work.refined.is_refined && attempt < work.order.size()) {
          open.push_back(&work);
        }
      }
      RefineFrom(attempt, std::move(open));
    }
    ForEach(&works, [&](TrackWork& work) {
      if (!work.refined.is_refined) GiveUp(&work);
    });
    for (size_t i = 0; i < count; ++i) refined[i] = std::move(works[i].refined);
  }

 private:
  // Calls function(item) for all items, on several threads.
  template <typename Item, typename Function>
  void ForEach(std::vector<Item>* items, const Function& function) const {
    ParallelFor(
        items->size(), num_threads_, [&](size_t i) { function((*items)[i]); });
  }

  template <typename Item, typename Function>
  static void EraseIf(std::vector<Item>* items, const Function& function) {
    items->erase(std::remove_if(items->begin(), items->end(), function),
                 items->end());
  }

  // Outcomes of all observations, to be completed.
  static RefinedTrack Untouched(const PatchTrack& track) {
    RefinedTrack result;
    result.xyz = track.xyz;
    for (size_t i = 0; i < track.observations.size(); ++i) {
      const PatchObservation& observation = track.observations[i];
      result.observations.push_back({observation.camera_idx,
                                     observation.xy,
                                     PatchOutcome::kUntouched,
                                     i});
    }
    return result;
  }

  // No view served as the reference.
  static void GiveUp(TrackWork* work) {
    work->refined = std::move(work->first_attempt);
    for (RefinedObservation& observation : work->refined.observations) {
      if (IsGood(observation.outcome) ||
          observation.outcome == PatchOutcome::kUntouched) {
        observation.outcome = PatchOutcome::kAlone;
      }
    }
  }

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

  bool MakeReference(size_t observation_idx,
                     TrackWork* work,
                     PatchTemplate* patch) const {
    const PatchTrack& track = *work->track;
    const PatchObservation& observation = track.observations[observation_idx];
    const PatchCamera& camera = cameras_[observation.camera_idx];
    Reference* reference = &work->reference;
    reference->observation_idx = observation_idx;
    reference->camera_idx = observation.camera_idx;
    reference->depth = (camera.cam_from_world * track.xyz).z();
    return reference->depth > 0.0 &&
           MakeReferencePatch(camera, observation.xy, &reference->view) &&
           MakePatchTemplate(
               images_[observation.camera_idx], observation.xy, patch);
  }

  // Aligns the other observations with the reference `attempt` of each track,
  // and completes the tracks. Those without any that aligns are not refined.
  void RefineFrom(size_t attempt, std::vector<TrackWork*> works) {
    std::vector<PatchTemplate> templates(works.size());
    std::vector<uint8_t> is_reference(works.size());
    ParallelFor(works.size(), num_threads_, [&](size_t i) {
      works[i]->template_idx = i;
      works[i]->refined = Untouched(*works[i]->track);
      is_reference[i] =
          MakeReference(works[i]->order[attempt], works[i], &templates[i]);
    });
    EraseIf(&works, [&](const TrackWork* work) {
      return !is_reference[work->template_idx];
    });
    if (works.empty()) return;
    backend_->SetTemplates(templates);
    FindSlopes(templates, works);
    AlignObservations(works);
    ForEach(&works, [&](TrackWork* work) {
      if (work->found.size() < 2) {
        if (attempt == 0) work->first_attempt = work->refined;
        return;
      }
      work->refined.is_refined = true;
      work->refined.observations[work->reference.observation_idx].outcome =
          PatchOutcome::kReference;
      work->refined.xyz = FitPoint(cameras_, work->found, work->track->xyz);
    });
    EraseIf(&works,
            [](const TrackWork* work) { return !work->refined.is_refined; });
    if (options_.complete_tracks) Complete(works);
    ForEach(&works, [&](TrackWork* work) {
      DropDuplicates(*work->track, &work->refined);
      if (!options_.refine_keypoints) {
        KeepKeypoints(*work->track, &work->refined);
      }
    });
  }

  // Observations that are aligned with the reference.
  static std::vector<size_t> Others(const TrackWork& work) {
    std::vector<size_t> others;
    for (const size_t i : work.order) {
      if (i != work.reference.observation_idx) others.push_back(i);
    }
    std::sort(others.begin(), others.end());
    return others;
  }

  // The views that are the most different from the reference.
  std::vector<SlopeView> SlopeViews(const TrackWork& work) const {
    const PatchTrack& track = *work.track;
    const Reference& reference = work.reference;
    std::vector<std::pair<double, SlopeView>> views;
    for (const size_t i : Others(work)) {
      const size_t camera_idx = track.observations[i].camera_idx;
      SlopeView view;
      view.image_idx = camera_idx;
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
    return chosen;
  }

  void FindSlopes(const std::vector<PatchTemplate>& templates,
                  const std::vector<TrackWork*>& works) {
    std::vector<SlopeProblem> problems(works.size());
    ParallelFor(works.size(), num_threads_, [&](size_t i) {
      problems[i].reference = &works[i]->reference.view;
      problems[i].patch = &templates[works[i]->template_idx];
      problems[i].template_idx = works[i]->template_idx;
      problems[i].views = SlopeViews(*works[i]);
    });
    EstimateSlopes(num_threads_, backend_, &problems);
    for (size_t i = 0; i < works.size(); ++i) {
      works[i]->reference.slope = problems[i].slope;
    }
  }

  static PatchJob MakeJob(const TrackWork& work,
                          size_t camera_idx,
                          const PatchWarp& warp) {
    return {static_cast<int>(work.template_idx),
            static_cast<int>(camera_idx),
            warp};
  }

  // Sets outcome and position of all tasks.
  void AlignTwice(std::vector<AlignmentTask>* tasks) {
    std::vector<PatchJob> jobs;
    for (const AlignmentTask& task : *tasks) {
      jobs.push_back(MakeJob(*task.work, task.camera_idx, task.first));
    }
    std::vector<AlignedPatch> aligned;
    backend_->Align(jobs, &aligned);
    std::vector<AlignmentTask*> open;
    jobs.clear();
    for (size_t i = 0; i < tasks->size(); ++i) {
      AlignmentTask& task = (*tasks)[i];
      task.outcome = Judge(aligned[i].alignment, task.min_zncc);
      task.xy = Center(aligned[i]);
      if (task.outcome != PatchOutcome::kAligned) continue;
      PatchWarp second = task.first;
      SetCenter(task.second_start, &second);
      jobs.push_back(MakeJob(*task.work, task.camera_idx, second));
      open.push_back(&task);
    }
    if (jobs.empty()) return;
    backend_->Align(jobs, &aligned);
    for (size_t i = 0; i < open.size(); ++i) {
      if (aligned[i].alignment.end != PatchEnd::kConverged ||
          (Center(aligned[i]) - open[i]->xy).norm() >
              options_.max_start_distance) {
        open[i]->outcome = PatchOutcome::kAmbiguous;
      }
    }
  }

  // Of the first start.
  PatchOutcome Judge(const PatchAlignment& alignment, double min_zncc) const {
    if (alignment.end == PatchEnd::kOutside) return PatchOutcome::kOutside;
    if (alignment.end != PatchEnd::kConverged || alignment.zncc < min_zncc) {
      return PatchOutcome::kDissimilar;
    }
    // Negated, so that NaN fails.
    return PatchStd(alignment) < options_.max_std ? PatchOutcome::kAligned
                                                  : PatchOutcome::kVague;
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

  // From the keypoint. False where the view cannot show the patch.
  bool MakeAlignmentTask(TrackWork* work,
                         size_t observation_idx,
                         AlignmentTask* task) const {
    const PatchObservation& observation =
        work->track->observations[observation_idx];
    const Reference& reference = work->reference;
    task->work = work;
    task->observation_idx = observation_idx;
    task->camera_idx = observation.camera_idx;
    task->min_zncc = options_.min_zncc;
    if (!MakePatchWarp(reference.view,
                       cameras_[observation.camera_idx],
                       reference.depth,
                       reference.slope,
                       &task->first)) {
      return false;
    }
    task->projection = Center(task->first);
    SetCenter(observation.xy, &task->first);
    task->second_start = SecondStart(observation.xy, task->projection);
    return true;
  }

  // Aligns all observations but the references.
  void AlignObservations(const std::vector<TrackWork*>& works) {
    std::vector<std::vector<AlignmentTask>> tasks_of(works.size());
    ParallelFor(works.size(), num_threads_, [&](size_t i) {
      const Reference& reference = works[i]->reference;
      works[i]->found = {
          {reference.camera_idx,
           works[i]->track->observations[reference.observation_idx].xy}};
      for (const size_t k : Others(*works[i])) {
        AlignmentTask task = {};
        if (MakeAlignmentTask(works[i], k, &task)) {
          tasks_of[i].push_back(task);
        } else {
          works[i]->refined.observations[k].outcome = PatchOutcome::kOutside;
        }
      }
    });
    std::vector<AlignmentTask> tasks;
    for (const std::vector<AlignmentTask>& some : tasks_of) {
      tasks.insert(tasks.end(), some.begin(), some.end());
    }
    AlignTwice(&tasks);
    for (const AlignmentTask& task : tasks) {
      RefinedObservation& observation =
          task.work->refined.observations[task.observation_idx];
      observation.outcome = task.outcome;
      if (task.outcome != PatchOutcome::kAligned) continue;
      if ((task.xy - observation.xy).norm() > options_.max_shift) {
        observation.outcome = PatchOutcome::kShifted;
        continue;
      }
      task.work->found.push_back({task.camera_idx, task.xy});
      observation.xy = task.xy;
    }
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

  // Looks for the patches in the cameras that have not found them, from the
  // nearest viewing direction on: each new view makes the point, and so the
  // next projection, better.
  void Complete(std::vector<TrackWork*> works) {
    ForEach(&works, [&](TrackWork* work) { FindCandidates(work); });
    while (!works.empty()) {
      std::vector<AlignmentTask> tasks(works.size());
      ParallelFor(works.size(), num_threads_, [&](size_t i) {
        MakeSearchTask(works[i], &tasks[i]);
      });
      EraseIf(&tasks,
              [](const AlignmentTask& task) { return task.work == nullptr; });
      works.clear();
      for (const AlignmentTask& task : tasks) works.push_back(task.work);
      Search(&tasks);
      AlignTwice(&tasks);
      ForEach(&tasks, [&](const AlignmentTask& task) { AddFound(task); });
    }
  }

  void FindCandidates(TrackWork* work) const {
    const double min_cosine = std::cos(options_.max_added_angle * M_PI / 180.0);
    const PatchTrack& track = *work->track;
    const Eigen::Vector3d direction =
        Direction(track, work->reference.camera_idx);
    for (size_t i = 0; i < cameras_.size(); ++i) {
      const double cosine = direction.dot(Direction(track, i));
      const bool is_found = std::any_of(
          work->found.begin(),
          work->found.end(),
          [&](const PointObservation& other) { return other.camera_idx == i; });
      if (cosine >= min_cosine && !is_found && !images_[i].Empty()) {
        work->candidates.emplace_back(-cosine, i);
      }
    }
    std::sort(work->candidates.begin(), work->candidates.end());
  }

  // A task for the next candidate that may show the patch; without `work` if
  // there is none.
  void MakeSearchTask(TrackWork* work, AlignmentTask* task) const {
    while (work->next_candidate < work->candidates.size()) {
      task->camera_idx = work->candidates[work->next_candidate++].second;
      if (!ProjectPatch(*work, task->camera_idx, &task->first)) continue;
      task->work = work;
      task->observation_idx = kNoSource;
      task->projection = Center(task->first);
      task->min_zncc = options_.min_added_zncc;
      return;
    }
    task->work = nullptr;
  }

  bool ProjectPatch(const TrackWork& work,
                    size_t camera_idx,
                    PatchWarp* warp) const {
    const Reference& reference = work.reference;
    const double depth =
        (cameras_[reference.camera_idx].cam_from_world * work.refined.xyz).z();
    return depth > 0.0 &&
           MakePatchWarp(reference.view,
                         cameras_[camera_idx],
                         depth,
                         reference.slope,
                         warp) &&
           IsPatchInside(images_[camera_idx].View(), *warp, kPatchRadius) &&
           SmallestScale(*warp) >= kMinAddedScale;
  }

  // Moves the start of each task to the best whole shift, and drops those where
  // nothing is similar.
  void Search(std::vector<AlignmentTask>* tasks) {
    std::vector<PatchJob> jobs;
    for (const AlignmentTask& task : *tasks) {
      jobs.push_back(MakeJob(*task.work, task.camera_idx, task.first));
    }
    std::vector<FoundPatch> found;
    backend_->Search(jobs, &found);
    std::vector<AlignmentTask> kept;
    for (size_t i = 0; i < tasks->size(); ++i) {
      // -1 near a border: then the projection is the start.
      if (found[i].zncc != -1.0f && found[i].zncc < kMinSearchZncc) continue;
      AlignmentTask& task = (*tasks)[i];
      SetCenter(Center(found[i]), &task.first);
      task.second_start = SecondStart(Center(task.first), task.projection);
      kept.push_back(task);
    }
    *tasks = std::move(kept);
  }

  void AddFound(const AlignmentTask& task) const {
    if (task.outcome != PatchOutcome::kAligned ||
        !((task.xy - task.projection).norm() <= options_.max_added_shift)) {
      return;
    }
    RefinedTrack* refined = &task.work->refined;
    task.work->found.push_back({task.camera_idx, task.xy});
    refined->observations.push_back(
        {task.camera_idx, task.xy, PatchOutcome::kAdded, kNoSource});
    refined->xyz = FitPoint(cameras_, task.work->found, refined->xyz);
  }

  const TrackRefinementOptions& options_;
  const std::vector<PatchCamera>& cameras_;
  const std::vector<SplineImage>& images_;
  const std::vector<Eigen::Vector3d>& centers_;
  const int num_threads_;
  PatchBackend* backend_;
};

}  // namespace

TrackRefiner::TrackRefiner(const TrackRefinementOptions& options,
                           const std::vector<PatchCamera>& cameras,
                           const std::vector<SplineImage>& images)
    : options_(options), cameras_(cameras), images_(images) {
  for (const PatchCamera& camera : cameras) {
    centers_.push_back(camera.cam_from_world.Center());
  }
}

void TrackRefiner::Refine(const PatchTrack* tracks,
                          size_t count,
                          int num_threads,
                          PatchBackend* backend,
                          RefinedTrack* refined) const {
  TrackGroup(options_, cameras_, images_, centers_, num_threads, backend)
      .Refine(tracks, count, refined);
}

}  // namespace mfir

#include "colmap_ext/controllers/keypoint_refinement.h"

#include <algorithm>
#include <memory>
#include <utility>

#include "colmap_ext/feature/image_folder.h"
#include "colmap_ext/host/image_file.h"
#include "colmap_ext/host/reconstruction.h"
#include "colmap_ext/host/util.h"
#include "cuda/patch_alignment_gpu.h"
#include "src/parallel/parallel_for.h"
#include "src/util/errors.h"
#include "src/util/gpu_choice.h"

namespace mfir {
namespace {

using Log = std::function<void(const std::string&)>;

SplineImage MakeSpline(const host::Bitmap& bitmap) {
  const std::vector<uint8_t> pixels = host::RowMajorData(bitmap);
  return SplineImage(static_cast<size_t>(bitmap.Width()),
                     static_cast<size_t>(bitmap.Height()),
                     std::vector<float>(pixels.begin(), pixels.end()));
}

// Empty where there is no file.
SplineImage FindImage(const ImageFolder& folder,
                      const std::string& frame_name,
                      const RigCamera& camera,
                      const FrameImage& image) {
  DenseFeatureRequest request;
  request.frame_name = frame_name;
  request.camera_name = camera.name;
  request.image_name = image.name;
  request.width = static_cast<int>(camera.width);
  request.height = static_cast<int>(camera.height);
  host::Bitmap bitmap;
  return folder.Read(request, /*as_rgb=*/false, &bitmap) ? MakeSpline(bitmap)
                                                         : SplineImage();
}

std::vector<SplineImage> ReadImages(const MultiFrameOptions& options,
                                    const ImageFolder& folder,
                                    const Scene& scene,
                                    const Frame& frame) {
  std::vector<SplineImage> images(frame.images.size());
  ParallelFor(images.size(), options.EffectiveNumThreads(), [&](size_t i) {
    images[i] = FindImage(folder,
                          frame.name,
                          scene.cameras[frame.images[i].camera_idx],
                          frame.images[i]);
  });
  return images;
}

// By image of the frame.
std::vector<PatchCamera> MakeCameras(const MultiFrameOptions& options,
                                     const Frame& frame,
                                     const std::vector<RigCamera>& rig,
                                     const FrameEstimate& estimate) {
  std::vector<PatchCamera> cameras;
  for (size_t i = 0; i < frame.images.size(); ++i) {
    const RigCamera& camera = rig[frame.images[i].camera_idx];
    cameras.push_back({camera.model,
                       camera.cam_from_world,
                       options.SingleFrameMode() ? estimate.images[i].params
                                                 : camera.params});
  }
  return cameras;
}

std::vector<PatchTrack> MakeTracks(const Frame& frame,
                                   const FrameEstimate& estimate) {
  std::vector<PatchTrack> tracks;
  for (size_t i = 0; i < frame.NumPoints(); ++i) {
    PatchTrack track;
    track.xyz = estimate.points[i];
    for (size_t k = frame.track_begins[i]; k < frame.track_begins[i + 1]; ++k) {
      const Observation& observation = frame.observations[k];
      track.observations.push_back({observation.image_idx, observation.xy});
    }
    tracks.push_back(std::move(track));
  }
  return tracks;
}

Frame MakeFrame(const Frame& before, const TrackRefinement& refinement) {
  Frame frame;
  frame.name = before.name;
  frame.images = before.images;
  for (const RefinedTrack& track : refinement.tracks) {
    for (const RefinedObservation& refined : track.observations) {
      Observation observation;
      observation.image_idx = refined.camera_idx;
      observation.xy = refined.xy;
      observation.keypoint_idx =
          refined.source_idx == kNoSource
              ? kNoKeypoint
              : before
                    .observations[before.track_begins[track.source_idx] +
                                  refined.source_idx]
                    .keypoint_idx;
      frame.observations.push_back(observation);
    }
    std::stable_sort(frame.observations.begin() +
                         static_cast<std::ptrdiff_t>(frame.track_begins.back()),
                     frame.observations.end(),
                     [](const Observation& a, const Observation& b) {
                       return a.image_idx < b.image_idx;
                     });
    frame.track_begins.push_back(frame.observations.size());
  }
  return frame;
}

std::vector<Eigen::Vector3d> Points(const TrackRefinement& refinement) {
  std::vector<Eigen::Vector3d> points;
  for (const RefinedTrack& track : refinement.tracks) {
    points.push_back(track.xyz);
  }
  return points;
}

void AddStatistics(const Frame& before,
                   const Frame& after,
                   const TrackRefinement& refinement,
                   KeypointStatistics* statistics) {
  statistics->num_frames += refinement.unchanged ? 0 : 1;
  statistics->num_before += before.observations.size();
  statistics->num_reference +=
      refinement.NumObservations(PatchOutcome::kReference);
  statistics->num_aligned += refinement.NumObservations(PatchOutcome::kAligned);
  statistics->num_added += refinement.NumObservations(PatchOutcome::kAdded);
  statistics->num_dropped += refinement.NumDropped();
  for (size_t i = 0; i < before.images.size(); ++i) {
    statistics->num_refined_by_camera[before.images[i].camera_idx] +=
        refinement.num_refined[i];
  }
  for (const Observation& observation : after.observations) {
    ++statistics
          ->num_after_by_camera[after.images[observation.image_idx].camera_idx];
  }
}

std::string Describe(const Frame& frame, const TrackRefinement& refinement) {
  if (refinement.unchanged) {
    return "Frame '" + frame.name +
           "' keeps its keypoints: too few patches can be aligned";
  }
  const auto count = [&](PatchOutcome outcome) {
    return refinement.NumObservations(outcome);
  };
  std::string line = host::StringPrintf(
      "Frame '%s': %zu of %zu tracks refined; observations: %zu aligned, %zu "
      "reference, %zu added, %zu as they were, %zu dropped (%zu vague, %zu "
      "dissimilar, %zu shifted, %zu ambiguous, %zu outside, %zu alone)",
      frame.name.c_str(),
      refinement.num_refined_tracks,
      frame.NumPoints(),
      count(PatchOutcome::kAligned),
      count(PatchOutcome::kReference),
      count(PatchOutcome::kAdded),
      count(PatchOutcome::kUntouched),
      refinement.NumDropped(),
      count(PatchOutcome::kVague),
      count(PatchOutcome::kDissimilar),
      count(PatchOutcome::kShifted),
      count(PatchOutcome::kAmbiguous),
      count(PatchOutcome::kOutside),
      count(PatchOutcome::kAlone));
  const auto num_kept =
      std::count(refinement.is_kept.begin(), refinement.is_kept.end(), true);
  if (num_kept > 0) {
    line += host::StringPrintf("; %zu images keep their keypoints",
                               static_cast<size_t>(num_kept));
  }
  return line;
}

// The images of a model with the keypoints of the frame. Added ones come after
// those that the image has; their indices are set in the frame.
void AddImages(const FrameModel& model,
               Frame* frame,
               host::Reconstruction* reconstruction) {
  std::vector<std::vector<Eigen::Vector2d>> keypoints;
  std::vector<const host::Image*> images;
  for (const FrameImage& frame_image : frame->images) {
    const host::Image& image =
        model.reconstruction->Image(model.image_ids.at(frame_image.camera_idx));
    images.push_back(&image);
    keypoints.emplace_back();
    for (const auto& point : image.Points2D()) {
      keypoints.back().push_back(host::Xy(point));
    }
  }
  for (Observation& observation : frame->observations) {
    std::vector<Eigen::Vector2d>& image_keypoints =
        keypoints[observation.image_idx];
    if (observation.keypoint_idx == kNoKeypoint) {
      observation.keypoint_idx = static_cast<uint32_t>(image_keypoints.size());
      image_keypoints.push_back(observation.xy);
    } else {
      image_keypoints[observation.keypoint_idx] = observation.xy;
    }
  }
  for (size_t i = 0; i < images.size(); ++i) {
    host::AddCameraWithTrivialRig(
        model.reconstruction->Camera(images[i]->CameraId()), reconstruction);
    host::Image image;
    image.SetImageId(images[i]->ImageId());
    image.SetName(images[i]->Name());
    image.SetCameraId(images[i]->CameraId());
    image.SetPoints2D(keypoints[i]);
    host::AddImageWithTrivialFrame(
        image, host::CamFromWorld(*images[i]), reconstruction);
  }
}

// Colour of the point that an observation had before.
host::Color FindColor(const FrameModel& model,
                      const Frame& frame,
                      size_t point_idx) {
  for (size_t k = frame.track_begins[point_idx];
       k < frame.track_begins[point_idx + 1];
       ++k) {
    const Observation& observation = frame.observations[k];
    const host::Image& image = model.reconstruction->Image(
        model.image_ids.at(frame.images[observation.image_idx].camera_idx));
    if (observation.keypoint_idx >= image.NumPoints2D()) continue;
    const host::Point2D& point = image.Point2D(observation.keypoint_idx);
    if (point.HasPoint3D()) {
      return host::ColorOf(
          model.reconstruction->Point3D(host::Point3DId(point)));
    }
  }
  return host::Color::Zero();
}

std::unique_ptr<host::Reconstruction> MakeModel(
    const FrameModel& model,
    const std::vector<Eigen::Vector3d>& points,
    Frame frame) {
  auto reconstruction = std::make_unique<host::Reconstruction>();
  AddImages(model, &frame, reconstruction.get());
  for (size_t i = 0; i < points.size(); ++i) {
    host::Track track;
    for (size_t k = frame.track_begins[i]; k < frame.track_begins[i + 1]; ++k) {
      const Observation& observation = frame.observations[k];
      track.AddElement(
          model.image_ids.at(frame.images[observation.image_idx].camera_idx),
          observation.keypoint_idx);
    }
    // Ids ascend, in the order of the frame.
    reconstruction->AddPoint3D(points[i], track, FindColor(model, frame, i));
  }
  return reconstruction;
}

void SumStatistics(const Communicator& ranks, KeypointStatistics* statistics) {
  for (size_t* count : {&statistics->num_frames,
                        &statistics->num_before,
                        &statistics->num_reference,
                        &statistics->num_aligned,
                        &statistics->num_added,
                        &statistics->num_dropped}) {
    *count = Sum(ranks, *count);
  }
  for (std::vector<size_t>* counts :
       {&statistics->num_refined_by_camera, &statistics->num_after_by_camera}) {
    *counts = Sum(ranks, *counts);
  }
}

// Of one frame, with all cameras of the rig. They keep their numbers, images or
// not: those of the model have id = index + 1.
Capture MakeCapture(const std::vector<RigCamera>& cameras,
                    const std::string& frame_name,
                    host::Reconstruction reconstruction) {
  Capture capture;
  for (const RigCamera& camera : cameras) {
    capture.cameras.emplace_back();
    capture.cameras.back().name = camera.name;
    capture.cameras.back().cam_from_world = camera.cam_from_world;
  }
  FrameModel& model = capture.frames.emplace_back();
  model.name = frame_name;
  model.image_ids = ImageIdsByCamera(reconstruction);
  model.reconstruction =
      std::make_unique<host::Reconstruction>(std::move(reconstruction));
  return capture;
}

}  // namespace

host::Reconstruction RefineKeypointsOfModel(
    const TrackRefinementOptions& options,
    const std::vector<RigCamera>& cameras,
    const std::map<size_t, std::string>& image_paths,
    const std::string& frame_name,
    host::Reconstruction reconstruction,
    std::string* line) {
  Capture capture = MakeCapture(cameras, frame_name, std::move(reconstruction));
  FrameModel& model = capture.frames[0];
  const SceneEstimate built = BuildScene(capture);
  const Frame& frame = built.scene.frames[0];
  std::vector<PatchCamera> patch_cameras;
  std::vector<SplineImage> images(frame.images.size());
  for (const FrameImage& image : frame.images) {
    const RigCamera& camera = cameras[image.camera_idx];
    patch_cameras.push_back(
        {camera.model, camera.cam_from_world, camera.params});
  }
  ParallelFor(images.size(), options.num_threads, [&](size_t i) {
    const size_t camera_idx = frame.images[i].camera_idx;
    const auto path = image_paths.find(camera_idx);
    if (path == image_paths.end()) return;
    images[i] =
        MakeSpline(ReadImage(path->second,
                             static_cast<int>(cameras[camera_idx].width),
                             static_cast<int>(cameras[camera_idx].height),
                             /*as_rgb=*/false));
  });
  const TrackRefinement refinement =
      RefinePatchTracks(options,
                        patch_cameras,
                        images,
                        MakeTracks(frame, built.estimate.frames[0]));
  *line = Describe(frame, refinement);
  if (refinement.unchanged) return std::move(*model.reconstruction);
  model.reconstruction =
      MakeModel(model, Points(refinement), MakeFrame(frame, refinement));
  SceneEstimate refined = BuildScene(capture);
  refined.estimate.cameras = cameras;
  // With the errors of the points.
  return RefinedReconstruction(Similarity3(),
                               model,
                               refined.scene,
                               refined.estimate,
                               /*frame_idx=*/0,
                               capture.cameras,
                               /*single_frame_mode=*/false);
}

KeypointRefinement RefineKeypoints(const MultiFrameOptions& options,
                                   const std::string& image_path,
                                   const Log& log,
                                   const Scene& scene,
                                   const Estimate& estimate) {
  TrackRefinementOptions track_options;
  track_options.refine_keypoints = options.refine_keypoints == 1;
  track_options.complete_tracks = options.complete_tracks == 1;
  track_options.num_threads = options.EffectiveNumThreads();
  const ImageFolder folder(image_path);
  GpuChoice<PatchBackend> gpu(
      options.use_gpu, "Keypoints are refined on the CPU", [&] {
        return CreateGpuPatchBackend(options.gpu_index);
      });
  if (gpu.Get() != nullptr) {
    log("Keypoints are refined on " + gpu.Get()->Name());
  }
  KeypointRefinement result;
  result.statistics.num_refined_by_camera.assign(scene.cameras.size(), 0);
  result.statistics.num_after_by_camera.assign(scene.cameras.size(), 0);
  for (size_t f = 0; f < scene.frames.size(); ++f) {
    const Frame& frame = scene.frames[f];
    const FrameEstimate& frame_estimate = estimate.frames[f];
    const std::vector<PatchCamera> cameras =
        MakeCameras(options, frame, estimate.cameras, frame_estimate);
    const std::vector<SplineImage> images =
        ReadImages(options, folder, scene, frame);
    const std::vector<PatchTrack> tracks = MakeTracks(frame, frame_estimate);
    TrackRefinement refinement;
    gpu.Call([&](PatchBackend* backend) {
      refinement =
          RefinePatchTracks(track_options, cameras, images, tracks, backend);
    });
    const std::string fallback = gpu.TakeFallback();
    if (!fallback.empty()) log(fallback);
    log(Describe(frame, refinement));
    result.frames.push_back(
        refinement.unchanged ? frame : MakeFrame(frame, refinement));
    result.points.push_back(Points(refinement));
    AddStatistics(frame, result.frames.back(), refinement, &result.statistics);
  }
  SumStatistics(*scene.ranks, &result.statistics);
  return result;
}

Capture ReplaceKeypoints(const KeypointRefinement& refinement,
                         Capture capture) {
  size_t f = 0;
  for (FrameModel& model : capture.frames) {
    if (!model.skip_reason.empty()) continue;
    model.reconstruction =
        MakeModel(model, refinement.points[f], refinement.frames[f]);
    ++f;
  }
  return capture;
}

}  // namespace mfir

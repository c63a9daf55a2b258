#include "colmap_ext/frames/frames.h"

#include <algorithm>
#include <exception>
#include <filesystem>
#include <utility>

#include "colmap_ext/frames/frame_source.h"
#include "colmap_ext/host/util.h"
#include "colmap_ext/io/input_file.h"
#include "colmap_ext/models/camera_models.h"
#include "colmap_ext/rigs/rig_scaling.h"
#include "src/parallel/parallel_for.h"
#include "src/selection/frame_choice.h"
#include "src/sensor/camera_conversion.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

constexpr size_t kMinNumImages = 3;

// Images of the frame by index of their rig camera; the others are reported.
void MatchImages(const CameraNaming& naming,
                 const std::map<std::string, size_t>& camera_idxs,
                 FrameModel* frame,
                 Capture* capture) {
  std::vector<host::image_t> image_ids = frame->reconstruction->RegImageIds();
  std::sort(image_ids.begin(), image_ids.end());
  std::vector<std::string> image_names;
  for (const host::image_t image_id : image_ids) {
    image_names.push_back(frame->reconstruction->Image(image_id).Name());
  }
  const std::vector<std::string> camera_names =
      naming.OfFrame(frame->name).Names(image_names);
  std::map<std::string, std::string> image_of_camera;
  for (size_t i = 0; i < image_ids.size(); ++i) {
    const auto it = camera_idxs.find(camera_names[i]);
    if (it == camera_idxs.end()) {
      const std::string image_path = frame->name + "/" + image_names[i];
      capture->images_without_camera.push_back(image_path);
      capture->image_of_unknown_name.emplace(camera_names[i], image_path);
      host::DeRegisterImage(image_ids[i], frame->reconstruction.get());
      continue;
    }
    const auto inserted =
        image_of_camera.emplace(camera_names[i], image_names[i]);
    if (!inserted.second) {
      throw InputError(frame->model_path + ": the images '" +
                       inserted.first->second + "' and '" + image_names[i] +
                       "' of one frame belong to the same camera '" +
                       camera_names[i] +
                       "'. Set --MultiFrame.camera_name_regex to a pattern "
                       "whose group is the camera's name" +
                       (frame->is_part_of_model
                            ? ", or --MultiFrame.frame_name_regex to one whose "
                              "group is the frame's."
                            : "."));
    }
    frame->image_ids[it->second] = image_ids[i];
  }
}

// Gives every image a camera of its own, with id = index of the rig camera + 1.
void SplitCameras(FrameModel* frame) {
  std::vector<std::pair<host::image_t, host::camera_t>> camera_ids;
  for (const auto& [camera_idx, image_id] : frame->image_ids) {
    camera_ids.emplace_back(image_id,
                            static_cast<host::camera_t>(camera_idx + 1));
  }
  host::SplitCameras(camera_ids, frame->reconstruction.get());
}

void ConvertCameras(const CameraModel& target, FrameModel* frame) {
  for (const auto& idx_and_image : frame->image_ids) {
    host::Camera& camera = frame->reconstruction->Camera(
        static_cast<host::camera_t>(idx_and_image.first + 1));
    const CameraModel& source = *FindCameraModel(host::ModelId(camera));
    if (&source == &target) continue;
    const std::vector<double> params = ConvertCameraParams(source,
                                                           host::Params(camera),
                                                           host::Width(camera),
                                                           host::Height(camera),
                                                           target);
    host::SetModel(CameraModelId(target), params, &camera);
  }
}

// All images of a physical camera must have the same lens model and size.
void CheckCameras(const FrameModel& frame,
                  const std::vector<FrameModel>& previous_frames,
                  const std::vector<KnownCamera>& known_cameras) {
  for (const auto& idx_and_image : frame.image_ids) {
    const KnownCamera& known = known_cameras[idx_and_image.first];
    const auto camera_id = static_cast<host::camera_t>(idx_and_image.first + 1);
    const host::Camera& camera = frame.reconstruction->Camera(camera_id);
    const std::string what = "Camera '" + known.name + "' of frame '" +
                             frame.name + "' (" + frame.model_path + ") has ";
    const size_t width = host::Width(camera);
    const size_t height = host::Height(camera);
    const std::string size =
        std::to_string(width) + " x " + std::to_string(height) + " pixels";
    if (known.width > 0 && (known.width != width || known.height != height)) {
      throw InputError(
          what + size + ", but RIG says " + std::to_string(known.width) +
          " x " + std::to_string(known.height) +
          ". Is it the RIG of this array? " +
          ImageSizeAdvice(width, height, known.width, known.height));
    }
    for (const FrameModel& previous : previous_frames) {
      if (previous.reconstruction == nullptr) continue;
      if (previous.image_ids.count(idx_and_image.first) == 0) continue;
      const host::Camera& other = previous.reconstruction->Camera(camera_id);
      if (host::ModelId(other) != host::ModelId(camera)) {
        throw InputError(what + "the camera model " + camera.ModelName() +
                         ", but " + other.ModelName() + " in frame '" +
                         previous.name +
                         "'. Convert all with --MultiFrame.camera_model.");
      }
      const size_t other_width = host::Width(other);
      const size_t other_height = host::Height(other);
      if (other_width != width || other_height != height) {
        throw InputError(what + size + ", but " + std::to_string(other_width) +
                         " x " + std::to_string(other_height) + " in frame '" +
                         previous.name +
                         "'. Leave one of them out with "
                         "--frame_list_path.");
      }
      break;
    }
  }
}

// Brings calibrations of another resolution to that of the frame.
void ScaleCameras(const FrameModel& frame, std::vector<KnownCamera>* cameras) {
  for (const auto& idx_and_image : frame.image_ids) {
    const host::Camera& camera = frame.reconstruction->Camera(
        static_cast<host::camera_t>(idx_and_image.first + 1));
    KnownCamera& known = (*cameras)[idx_and_image.first];
    if (known.width == 0) continue;
    ScaleToImageSize(host::Width(camera), host::Height(camera), &known);
  }
}

// Points of a single image tell nothing.
void RemoveShortTracks(host::Reconstruction* reconstruction) {
  for (const host::point3D_t point_id : reconstruction->Point3DIds()) {
    if (host::TrackOf(reconstruction->Point3D(point_id)).Length() < 2) {
      reconstruction->DeletePoint3D(point_id);
    }
  }
}

// Matches the images with the cameras of the rig; says why if the frame cannot
// take part.
void MatchFrame(const CameraNaming& naming,
                const std::map<std::string, size_t>& camera_idxs,
                const CameraModel* target_model,
                FrameModel* frame,
                Capture* capture) {
  if (frame->reconstruction == nullptr) return;
  RemoveShortTracks(frame->reconstruction.get());
  MatchImages(naming, camera_idxs, frame, capture);
  SplitCameras(frame);
  if (target_model != nullptr) {
    ConvertCameras(*target_model, frame);
  }
  if (frame->image_ids.size() < kMinNumImages) {
    frame->skip_reason = "only " + std::to_string(frame->image_ids.size()) +
                         " of its images belong to cameras of the rig, " +
                         std::to_string(kMinNumImages) + " are needed";
  } else if (frame->reconstruction->NumPoints3D() == 0) {
    frame->skip_reason = "it has no points seen by two cameras of the rig";
  }
}

// Of the frames' indices: those of this rank, about as many for each.
std::pair<size_t, size_t> FramesOfRank(size_t num_frames,
                                       const Communicator& ranks) {
  const auto num_ranks = static_cast<size_t>(ranks.NumRanks());
  const auto rank = static_cast<size_t>(ranks.Rank());
  if (num_frames < num_ranks) {
    throw UsageError(std::to_string(num_ranks) + " processes for " +
                     std::to_string(num_frames) +
                     " frames: start no more processes than frames.");
  }
  return {num_frames * rank / num_ranks, num_frames * (rank + 1) / num_ranks};
}

void LogFrame(const FrameModel& frame, size_t idx, size_t num_frames) {
  std::cout << host::StringPrintf(
      "Frame %zu / %zu '%s': ", idx + 1, num_frames, frame.name.c_str());
  if (frame.skip_reason.empty()) {
    std::cout << frame.image_ids.size() << " images, "
              << frame.reconstruction->NumPoints3D() << " points" << std::endl;
  } else {
    std::cout << "skipped: " << frame.skip_reason << std::endl;
  }
}

// Models are read some at a time, side by side; all else is done in the order
// of the frames, errors included.
void ReadFrames(const MultiFrameOptions& options,
                const Rig& rig,
                const CameraModel* target_model,
                const std::map<std::string, size_t>& camera_idxs,
                const FrameSource& source,
                Capture* capture) {
  const CameraNaming naming(options.camera_name_regex);
  const std::vector<size_t> chosen =
      ChooseFrames(source.Names().size(), options.max_num_frames);
  const size_t num_frames = chosen.size();
  if (num_frames < source.Names().size() && !options.quiet &&
      capture->ranks->IsFirst()) {
    std::cout << num_frames << " of " << source.Names().size()
              << " frames are used (max_num_frames)" << std::endl;
  }
  const auto range = FramesOfRank(num_frames, *capture->ranks);
  ParallelInOrder(
      range.first,
      range.second,
      options.EffectiveNumThreads(),
      [&](size_t i) { return source.Read(chosen[i]); },
      [&](size_t i, FrameModel frame) {
        MatchFrame(naming, camera_idxs, target_model, &frame, capture);
        if (frame.reconstruction != nullptr) {
          if (rig.scale_intrinsics) ScaleCameras(frame, &capture->cameras);
          CheckCameras(frame, capture->frames, capture->cameras);
        }
        if (!options.quiet) LogFrame(frame, i, num_frames);
        if (!frame.skip_reason.empty()) frame.reconstruction.reset();
        capture->frames.push_back(std::move(frame));
      });
}

// Those of all ranks, on all of them.
void ShareUnmatchedImages(Capture* capture) {
  capture->images_without_camera =
      Concatenate(*capture->ranks, capture->images_without_camera);
  std::vector<std::string> names;
  std::vector<std::string> images;
  for (const auto& [name, image] : capture->image_of_unknown_name) {
    names.push_back(name);
    images.push_back(image);
  }
  names = Concatenate(*capture->ranks, names);
  images = Concatenate(*capture->ranks, images);
  for (size_t i = 0; i < names.size(); ++i) {
    capture->image_of_unknown_name.emplace(names[i], images[i]);
  }
}

void CheckAnyFrameIsUsed(const std::string& frames_path,
                         const Capture& capture) {
  const bool any_match = std::any_of(
      capture.frames.begin(), capture.frames.end(), [](const auto& frame) {
        return !frame.image_ids.empty();
      });
  if (!Any(*capture.ranks, any_match) &&
      !capture.images_without_camera.empty()) {
    throw InputError(
        "No image of any frame belongs to a camera of RIG: image '" +
        capture.images_without_camera.front() + "', camera '" +
        capture.cameras.front().name +
        "'. Is it the RIG of this array? Otherwise set "
        "--MultiFrame.camera_name_regex so that both give the same names.");
  }
  if (Sum(*capture.ranks, capture.NumUsedFrames()) == 0) {
    throw InputError("No frame in " + frames_path + " is usable; the first, '" +
                     capture.frames.front().name + "', is not because " +
                     capture.frames.front().skip_reason + ".");
  }
}

}  // namespace

std::vector<std::string> ListFrames(const std::string& option_name,
                                    const std::string& frames_path,
                                    const std::string& frame_list_path) {
  namespace fs = std::filesystem;
  std::error_code error;
  if (!fs::is_directory(frames_path, error)) {
    throw InputError(
        "--" + option_name + " " + frames_path +
        " is not a folder. Give the folder with one sub-folder per frame.");
  }
  std::vector<std::string> names;
  if (frame_list_path.empty()) {
    for (const auto& entry : fs::directory_iterator(frames_path)) {
      if (entry.is_directory()) {
        names.push_back(entry.path().filename().string());
      }
    }
    if (names.empty()) {
      throw InputError("--" + option_name + " " + frames_path +
                       " has no sub-folder. Give the folder with one "
                       "sub-folder per frame.");
    }
  } else {
    for (const ListEntry& entry :
         ReadNameList("--frame_list_path", frame_list_path)) {
      const std::string& name = entry.name;
      if (name == "." || name == ".." || name.find('/') != std::string::npos) {
        throw InputError(entry.where + "'" + name +
                         "' is a path. Give the name of a sub-folder.");
      }
      if (!fs::is_directory(fs::path(frames_path) / name, error)) {
        throw InputError(entry.where + "there is no frame '" + name + "' in " +
                         frames_path + ".");
      }
      names.push_back(name);
    }
  }
  std::sort(names.begin(), names.end());
  names.erase(std::unique(names.begin(), names.end()), names.end());
  return names;
}

Capture RemoveCamerasWithoutImages(Capture capture) {
  std::vector<bool> used(capture.cameras.size(), false);
  for (const FrameModel& frame : capture.frames) {
    if (!frame.skip_reason.empty()) continue;
    for (const auto& idx_and_image : frame.image_ids) {
      used[idx_and_image.first] = true;
    }
  }
  used = Any(*capture.ranks, used);
  std::vector<KnownCamera> cameras;
  std::map<size_t, size_t> new_idxs;
  for (size_t i = 0; i < capture.cameras.size(); ++i) {
    if (used[i]) {
      new_idxs[i] = cameras.size();
      cameras.push_back(capture.cameras[i]);
    } else {
      capture.cameras_without_images.push_back(capture.cameras[i].name);
    }
  }
  if (cameras.size() == capture.cameras.size()) return capture;
  capture.cameras = std::move(cameras);
  for (FrameModel& frame : capture.frames) {
    if (!frame.skip_reason.empty()) continue;
    std::map<size_t, host::image_t> image_ids;
    for (const auto& idx_and_image : frame.image_ids) {
      image_ids[new_idxs.at(idx_and_image.first)] = idx_and_image.second;
    }
    frame.image_ids = std::move(image_ids);
    // Camera ids follow the indices.
    SplitCameras(&frame);
  }
  return capture;
}

std::vector<const FrameModel*> Capture::UsedFrames() const {
  std::vector<const FrameModel*> used;
  for (const FrameModel& frame : frames) {
    if (frame.skip_reason.empty()) used.push_back(&frame);
  }
  return used;
}

Capture ReadCapture(const std::string& frames_path,
                    const std::string& frame_list_path,
                    const Rig& rig,
                    const MultiFrameOptions& options,
                    const Communicator& ranks) {
  const CameraModel* target_model = nullptr;
  if (!options.camera_model.empty()) {
    target_model = FindCameraModel(options.camera_model);
    if (target_model == nullptr) {
      throw UsageError("--MultiFrame.camera_model '" + options.camera_model +
                       "' is not a camera model of COLMAP.");
    }
  }

  Capture capture;
  capture.cameras = rig.cameras;
  std::sort(capture.cameras.begin(),
            capture.cameras.end(),
            [](const KnownCamera& a, const KnownCamera& b) {
              return CameraNameLess(a.name, b.name);
            });
  std::map<std::string, size_t> camera_idxs;
  for (size_t i = 0; i < capture.cameras.size(); ++i) {
    camera_idxs[capture.cameras[i].name] = i;
  }

  const std::unique_ptr<FrameSource> source = OpenFrames(
      frames_path, frame_list_path, options.frame_name_regex, capture.cameras);
  capture.ranks = &ranks;
  ReadFrames(options, rig, target_model, camera_idxs, *source, &capture);
  ShareUnmatchedImages(&capture);
  CheckAnyFrameIsUsed(frames_path, capture);
  return RemoveCamerasWithoutImages(std::move(capture));
}

}  // namespace mfir

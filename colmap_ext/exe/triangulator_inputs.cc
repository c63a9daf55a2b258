#include "colmap_ext/exe/triangulator_inputs.h"

#include <algorithm>
#include <filesystem>
#include <iostream>
#include <map>
#include <set>

#include <nlohmann/json.hpp>

#include "colmap_ext/frames/capture_images.h"
#include "colmap_ext/frames/capture_videos.h"
#include "colmap_ext/host/feature_options.h"
#include "colmap_ext/host/image_file.h"
#include "colmap_ext/host/util.h"
#include "colmap_ext/models/camera_models.h"
#include "colmap_ext/rigs/rig_io.h"
#include "colmap_ext/rigs/rig_scaling.h"
#include "src/scene/view_overlap.h"
#include "src/selection/frame_choice.h"
#include "src/sensor/image_name.h"
#include "src/sensor/unmatched_names.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

// MASKS has the layout of the images; a mask of a camera counts for all frames.
std::string FindMask(const TriangulatorOptions& options,
                     const std::string& frame_name,
                     const std::string& image_name,
                     const std::string& camera_name) {
  if (options.mask_path.empty()) return "";
  const fs::path masks = options.mask_path;
  const std::string own_name =
      fs::path(image_name).replace_extension(".png").string();
  for (const fs::path& path : {masks / frame_name / (image_name + ".png"),
                               masks / (image_name + ".png"),
                               masks / frame_name / own_name,
                               masks / own_name,
                               masks / (camera_name + ".png")}) {
    if (fs::is_regular_file(path)) return path.string();
  }
  return "";
}

// The images of the frame by camera of the rig; adds to
// `image_of_unknown_name`.
InputFrame MakeInputFrame(const TriangulatorOptions& options,
                          const Rig& rig,
                          const CaptureFrame& images,
                          ImageOfName* image_of_unknown_name) {
  InputFrame frame;
  frame.name = images.name;
  std::map<size_t, std::string> name_of_camera;
  std::vector<std::string> without_camera;
  for (const CaptureImage& image : images.images) {
    const auto camera = std::find_if(
        rig.cameras.begin(), rig.cameras.end(), [&](const KnownCamera& known) {
          return known.name == image.camera;
        });
    if (camera == rig.cameras.end()) {
      without_camera.push_back(image.name);
      image_of_unknown_name->emplace(image.camera,
                                     images.name + "/" + image.name);
      continue;
    }
    const auto camera_idx =
        static_cast<size_t>(std::distance(rig.cameras.begin(), camera));
    const auto inserted = name_of_camera.emplace(camera_idx, image.name);
    if (!inserted.second) {
      frame.failure = "the images '" + inserted.first->second + "' and '" +
                      image.name + "' belong to the same camera '" +
                      image.camera + "'; set --MultiFrame.camera_name_regex";
    }
    frame.files.push_back(
        {camera_idx,
         image.name,
         image.path,
         FindMask(
             options, images.name, image.name, FileStem(camera->image_name))});
  }
  if (!without_camera.empty()) {
    frame.warnings.push_back(std::to_string(without_camera.size()) +
                             " images belong to no camera of the rig and are "
                             "left out; the first: " +
                             without_camera.front());
  }
  return frame;
}

void LogMasks(const TriangulatorOptions& options,
              const std::vector<InputFrame>& frames) {
  if (options.mask_path.empty()) return;
  size_t num_masks = 0;
  size_t num_images = 0;
  for (const InputFrame& frame : frames) {
    num_images += frame.files.size();
    for (const FrameImageFile& file : frame.files) {
      num_masks += file.mask_path.empty() ? 0 : 1;
    }
  }
  if (num_masks == 0) {
    std::cerr << "WARNING: --mask_path " << options.mask_path
              << " has a mask for none of the images. Masks are called like "
                 "their images, with .png added."
              << std::endl;
  } else if (!options.quiet) {
    std::cout << num_masks << " of " << num_images << " images have a mask"
              << std::endl;
  }
}

// Those of max_num_frames, said in the log.
template <typename Frames, typename NameOf>
Frames Choose(const TriangulatorOptions& options,
              Frames frames,
              const NameOf& name_of) {
  const size_t num_frames = frames.size();
  Frames chosen;
  std::string names;
  for (const size_t idx : ChooseFrames(num_frames, options.max_num_frames)) {
    chosen.push_back(std::move(frames[idx]));
    names += " " + name_of(chosen.back());
  }
  if (chosen.size() < num_frames && !options.quiet) {
    std::cout << chosen.size() << " of " << num_frames
              << " frames are taken (max_num_frames):" << names << std::endl;
  }
  return chosen;
}

// The frames of videos, decoded to the output.
CaptureImages FindVideoFrames(const TriangulatorOptions& options,
                              const CameraNaming& naming,
                              const std::vector<std::string>& rig_cameras) {
  const std::vector<CaptureVideo> videos = FindCaptureVideos(
      options.image_path, rig_cameras, naming, options.video_offset_list_path);
  const std::vector<std::string> frames =
      Choose(options,
             ListVideoFrames(videos, options.frame_list_path),
             [](const std::string& name) { return name; });
  const auto log = [&options](const std::string& line) {
    if (!options.quiet) std::cout << line << std::endl;
  };
  log("videos by camera: " + videos.front().path + ", " +
      std::to_string(frames.size()) + " frames to decode to " +
      options.output_path);
  return {"",
          DecodeVideos(
              videos, frames, options.output_path, options.num_threads, log),
          {}};
}

// The frames with their images, in any layout.
std::vector<InputFrame> FindFrames(const TriangulatorOptions& options,
                                   const CameraNaming& naming,
                                   const Rig& rig,
                                   ImageOfName* image_of_unknown_name) {
  std::vector<std::string> names;
  for (const KnownCamera& camera : rig.cameras) names.push_back(camera.name);
  CaptureImages images = HasVideosOnly(options.image_path)
                             ? FindVideoFrames(options, naming, names)
                             : FindCaptureImages(options.image_path,
                                                 options.frame_list_path,
                                                 names,
                                                 naming,
                                                 options.frame_name_regex);
  if (!options.quiet && !images.description.empty()) {
    std::cout << images.description << std::endl;
  }
  if (!images.left_out.empty()) {
    std::cerr << "WARNING: " << images.left_out.size()
              << " image files are in no frame and left out; the first: "
              << images.left_out.front() << std::endl;
  }
  // Of videos they are chosen before they are decoded.
  images.frames = Choose(options,
                         std::move(images.frames),
                         [](const CaptureFrame& frame) { return frame.name; });
  std::vector<InputFrame> frames;
  for (const CaptureFrame& frame : images.frames) {
    frames.push_back(
        MakeInputFrame(options, rig, frame, image_of_unknown_name));
  }
  LogMasks(options, frames);
  return frames;
}

// Image size of a camera, from its first image that can be read. False if
// there is none.
bool FindImageSize(const std::vector<InputFrame>& frames,
                   size_t camera_idx,
                   RigCamera* camera) {
  for (const InputFrame& frame : frames) {
    for (const FrameImageFile& file : frame.files) {
      host::Bitmap bitmap;
      if (file.camera_idx == camera_idx &&
          bitmap.Read(file.path, /*as_rgb=*/false)) {
        camera->width = bitmap.Width();
        camera->height = bitmap.Height();
        return true;
      }
    }
  }
  return false;
}

// Sets the intrinsics to start from.
void SetIntrinsics(const TriangulatorOptions& options,
                   const KnownCamera* known,
                   RigCamera* camera) {
  if (options.focal_length_factor > 0.0) {
    camera->model = FindCameraModel(options.camera_model);
    camera->params = host::InitialParams(
        CameraModelId(*camera->model),
        options.focal_length_factor * std::max(camera->width, camera->height),
        camera->width,
        camera->height);
  } else if (known != nullptr && known->model != nullptr) {
    camera->model = known->model;
    camera->params = known->params;
  } else {
    throw InputError(
        "Camera '" + camera->name + "' has no intrinsics in " +
        (options.intrinsics_path.empty() ? options.extrinsics_path
                                         : options.intrinsics_path) +
        ". Give a model with all cameras as --intrinsics_path, or set "
        "--MultiFrameTriangulator.focal_length_factor.");
  }
}

std::vector<RigCamera> MakeCameras(const TriangulatorOptions& options,
                                   const Rig& extrinsics,
                                   const Rig& intrinsics,
                                   const std::vector<InputFrame>& frames) {
  std::map<std::string, KnownCamera> known_cameras;
  for (const KnownCamera& camera : intrinsics.cameras) {
    known_cameras[camera.name] = camera;
  }
  std::set<size_t> used;
  for (const InputFrame& frame : frames) {
    for (const FrameImageFile& file : frame.files) used.insert(file.camera_idx);
  }
  std::vector<RigCamera> cameras;
  for (size_t i = 0; i < extrinsics.cameras.size(); ++i) {
    const KnownCamera& source = extrinsics.cameras[i];
    KnownCamera* known = known_cameras.count(source.name) > 0
                             ? &known_cameras.at(source.name)
                             : nullptr;
    RigCamera camera;
    camera.name = source.name;
    camera.cam_from_world = source.cam_from_world;
    if (used.count(i) > 0) {
      if (known != nullptr) {
        if (options.scale_intrinsics && known->width > 0 &&
            FindImageSize(frames, i, &camera)) {
          ScaleToImageSize(camera.width, camera.height, known);
        }
        camera.width = known->width;
        camera.height = known->height;
      }
      if (camera.width == 0 && !FindImageSize(frames, i, &camera)) {
        throw InputError("Camera '" + camera.name +
                         "': its size is not in RIG, and none of its images "
                         "can be read. Correct the images.");
      }
      SetIntrinsics(options, known, &camera);
    }
    cameras.push_back(std::move(camera));
  }
  return cameras;
}

std::vector<std::string> CamerasWithoutImages(
    const std::vector<RigCamera>& cameras) {
  std::vector<std::string> names;
  for (const RigCamera& camera : cameras) {
    if (camera.model == nullptr) names.push_back(camera.name);
  }
  return names;
}

// Pairs of cameras that have images.
std::vector<std::pair<size_t, size_t>> SelectPairs(
    const TriangulatorOptions& options, const std::vector<RigCamera>& cameras) {
  std::vector<RigCamera> used;
  std::vector<size_t> idxs;
  for (size_t i = 0; i < cameras.size(); ++i) {
    if (cameras[i].model == nullptr) continue;
    used.push_back(cameras[i]);
    idxs.push_back(i);
  }
  if (used.size() < 2) {
    throw InputError("Only " + std::to_string(used.size()) + " cameras of " +
                     options.extrinsics_path + " have images in " +
                     options.image_path +
                     ". Is it the RIG of this array? Images are looked for as "
                     "IMAGES/FRAME/CAMERA.ext, IMAGES/CAMERA/FRAME.ext, "
                     "IMAGES/CAMERA_FRAME.ext and IMAGES/FRAME_CAMERA.ext; "
                     "otherwise set --MultiFrame.camera_name_regex (and "
                     "frame_name_regex) so that names agree.");
  }
  std::vector<std::pair<size_t, size_t>> pairs =
      SelectOverlappingPairs(options.view_overlap, used, options.num_threads);
  for (auto& [i, j] : pairs) {
    i = idxs[i];
    j = idxs[j];
  }
  return pairs;
}

// FNV-1a hash of the options and cameras that decide on the result.
std::string Fingerprint(const OptionParser& parser,
                        const std::vector<RigCamera>& cameras) {
  Json json = parser.ToJson();
  const std::string extraction = host::kExtractionSection;
  const std::string matching = host::kMatchingSection;
  for (const std::string& name :
       {std::string("output_path"),
        std::string("frame_list_path"),
        std::string("MultiFrame.max_num_frames"),
        std::string("MultiFrameTriangulator.num_threads"),
        std::string("MultiFrameTriangulator.overwrite"),
        std::string("MultiFrameTriangulator.quiet"),
        extraction + "num_threads",
        matching + "num_threads"}) {
    json.erase(name);
  }
  for (const RigCamera& camera : cameras) {
    const Rigid3& pose = camera.cam_from_world;
    const Eigen::Vector4d q = pose.rotation.coeffs();
    const Eigen::Vector3d& t = pose.translation;
    json["cameras"].push_back({camera.name,
                               {camera.width, camera.height},
                               camera.params,
                               {q(0), q(1), q(2), q(3)},
                               {t(0), t(1), t(2)}});
  }
  uint64_t hash = 14695981039346656037u;
  for (const char c :
       json.dump(-1, ' ', false, Json::error_handler_t::replace)) {
    hash = (hash ^ static_cast<unsigned char>(c)) * 1099511628211u;
  }
  return host::StringPrintf("%016zx", static_cast<size_t>(hash));
}

}  // namespace

TriangulatorInputs ReadTriangulatorInputs(const TriangulatorOptions& options,
                                          const OptionParser& parser) {
  TriangulatorInputs inputs{
      CameraNaming(options.camera_name_regex), {}, {}, {}, ""};
  const Rig extrinsics = ReadRig(options.extrinsics_path,
                                 options.extrinsics_format,
                                 inputs.naming,
                                 options.extrinsics_pixel_offset);
  const Rig intrinsics = options.intrinsics_path.empty()
                             ? extrinsics
                             : ReadRig(options.intrinsics_path,
                                       options.intrinsics_format,
                                       inputs.naming,
                                       options.intrinsics_pixel_offset);
  if (!options.quiet) {
    for (const std::string& remark : extrinsics.remarks) {
      std::cout << remark << std::endl;
    }
  }
  if (!options.mask_path.empty() && !fs::is_directory(options.mask_path)) {
    throw InputError("--mask_path " + options.mask_path + " is not a folder.");
  }
  ImageOfName image_of_unknown_name;
  inputs.frames =
      FindFrames(options, inputs.naming, extrinsics, &image_of_unknown_name);
  inputs.cameras = MakeCameras(options, extrinsics, intrinsics, inputs.frames);
  WarnOfUnmatchedNames(
      CamerasWithoutImages(inputs.cameras), image_of_unknown_name, std::cerr);
  inputs.pairs = SelectPairs(options, inputs.cameras);
  inputs.fingerprint = Fingerprint(parser, inputs.cameras);
  return inputs;
}

}  // namespace mfir

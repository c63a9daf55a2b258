#include "colmap_ext/frames/frame_source.h"

#include <algorithm>
#include <filesystem>
#include <iostream>
#include <map>
#include <set>
#include <utility>

#include "colmap_ext/host/reconstruction.h"
#include "colmap_ext/io/input_file.h"
#include "colmap_ext/models/model_frames.h"
#include "colmap_ext/models/model_io.h"
#include "src/sensor/frame_naming.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

// In the folder of the frame, in its folder of sparse models, or with the
// model; "" if there is none.
std::string FindDatabase(const fs::path& frame_path,
                         const fs::path& model_path) {
  std::error_code error;
  for (const fs::path& folder :
       {frame_path, frame_path / "sparse", model_path}) {
    const fs::path path = folder / "database.db";
    if (fs::is_regular_file(path, error)) return path.string();
  }
  return "";
}

class FolderOfFrames : public FrameSource {
 public:
  FolderOfFrames(const std::string& path, std::vector<std::string> names)
      : path_(path), names_(std::move(names)) {}

  const std::vector<std::string>& Names() const override { return names_; }

  FrameModel Read(size_t idx) const override {
    FrameModel frame;
    frame.name = names_[idx];
    const fs::path folder = path_ / frame.name;
    frame.model_path = FindSparseModel(folder.string());
    if (frame.model_path.empty()) {
      frame.skip_reason = "it has no sparse model";
      return frame;
    }
    frame.database_path = FindDatabase(folder, frame.model_path);
    frame.reconstruction = std::make_unique<host::Reconstruction>();
    ReadModel(frame.model_path, true, frame.reconstruction.get());
    return frame;
  }

 private:
  const fs::path path_;
  const std::vector<std::string> names_;
};

using ImageIds = std::vector<host::image_t>;
using ImageIdsOfFrame = std::map<std::string, ImageIds>;

class ModelOfFrames : public FrameSource {
 public:
  ModelOfFrames(const std::string& path,
                host::Reconstruction model,
                const ImageIdsOfFrame& frames)
      : path_(path), model_(std::move(model)) {
    for (const auto& [name, image_ids] : frames) {
      names_.push_back(name);
      image_ids_.push_back(image_ids);
    }
  }

  const std::vector<std::string>& Names() const override { return names_; }

  FrameModel Read(size_t idx) const override {
    FrameModel frame;
    frame.name = names_[idx];
    frame.model_path = path_;
    frame.is_part_of_model = true;
    frame.reconstruction = std::make_unique<host::Reconstruction>(
        host::ExtractImages(image_ids_[idx], model_));
    return frame;
  }

 private:
  const std::string path_;
  const host::Reconstruction model_;
  std::vector<std::string> names_;
  std::vector<ImageIds> image_ids_;
};

std::vector<std::string> ImageNames(const ImageIds& image_ids,
                                    const host::Reconstruction& model) {
  std::vector<std::string> names;
  for (const host::image_t image_id : image_ids) {
    names.push_back(model.Image(image_id).Name());
  }
  return names;
}

// By COLMAP 4's frames. Empty without them, or if they say nothing: one image
// each, as COLMAP 4 makes them without a rig.
ImageIdsOfFrame GroupByModelFrames(const std::string& path,
                                   const host::Reconstruction& model) {
  const std::vector<ImageIds> groups = ReadModelFrames(path, model);
  ImageIdsOfFrame frames;
  if (std::all_of(groups.begin(), groups.end(), [](const ImageIds& ids) {
        return ids.size() == 1;
      })) {
    return frames;
  }
  std::vector<std::vector<std::string>> image_names;
  for (const ImageIds& image_ids : groups) {
    image_names.push_back(ImageNames(image_ids, model));
  }
  const std::vector<std::string> names = NamesOfFrames(image_names);
  for (size_t i = 0; i < groups.size(); ++i) frames[names[i]] = groups[i];
  return frames;
}

void WarnOfImagesWithoutFrame(const std::vector<std::string>& image_names) {
  if (image_names.empty()) return;
  std::cerr << "WARNING: " << image_names.size()
            << " images are of no frame and are left out, since "
               "--MultiFrame.frame_name_regex does not match them; the first: "
            << image_names.front() << std::endl;
}

ImageIdsOfFrame GroupByImageNames(const std::string& path,
                                  const std::string& regex,
                                  const std::vector<KnownCamera>& cameras,
                                  const host::Reconstruction& model) {
  ImageIds image_ids = model.RegImageIds();
  std::sort(image_ids.begin(), image_ids.end());
  const std::vector<std::string> image_names = ImageNames(image_ids, model);
  std::set<std::string> camera_names;
  for (const KnownCamera& camera : cameras) camera_names.insert(camera.name);
  const std::vector<std::string> names =
      FrameNames(image_names, camera_names, regex);
  ImageIdsOfFrame frames;
  std::vector<std::string> without_frame;
  for (size_t i = 0; i < image_ids.size(); ++i) {
    if (names[i].empty()) {
      without_frame.push_back(image_names[i]);
    } else {
      frames[names[i]].push_back(image_ids[i]);
    }
  }
  if (frames.empty()) {
    throw InputError(path + (image_names.empty()
                                 ? ": the model has no images."
                                 : ": --MultiFrame.frame_name_regex matches no "
                                   "image of the model, such as '" +
                                       image_names.front() + "'."));
  }
  WarnOfImagesWithoutFrame(without_frame);
  return frames;
}

// Those that a list names.
ImageIdsOfFrame Select(const std::string& path,
                       const std::string& frame_list_path,
                       const ImageIdsOfFrame& frames) {
  if (frame_list_path.empty()) return frames;
  ImageIdsOfFrame selected;
  for (const ListEntry& entry :
       ReadNameList("--frame_list_path", frame_list_path)) {
    const auto it = frames.find(entry.name);
    if (it == frames.end()) {
      throw InputError(entry.where + "there is no frame '" + entry.name +
                       "' in " + path + ". Its first is '" +
                       frames.begin()->first + "'.");
    }
    selected.insert(*it);
  }
  return selected;
}

}  // namespace

std::unique_ptr<FrameSource> OpenFrames(
    const std::string& frames_path,
    const std::string& frame_list_path,
    const std::string& frame_name_regex,
    const std::vector<KnownCamera>& cameras) {
  if (!IsModelFolder(frames_path)) {
    return std::make_unique<FolderOfFrames>(
        frames_path, ListFrames("input_path", frames_path, frame_list_path));
  }
  host::Reconstruction model;
  ReadModel(frames_path, true, &model);
  ImageIdsOfFrame frames;
  if (frame_name_regex.empty()) {
    frames = GroupByModelFrames(frames_path, model);
  }
  if (frames.empty()) {
    frames = GroupByImageNames(frames_path, frame_name_regex, cameras, model);
  }
  frames = Select(frames_path, frame_list_path, frames);
  return std::make_unique<ModelOfFrames>(frames_path, std::move(model), frames);
}

}  // namespace mfir

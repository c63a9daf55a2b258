#include "colmap_ext/rigs/rig_io.h"

#include <algorithm>
#include <cmath>
#include <filesystem>

#include "colmap_ext/host/reconstruction.h"
#include "colmap_ext/io/work_folder.h"
#include "colmap_ext/rigs/rig_images.h"
#include "src/util/errors.h"
#include "src/util/interruption.h"
#include "src/util/parse_number.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

void CheckNamesDiffer(const std::string& path,
                      const std::vector<KnownCamera>& cameras) {
  for (size_t i = 1; i < cameras.size(); ++i) {
    if (cameras[i].name == cameras[i - 1].name) {
      throw InputError(path + ": '" + cameras[i - 1].image_name + "' and '" +
                       cameras[i].image_name + "' are both camera '" +
                       cameras[i].name +
                       "'. Remove one, or tell them apart by "
                       "--MultiFrame.camera_name_regex.");
    }
  }
}

std::vector<KnownCamera> NamedCameras(const std::string& path,
                                      const RigFormat& format,
                                      const CameraNaming& naming,
                                      std::vector<KnownCamera> cameras) {
  if (format.names_images) {
    NameRigImages(naming, &cameras);
    return MergeRigImages(path, std::move(cameras));
  }
  for (KnownCamera& camera : cameras) {
    camera.name = naming.CameraName(camera.image_name);
  }
  std::sort(cameras.begin(),
            cameras.end(),
            [](const KnownCamera& a, const KnownCamera& b) {
              return a.name != b.name ? CameraNameLess(a.name, b.name)
                                      : a.image_name < b.image_name;
            });
  CheckNamesDiffer(path, cameras);
  return cameras;
}

// Moves what was written into place, file by file if it is a folder.
void Publish(const fs::path& written, const fs::path& path) {
  const SignalDelay delay;
  if (!fs::is_directory(written)) {
    fs::rename(written, path);
    return;
  }
  fs::create_directories(path);
  for (const auto& entry : fs::directory_iterator(written)) {
    fs::rename(entry.path(), path / entry.path().filename());
  }
}

}  // namespace

Rig ReadRig(const std::string& path,
            const std::string& format_name,
            const CameraNaming& naming,
            double pixel_offset) {
  const RigFormat& format =
      format_name.empty() || format_name == "auto"
          ? DetectRigFormat(path)
          : FindRigFormat("extrinsics_format", format_name);
  Rig rig;
  rig.format = format.name;
  std::vector<KnownCamera> images =
      format.read(path,
                  std::isnan(pixel_offset) ? format.pixel_offset : pixel_offset,
                  &rig.remarks);
  if (images.empty()) {
    throw InputError(path +
                     ": no camera in it. Give the rig with its known "
                     "extrinsics.");
  }
  const size_t num_images = images.size();
  rig.cameras = NamedCameras(path, format, naming, std::move(images));
  if (rig.cameras.size() < num_images) {
    rig.remarks.push_back(path + ": " + std::to_string(num_images) +
                          " images of " + std::to_string(rig.cameras.size()) +
                          " cameras, whose poses agree");
  }
  for (KnownCamera& camera : rig.cameras) {
    Eigen::Quaterniond& rotation = camera.cam_from_world.rotation;
    rotation = host::StableQuaternion(rotation);
    // One alone says nothing.
    if (camera.width == 0 || camera.height == 0) {
      camera.width = camera.height = 0;
    }
  }
  return rig;
}

void CheckPixelOffset(const std::string& option, double pixel_offset) {
  constexpr double kMaxOffset = 1e4;
  if (std::abs(pixel_offset) > kMaxOffset) {
    throw UsageError(option + " " + FormatNumber(pixel_offset) +
                     " is in pixels and must be between -10000 and 10000 (nan: "
                     "that of the format).");
  }
}

RigRemarks WriteRig(const std::string& path,
                    const RigFormat& format,
                    const std::vector<KnownCamera>& cameras) {
  const fs::path result = fs::path(path + "/").parent_path();
  RigRemarks remarks;
  try {
    const WorkFolder folder(WorkFolder::Beside(result));
    const fs::path written = folder.Path() / "rig";
    format.write(written.string(), cameras, format.pixel_offset, &remarks);
    Publish(written, result);
  } catch (const fs::filesystem_error& error) {
    throw OutputError(path + ": cannot write: " + error.what() + ".");
  }
  return remarks;
}

}  // namespace mfir

#include <cmath>
#include <cstdint>
#include <limits>
#include <string>
#include <unordered_set>
#include <utility>
#include <vector>

#include "colmap_ext/io/binary_file.h"
#include "colmap_ext/io/input_file.h"
#include "colmap_ext/models/camera_models.h"
#include "colmap_ext/models/model_check.h"
#include "colmap_ext/models/track_references.h"

namespace mfir {
namespace {

const uint32_t kInvalidId32 = std::numeric_limits<uint32_t>::max();
const uint64_t kInvalidId64 = std::numeric_limits<uint64_t>::max();
// Longer names are no paths, but garbled files.
const size_t kMaxNameLength = 4096;

using Ids = std::unordered_set<uint64_t>;

Ids CheckBinaryCameras(const std::string& path, const std::string& copy) {
  BinaryFile file(path, ReadInputFile(copy));
  Ids ids;
  const uint64_t num = file.ReadCount(4 + 4 + 8 + 8);
  for (uint64_t i = 0; i < num; ++i) {
    file.SetEntry("camera", i, num);
    const uint32_t id = file.Read<uint32_t>();
    const int32_t model_id = file.Read<int32_t>();
    file.Skip(2, sizeof(uint64_t));  // width, height
    const CameraModel* model = FindCameraModel(model_id);
    if (model == nullptr) {
      if (const auto reason = WhyNotSupported(model_id)) {
        throw InputError(path + ": camera " + std::to_string(id) + ": " +
                         *reason);
      }
      file.Fail("unknown camera model " + std::to_string(model_id));
    }
    file.Skip(model->NumParams(), sizeof(double));
    if (id == kInvalidId32 || !ids.insert(id).second) {
      file.Fail("camera id " + std::to_string(id) +
                " is invalid or occurs twice");
    }
  }
  file.RequireEnd();
  return ids;
}

// The points of an image's observations.
std::vector<uint64_t> ReadPoint3DIds(BinaryFile* file) {
  std::vector<uint64_t> ids(file->ReadCount(8 + 8 + 8));
  for (uint64_t& id : ids) {
    file->Skip(2, sizeof(double));  // position
    id = file->Read<uint64_t>();
  }
  return ids;
}

size_t CheckBinaryImages(const std::string& path,
                         const std::string& copy,
                         const Ids& camera_ids,
                         TrackReferences* references) {
  BinaryFile file(path, ReadInputFile(copy));
  Ids ids;
  const uint64_t num = file.ReadCount(4 + 7 * 8 + 4 + 1 + 8);
  for (uint64_t i = 0; i < num; ++i) {
    file.SetEntry("image", i, num);
    const uint32_t id = file.Read<uint32_t>();
    double squared_norm = 0.0;
    for (int k = 0; k < 4; ++k) {
      const double q = file.Read<double>();
      squared_norm += q * q;
    }
    file.Skip(3, sizeof(double));  // translation
    const uint32_t camera_id = file.Read<uint32_t>();
    const std::string name = file.ReadString();
    std::vector<uint64_t> point3D_ids = ReadPoint3DIds(&file);
    if (id == kInvalidId32 || !ids.insert(id).second) {
      file.Fail("image id " + std::to_string(id) +
                " is invalid or occurs twice");
    }
    if (!std::isfinite(squared_norm) || squared_norm == 0.0) {
      file.Fail("image id " + std::to_string(id) +
                ": the rotation quaternion is zero or not finite");
    }
    if (camera_ids.count(camera_id) == 0) {
      file.Fail("image id " + std::to_string(id) +
                ": the cameras file has no "
                "camera " +
                std::to_string(camera_id));
    }
    if (name.empty() || name.size() > kMaxNameLength) {
      file.Fail("image id " + std::to_string(id) + ": the image name has " +
                std::to_string(name.size()) + " characters");
    }
    references->AddImage(id, name, std::move(point3D_ids));
  }
  file.RequireEnd();
  return num;
}

void CheckBinaryPoints3D(const std::string& path,
                         const std::string& copy,
                         const TrackReferences& references) {
  BinaryFile file(path, ReadInputFile(copy));
  Ids ids;
  const uint64_t num = file.ReadCount(8 + 3 * 8 + 3 + 8 + 8);
  ids.reserve(num);
  for (uint64_t i = 0; i < num; ++i) {
    file.SetEntry("point", i, num);
    const uint64_t id = file.Read<uint64_t>();
    file.Skip(1, 3 * 8 + 3 + 8);  // position, color, error
    std::vector<TrackReferences::Element> track(file.ReadCount(4 + 4));
    for (TrackReferences::Element& element : track) {
      element.image_id = file.Read<uint32_t>();
      element.point2D_idx = file.Read<uint32_t>();
    }
    if (id == kInvalidId64 || !ids.insert(id).second) {
      file.Fail("point id " + std::to_string(id) +
                " is invalid or occurs twice");
    }
    references.CheckTrack(path, id, std::move(track));
  }
  file.RequireEnd();
}

}  // namespace

size_t CheckBinaryModel(const ModelFiles& files, const ModelFiles& copies) {
  const Ids camera_ids = CheckBinaryCameras(files.cameras, copies.cameras);
  TrackReferences references;
  const size_t num_images =
      CheckBinaryImages(files.images, copies.images, camera_ids, &references);
  if (!files.points3D.empty()) {
    CheckBinaryPoints3D(files.points3D, copies.points3D, references);
  }
  return num_images;
}

}  // namespace mfir

#include <cmath>
#include <cstdint>
#include <limits>
#include <unordered_set>

#include "colmap_ext/io/binary_file.h"
#include "colmap_ext/io/camera_models.h"
#include "colmap_ext/io/input_file.h"
#include "colmap_ext/io/model_check.h"

namespace mfir {
namespace {

const uint32_t kInvalidId32 = std::numeric_limits<uint32_t>::max();
const uint64_t kInvalidId64 = std::numeric_limits<uint64_t>::max();
// Longer names are no paths, but garbled files.
const size_t kMaxNameLength = 4096;

using Ids = std::unordered_set<uint64_t>;

Ids CheckCameras(const std::string& path, const std::string& copy) {
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

size_t CheckImages(const std::string& path,
                   const std::string& copy,
                   const Ids& camera_ids) {
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
    const size_t name_length = file.SkipString();
    const uint64_t num_points2D = file.ReadCount(8 + 8 + 8);
    file.Skip(num_points2D, 8 + 8 + 8);
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
    if (name_length == 0 || name_length > kMaxNameLength) {
      file.Fail("image id " + std::to_string(id) + ": the image name has " +
                std::to_string(name_length) + " characters");
    }
  }
  file.RequireEnd();
  return num;
}

void CheckPoints3D(const std::string& path, const std::string& copy) {
  BinaryFile file(path, ReadInputFile(copy));
  Ids ids;
  const uint64_t num = file.ReadCount(8 + 3 * 8 + 3 + 8 + 8);
  ids.reserve(num);
  for (uint64_t i = 0; i < num; ++i) {
    file.SetEntry("point", i, num);
    const uint64_t id = file.Read<uint64_t>();
    file.Skip(1, 3 * 8 + 3 + 8);  // position, color, error
    const uint64_t track_length = file.ReadCount(4 + 4);
    file.Skip(track_length, 4 + 4);
    if (id == kInvalidId64 || !ids.insert(id).second) {
      file.Fail("point id " + std::to_string(id) +
                " is invalid or occurs twice");
    }
  }
  file.RequireEnd();
}

}  // namespace

size_t CheckBinaryModel(const ModelFiles& files, const ModelFiles& copies) {
  const Ids camera_ids = CheckCameras(files.cameras, copies.cameras);
  const size_t num_images =
      CheckImages(files.images, copies.images, camera_ids);
  if (!files.points3D.empty()) {
    CheckPoints3D(files.points3D, copies.points3D);
  }
  return num_images;
}

}  // namespace mfir

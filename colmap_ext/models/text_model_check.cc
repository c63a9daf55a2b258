#include <cstdint>
#include <limits>
#include <string>
#include <unordered_set>
#include <utility>
#include <vector>

#include "colmap_ext/io/input_file.h"
#include "colmap_ext/io/text_file.h"
#include "colmap_ext/models/camera_models.h"
#include "colmap_ext/models/model_check.h"
#include "colmap_ext/models/track_references.h"

namespace mfir {
namespace {

using Ids = std::unordered_set<uint64_t>;

// Reads an identifier; the largest one of its type means "none" to COLMAP.
template <typename T>
T ReadId(TextFile* file, const char* field) {
  const T id = file->Number<T>(field);
  if (id == std::numeric_limits<T>::max() || id < T(0)) {
    file->Fail(std::string(field) + " " + std::to_string(id) + " is invalid");
  }
  return id;
}

template <typename T>
T ReadNewId(TextFile* file, const char* field, Ids* ids) {
  const T id = ReadId<T>(file, field);
  if (!ids->insert(id).second) {
    file->Fail(std::string(field) + " " + std::to_string(id) +
               " occurs for the second time");
  }
  return id;
}

TextFile OpenModelFile(const std::string& path, const std::string& copy) {
  return TextFile(path, ReadTextFile(copy), TextFile::Spacing::kOneSpace);
}

Ids CheckTextCameras(const std::string& path, const std::string& copy) {
  TextFile file = OpenModelFile(path, copy);
  Ids ids;
  while (file.NextContentLine()) {
    ReadNewId<uint32_t>(&file, "CAMERA_ID", &ids);
    const std::string model_name(file.Token("MODEL"));
    const CameraModel* model = FindCameraModel(model_name);
    if (model == nullptr) {
      if (const auto reason = WhyNotSupported(model_name)) {
        throw InputError(path + ":" + std::to_string(file.LineNumber()) + ": " +
                         *reason);
      }
      file.Fail("unknown camera model '" + model_name + "'");
    }
    file.Number<uint32_t>("WIDTH");
    file.Number<uint32_t>("HEIGHT");
    for (size_t i = 0; i < model->NumParams(); ++i) {
      file.FiniteNumber("PARAMS");
    }
    file.RequireLineEnd(("the " + std::to_string(model->NumParams()) +
                         " parameters of " + model_name)
                            .c_str());
  }
  return ids;
}

struct ImageLine {
  uint32_t image_id = 0;
  std::string name;
};

ImageLine CheckImageLine(TextFile* file,
                         const Ids& camera_ids,
                         Ids* image_ids) {
  ImageLine image;
  image.image_id = ReadNewId<uint32_t>(file, "IMAGE_ID", image_ids);
  double squared_norm = 0.0;
  for (const char* field : {"QW", "QX", "QY", "QZ"}) {
    const double q = file->FiniteNumber(field);
    squared_norm += q * q;
  }
  if (squared_norm == 0.0) {
    file->Fail("the rotation quaternion QW QX QY QZ is zero");
  }
  for (const char* field : {"TX", "TY", "TZ"}) {
    file->FiniteNumber(field);
  }
  const uint32_t camera_id = file->Number<uint32_t>("CAMERA_ID");
  if (camera_ids.count(camera_id) == 0) {
    file->Fail("cameras.txt has no camera " + std::to_string(camera_id));
  }
  image.name = file->Token("NAME");
  file->RequireLineEnd(
      "NAME (the text format cannot hold names with spaces: convert the model "
      "to binary)");
  return image;
}

// Returns the points of the observations.
std::vector<uint64_t> CheckObservationLine(TextFile* file) {
  std::vector<uint64_t> point3D_ids;
  while (!file->AtLineEnd()) {
    file->FiniteNumber("X of POINTS2D (the second line of an image)");
    file->FiniteNumber("Y of POINTS2D");
    const int64_t point3D_id = file->Number<int64_t>("POINT3D_ID");
    if (point3D_id < -1) {
      file->Fail("POINT3D_ID " + std::to_string(point3D_id) +
                 " is neither an id nor -1");
    }
    point3D_ids.push_back(static_cast<uint64_t>(point3D_id));
  }
  return point3D_ids;
}

size_t CheckTextImages(const std::string& path,
                       const std::string& copy,
                       const Ids& camera_ids,
                       TrackReferences* references) {
  TextFile file = OpenModelFile(path, copy);
  Ids ids;
  while (file.NextContentLine()) {
    const ImageLine image = CheckImageLine(&file, camera_ids, &ids);
    if (!file.NextLine()) {
      file.Fail(
          "the second line of the last image is missing; end the file with an "
          "empty line if the image has no observations");
    }
    references->AddImage(
        image.image_id, image.name, CheckObservationLine(&file));
  }
  return ids.size();
}

void CheckTextPoints3D(const std::string& path,
                       const std::string& copy,
                       const TrackReferences& references) {
  TextFile file = OpenModelFile(path, copy);
  Ids ids;
  while (file.NextContentLine()) {
    const int64_t id = ReadNewId<int64_t>(&file, "POINT3D_ID", &ids);
    for (const char* field : {"X", "Y", "Z"}) {
      file.FiniteNumber(field);
    }
    for (const char* field : {"R", "G", "B"}) {
      file.Number<uint8_t>(field);
    }
    // Unused by everyone, and not finite in some exporters' files.
    file.Number<double>("ERROR");
    std::vector<TrackReferences::Element> track;
    while (!file.AtLineEnd()) {
      const auto image_id = ReadId<uint32_t>(&file, "IMAGE_ID of TRACK");
      const auto point2D_idx = ReadId<uint32_t>(&file, "POINT2D_IDX of TRACK");
      track.push_back({image_id, point2D_idx});
    }
    references.CheckTrack(path, static_cast<uint64_t>(id), std::move(track));
  }
}

}  // namespace

size_t CheckTextModel(const ModelFiles& files, const ModelFiles& copies) {
  const Ids camera_ids = CheckTextCameras(files.cameras, copies.cameras);
  TrackReferences references;
  const size_t num_images =
      CheckTextImages(files.images, copies.images, camera_ids, &references);
  if (!files.points3D.empty()) {
    CheckTextPoints3D(files.points3D, copies.points3D, references);
  }
  return num_images;
}

}  // namespace mfir

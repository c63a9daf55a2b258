#include <charconv>
#include <fstream>

#include "colmap_ext/io/input_file.h"
#include "colmap_ext/io/text_file.h"
#include "colmap_ext/rigs/rig_formats.h"
#include "colmap_ext/rigs/rig_io.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

void NextRow(TextFile* file, const std::string& camera_name) {
  if (!file->NextContentLine()) {
    file->Fail("the file ends within camera " + camera_name +
               ", which needs 8 lines: name, 3 rows of K, distortion "
               "(5 numbers), 3 rows of [R | t]");
  }
}

template <typename Matrix>
Matrix ReadMatrix(TextFile* file,
                  const std::string& camera_name,
                  const std::string& matrix_name) {
  Matrix matrix;
  for (int row = 0; row < matrix.rows(); ++row) {
    NextRow(file, camera_name);
    const std::string field = "row " + std::to_string(row + 1) + " of " +
                              matrix_name + " of camera " + camera_name;
    for (int col = 0; col < matrix.cols(); ++col) {
      matrix(row, col) = file->FiniteNumber(field.c_str());
    }
    file->RequireLineEnd(field.c_str());
  }
  return matrix;
}

void WriteRow(const double* values, int num, std::ofstream* file) {
  for (int i = 0; i < num; ++i) {
    char text[32];
    // %.17g, but independent of the locale.
    const auto end = std::to_chars(std::begin(text),
                                   std::end(text),
                                   values[i],
                                   std::chars_format::general,
                                   17);
    *file << (i > 0 ? " " : "") << std::string_view(text, end.ptr - text);
  }
  *file << "\n";
}

// Sets k1 k2 p1 p2 k3; false if KRT cannot hold the model's distortion.
bool DistortionForKRT(const KnownCamera& camera, double* distortion) {
  const std::string& model = camera.model->Name();
  std::vector<double> extra;
  for (const size_t idx : camera.model->ExtraParamsIdxs()) {
    extra.push_back(camera.params[idx]);
  }
  if (model == "FULL_OPENCV") {
    if (extra[5] != 0.0 || extra[6] != 0.0 || extra[7] != 0.0) {
      return false;
    }
    extra.resize(5);
  } else if (model != "SIMPLE_PINHOLE" && model != "PINHOLE" &&
             model != "SIMPLE_RADIAL" && model != "RADIAL" &&
             model != "OPENCV") {
    return false;
  }
  // All of these begin with k1, k2, as KRT does.
  std::copy(extra.begin(), extra.end(), distortion);
  return true;
}

// Returns whether the file holds the camera's distortion.
bool WriteCamera(const KnownCamera& camera, std::ofstream* file) {
  const std::vector<size_t>& focal_idxs = camera.model->FocalLengthIdxs();
  const std::vector<size_t>& center_idxs = camera.model->PrincipalPointIdxs();
  const double K[3][3] = {
      {camera.params[focal_idxs.front()], 0.0, camera.params[center_idxs[0]]},
      {0.0, camera.params[focal_idxs.back()], camera.params[center_idxs[1]]},
      {0.0, 0.0, 1.0}};
  double distortion[5] = {0.0, 0.0, 0.0, 0.0, 0.0};
  const bool has_distortion = DistortionForKRT(camera, distortion);
  Eigen::Matrix<double, 3, 4, Eigen::RowMajor> matrix;
  if (camera.matrix) {
    matrix = *camera.matrix;
  } else {
    matrix << camera.cam_from_world.rotation.normalized().toRotationMatrix(),
        camera.cam_from_world.translation;
  }

  *file << camera.name << "\n";
  for (const double* row : K) {
    WriteRow(row, 3, file);
  }
  WriteRow(distortion, 5, file);
  for (int row = 0; row < 3; ++row) {
    WriteRow(matrix.data() + 4 * row, 4, file);
  }
  *file << "\n";
  return has_distortion;
}

}  // namespace

std::vector<KnownCamera> ReadKRTCameras(const std::string& path,
                                        double pixel_offset) {
  TextFile file(path, ReadTextFile(path), TextFile::Spacing::kAny);
  std::vector<KnownCamera> cameras;
  while (file.NextContentLine()) {
    KnownCamera camera;
    camera.image_name = std::string(file.Line());
    const std::string where = path + ":" + std::to_string(file.LineNumber()) +
                              ": camera " + camera.image_name;
    const auto K = ReadMatrix<Eigen::Matrix3d>(&file, camera.image_name, "K");
    const auto distortion = ReadMatrix<Eigen::Matrix<double, 1, 5>>(
        &file, camera.image_name, "the distortion");
    const auto matrix = ReadMatrix<Eigen::Matrix<double, 3, 4>>(
        &file, camera.image_name, "[R | t]");
    SetIntrinsics(K,
                  {distortion.data(), distortion.data() + distortion.size()},
                  pixel_offset,
                  where,
                  &camera);
    SetPose(matrix, where, &camera);
    cameras.push_back(std::move(camera));
  }
  return cameras;
}

std::vector<std::string> WriteKRT(const std::string& path,
                                  const std::vector<KnownCamera>& cameras) {
  std::ofstream file(path, std::ios::trunc);
  std::vector<std::string> without_distortion;
  for (const KnownCamera& camera : cameras) {
    if (!WriteCamera(camera, &file)) {
      without_distortion.push_back(camera.name);
    }
  }
  file.close();
  if (!file) {
    throw OutputError(path +
                      ": cannot write the file. Does its folder exist, "
                      "is it writable, and is the disk not full?");
  }
  return without_distortion;
}

}  // namespace mfir

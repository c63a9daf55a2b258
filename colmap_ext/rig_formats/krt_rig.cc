#include "colmap_ext/io/input_file.h"
#include "colmap_ext/io/text_file.h"
#include "colmap_ext/rig_formats/camera_fields.h"
#include "colmap_ext/rig_formats/formats.h"

namespace mfir {
namespace {

// k1 k2 p1 p2 k3
constexpr size_t kNumDistortion = 5;

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

void AppendRow(const std::vector<double>& values, std::string* text) {
  for (size_t i = 0; i < values.size(); ++i) {
    *text += (i > 0 ? " " : "") + ExactNumber(values[i]);
  }
  *text += "\n";
}

template <typename Matrix>
void AppendMatrix(const Matrix& matrix, std::string* text) {
  for (int row = 0; row < matrix.rows(); ++row) {
    std::vector<double> values;
    for (int col = 0; col < matrix.cols(); ++col) {
      values.push_back(matrix(row, col));
    }
    AppendRow(values, text);
  }
}

}  // namespace

Cameras ReadKRTRig(const std::string& path,
                   double pixel_offset,
                   RigRemarks* /*remarks*/) {
  TextFile file(path, ReadTextFile(path), TextFile::Spacing::kAny);
  Cameras cameras;
  while (file.NextContentLine()) {
    KnownCamera camera;
    camera.image_name = std::string(file.Line());
    const std::string where = path + ":" + std::to_string(file.LineNumber()) +
                              ": camera " + camera.image_name;
    const auto K = ReadMatrix<Eigen::Matrix3d>(&file, camera.image_name, "K");
    const auto distortion =
        ReadMatrix<Eigen::Matrix<double, 1, kNumDistortion>>(
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
                                  const Cameras& cameras,
                                  double pixel_offset) {
  std::string text;
  std::vector<std::string> without_distortion;
  for (const KnownCamera& camera : cameras) {
    RequireIntrinsics("krt", camera);
    Lens lens = LensOf(camera);
    if (lens.kind != Lens::Kind::kBrown || lens.distortion[5] != 0.0 ||
        lens.distortion[6] != 0.0 || lens.distortion[7] != 0.0) {
      without_distortion.push_back(camera.name);
      lens.distortion.assign(kNumDistortion, 0.0);
    }
    lens.distortion.resize(kNumDistortion);
    text += camera.name + "\n";
    AppendMatrix(lens.K(pixel_offset), &text);
    AppendRow(lens.distortion, &text);
    AppendMatrix(PoseMatrix(camera), &text);
    text += "\n";
  }
  WriteRigFile(path, text);
  return without_distortion;
}

void WriteKRTRig(const std::string& path,
                 const Cameras& cameras,
                 double pixel_offset,
                 RigRemarks* remarks) {
  for (const std::string& name : WriteKRT(path, cameras, pixel_offset)) {
    remarks->push_back("KRT cannot hold the distortion of camera '" + name +
                       "'; it has zeros there.");
  }
  for (const KnownCamera& camera : cameras) {
    if (camera.width == 0) continue;
    remarks->push_back("KRT holds no image sizes");
    break;
  }
}

}  // namespace mfir

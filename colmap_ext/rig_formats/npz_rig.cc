// Known cameras as arrays of NumPy, named as in the metadata that DUSt3R's
// loader of ScanNet++ reads. Source: DUSt3R, dust3r/datasets/scannetpp.py,
// dust3r/cloud_opt/modular_optimizer.py (preset_pose, preset_intrinsics).

#include "colmap_ext/io/npz_file.h"
#include "colmap_ext/rig_formats/camera_fields.h"
#include "colmap_ext/rig_formats/formats.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

constexpr const char* kNames = "images";
constexpr const char* kIntrinsics = "intrinsics";  // 3 x 3
constexpr const char* kPoses = "trajectories";     // 4 x 4, camera to world
constexpr const char* kSizes = "image_sizes";      // width, height

using RowMatrix3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
using RowMatrix4 = Eigen::Matrix<double, 4, 4, Eigen::RowMajor>;

// An array of that shape.
std::vector<double> ReadNumbers(const NpzFile& file,
                                const std::string& name,
                                const std::vector<size_t>& shape) {
  NumpyArray array = file.At(name);
  if (array.shape != shape || !array.texts.empty()) {
    std::string text;
    for (const size_t size : shape) {
      text += (text.empty() ? "" : " x ") + std::to_string(size);
    }
    file.Fail(name, "is not one of " + text + " numbers");
  }
  return std::move(array.numbers);
}

void ReadCamera(const double* K,
                const double* pose,
                double pixel_offset,
                const std::string& where,
                KnownCamera* camera) {
  const Eigen::Map<const RowMatrix4> world_from_cam(pose);
  if (world_from_cam.row(3) != Eigen::RowVector4d(0, 0, 0, 1)) {
    throw InputError(where + ": the pose has another last row than 0 0 0 1.");
  }
  SetPoseFromWorldFromCam(world_from_cam.topRows<3>(), where, camera);
  SetIntrinsics(
      Eigen::Map<const RowMatrix3>(K), {}, pixel_offset, where, camera);
}

}  // namespace

Cameras ReadNpzRig(const std::string& path,
                   double pixel_offset,
                   RigRemarks* /*remarks*/) {
  const NpzFile file(path);
  const std::vector<std::string> names = file.At(kNames).texts;
  const size_t num_cameras = names.size();
  if (num_cameras == 0) file.Fail(kNames, "has no names");
  const std::vector<double> intrinsics =
      ReadNumbers(file, kIntrinsics, {num_cameras, 3, 3});
  const std::vector<double> poses =
      ReadNumbers(file, kPoses, {num_cameras, 4, 4});
  std::vector<double> sizes;
  if (file.Find(kSizes)) sizes = ReadNumbers(file, kSizes, {num_cameras, 2});
  Cameras cameras;
  for (size_t i = 0; i < num_cameras; ++i) {
    KnownCamera camera;
    camera.image_name = names[i];
    const std::string where = path + ": " + names[i];
    ReadCamera(
        &intrinsics[9 * i], &poses[16 * i], pixel_offset, where, &camera);
    if (!sizes.empty()) {
      const double width = sizes[2 * i];
      const double height = sizes[2 * i + 1];
      if (!(width >= 1 && width <= 1e6 && height >= 1 && height <= 1e6)) {
        throw InputError(where + ": image_sizes is not a size in pixels.");
      }
      camera.width = static_cast<size_t>(width);
      camera.height = static_cast<size_t>(height);
    }
    cameras.push_back(std::move(camera));
  }
  return cameras;
}

void WriteNpzRig(const std::string& path,
                 const Cameras& cameras,
                 double pixel_offset,
                 RigRemarks* remarks) {
  LensFitter fitter("npz", 0, /*has_fisheye=*/false);
  const size_t num_cameras = cameras.size();
  NumpyArray names{{num_cameras}, {}, {}};
  NumpyArray intrinsics{{num_cameras, 3, 3}, {}, {}};
  NumpyArray poses{{num_cameras, 4, 4}, {}, {}};
  NumpyArray sizes{{num_cameras, 2}, {}, {}};
  bool has_sizes = true;
  for (const KnownCamera& camera : cameras) {
    RequireIntrinsics("npz", camera);
    names.texts.push_back(WrittenImageName(camera));
    const RowMatrix3 K = fitter.Fit(camera).K(pixel_offset);
    intrinsics.numbers.insert(
        intrinsics.numbers.end(), K.data(), K.data() + K.size());
    RowMatrix4 pose = RowMatrix4::Identity();
    pose.topRows<3>() = WorldFromCamMatrix(camera);
    poses.numbers.insert(
        poses.numbers.end(), pose.data(), pose.data() + pose.size());
    sizes.numbers.push_back(static_cast<double>(camera.width));
    sizes.numbers.push_back(static_cast<double>(camera.height));
    has_sizes = has_sizes && camera.width > 0;
  }
  fitter.AddRemarks(remarks);
  std::vector<std::pair<std::string, NumpyArray>> arrays = {
      {kNames, names}, {kIntrinsics, intrinsics}, {kPoses, poses}};
  if (has_sizes) arrays.emplace_back(kSizes, sizes);
  WriteNpz(path, arrays);
}

}  // namespace mfir

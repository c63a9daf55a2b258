#include "colmap_ext/host/database.h"

#include "colmap_ext/host/v4/pose.h"
#include "src/util/errors.h"

namespace mfir::host {

std::shared_ptr<Database> OpenDatabase(const std::filesystem::path& path) {
  try {
    return Database::Open(path);
  } catch (const std::exception& error) {
    if (IsOutOfMemory(error)) throw std::bad_alloc();
    // COLMAP has said why in its log: no such folder, or a full disk.
    throw OutputError(path.string() +
                      ": cannot make the database: is the disk full?");
  }
}

std::pair<image_t, image_t> PairIdToImagePair(image_pair_t pair_id) {
  return colmap::PairIdToImagePair(pair_id);
}

FeatureDescriptors ReadDescriptors(const Database& database, image_t image_id) {
  return database.ReadDescriptors(image_id);
}

void WriteDescriptors(image_t image_id,
                      const FeatureDescriptors& descriptors,
                      Database* database) {
  database->WriteDescriptors(image_id, descriptors);
}

Image ReadImageWithName(const Database& database, const std::string& name) {
  return database.ReadImageWithName(name).value();
}

void WriteImageWithTrivialFrame(const Camera& camera,
                                const Image& image,
                                Database* database) {
  database->WriteCamera(camera, /*use_camera_id=*/true);
  colmap::Rig rig;
  rig.SetRigId(camera.camera_id);
  rig.AddRefSensor(camera.SensorId());
  database->WriteRig(rig, /*use_rig_id=*/true);
  database->WriteImage(image, /*use_image_id=*/true);
  colmap::Frame frame;
  frame.SetFrameId(image.ImageId());
  frame.SetRigId(rig.RigId());
  frame.AddDataId(image.DataId());
  database->WriteFrame(frame, /*use_frame_id=*/true);
}

std::vector<std::pair<image_pair_t, FeatureMatches>> ReadInlierMatches(
    const Database& database) {
  std::vector<std::pair<image_pair_t, FeatureMatches>> matches;
  for (auto& [pair_id, geometry] : database.ReadTwoViewGeometries()) {
    matches.emplace_back(pair_id, std::move(geometry.inlier_matches));
  }
  return matches;
}

std::vector<size_t> ReadNumInlierMatches(const Database& database) {
  std::vector<size_t> nums;
  for (const auto& [pair_id, num] : database.ReadTwoViewGeometryNumInliers()) {
    nums.push_back(static_cast<size_t>(num));
  }
  return nums;
}

void WriteCalibratedGeometry(image_t image_id1,
                             image_t image_id2,
                             const Eigen::Matrix3d& essential_matrix,
                             const Rigid3& cam2_from_cam1,
                             const FeatureMatches& inlier_matches,
                             Database* database) {
  colmap::TwoViewGeometry geometry;
  geometry.config = colmap::TwoViewGeometry::CALIBRATED;
  geometry.E = essential_matrix;
  geometry.cam2_from_cam1 = ToColmap(cam2_from_cam1);
  geometry.inlier_matches = inlier_matches;
  database->WriteTwoViewGeometry(image_id1, image_id2, geometry);
}

std::string RequiredImageColumns() { return "image_id, name, camera_id"; }

}  // namespace mfir::host

#include "colmap_ext/host/database.h"

#include <sqlite3.h>

#include <new>

#include "src/util/errors.h"

namespace mfir::host {

std::shared_ptr<Database> OpenDatabase(const std::filesystem::path& path) {
  // COLMAP ends the program where SQLite cannot open the file: the disk is
  // full, say, or the path has more than 512 bytes.
  sqlite3* database = nullptr;
  const int result = sqlite3_open_v2(path.c_str(),
                                     &database,
                                     SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE,
                                     nullptr);
  sqlite3_close(database);
  if (result == SQLITE_NOMEM) throw std::bad_alloc();
  if (result != SQLITE_OK) {
    throw OutputError(path.string() + ": cannot make the database: " +
                      sqlite3_errstr(result) + ".");
  }
  return std::make_shared<Database>(path.string());
}

std::pair<image_t, image_t> PairIdToImagePair(image_pair_t pair_id) {
  std::pair<image_t, image_t> ids;
  Database::PairIdToImagePair(pair_id, &ids.first, &ids.second);
  return ids;
}

FeatureDescriptors ReadDescriptors(const Database& database, image_t image_id) {
  return {database.ReadDescriptors(image_id)};
}

void WriteDescriptors(image_t image_id,
                      const FeatureDescriptors& descriptors,
                      Database* database) {
  database->WriteDescriptors(image_id, descriptors.data);
}

Image ReadImageWithName(const Database& database, const std::string& name) {
  return database.ReadImageWithName(name);
}

void WriteImageWithTrivialFrame(const Camera& camera,
                                const Image& image,
                                Database* database) {
  database->WriteCamera(camera, /*use_camera_id=*/true);
  database->WriteImage(image, /*use_image_id=*/true);
}

std::vector<std::pair<image_pair_t, FeatureMatches>> ReadInlierMatches(
    const Database& database) {
  std::vector<image_pair_t> pair_ids;
  std::vector<colmap::TwoViewGeometry> geometries;
  database.ReadTwoViewGeometries(&pair_ids, &geometries);
  std::vector<std::pair<image_pair_t, FeatureMatches>> matches;
  for (size_t i = 0; i < pair_ids.size(); ++i) {
    matches.emplace_back(pair_ids[i], std::move(geometries[i].inlier_matches));
  }
  return matches;
}

std::vector<size_t> ReadNumInlierMatches(const Database& database) {
  std::vector<std::pair<image_t, image_t>> image_pairs;
  std::vector<int> num_inliers;
  database.ReadTwoViewGeometryNumInliers(&image_pairs, &num_inliers);
  return {num_inliers.begin(), num_inliers.end()};
}

void WriteCalibratedGeometry(image_t image_id1,
                             image_t image_id2,
                             const Eigen::Matrix3d& essential_matrix,
                             const Rigid3& cam2_from_cam1,
                             const FeatureMatches& inlier_matches,
                             Database* database) {
  const Eigen::Quaterniond& q = cam2_from_cam1.rotation;
  colmap::TwoViewGeometry geometry;
  geometry.config = colmap::TwoViewGeometry::CALIBRATED;
  geometry.E = essential_matrix;
  geometry.qvec = Eigen::Vector4d(q.w(), q.x(), q.y(), q.z());
  geometry.tvec = cam2_from_cam1.translation;
  geometry.inlier_matches = inlier_matches;
  database->WriteTwoViewGeometry(image_id1, image_id2, geometry);
}

std::string RequiredImageColumns() {
  return "image_id, name, camera_id, prior_qw, prior_qx, prior_qy, prior_qz, "
         "prior_tx, prior_ty, prior_tz";
}

}  // namespace mfir::host

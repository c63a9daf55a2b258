// COLMAP's database: keypoints, descriptors, matches and two-view geometries
// of images.

#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <Eigen/Core>

#include "colmap_ext/host/feature.h"
#include "colmap_ext/host/reconstruction.h"
#include "src/geometry/rigid3.h"

#if MFIR_COLMAP_MAJOR >= 4
#include "colmap/scene/database.h"
#else
#include "base/database.h"
#endif

namespace mfir::host {

using colmap::Database;
using colmap::DatabaseTransaction;
using colmap::image_pair_t;

// Creates the file if there is none. Throws OutputError if that fails.
std::shared_ptr<Database> OpenDatabase(const std::filesystem::path& path);

std::pair<image_t, image_t> PairIdToImagePair(image_pair_t pair_id);

FeatureDescriptors ReadDescriptors(const Database& database, image_t image_id);
void WriteDescriptors(image_t image_id,
                      const FeatureDescriptors& descriptors,
                      Database* database);

// The image must exist.
Image ReadImageWithName(const Database& database, const std::string& name);

// Keeps the camera's and the image's ids.
void WriteImageWithTrivialFrame(const Camera& camera,
                                const Image& image,
                                Database* database);

// The matches which the geometries of all pairs agree with.
std::vector<std::pair<image_pair_t, FeatureMatches>> ReadInlierMatches(
    const Database& database);

// Their numbers, of the pairs that have some.
std::vector<size_t> ReadNumInlierMatches(const Database& database);

// Of two images whose cameras and poses are known.
void WriteCalibratedGeometry(image_t image_id1,
                             image_t image_id2,
                             const Eigen::Matrix3d& essential_matrix,
                             const Rigid3& cam2_from_cam1,
                             const FeatureMatches& inlier_matches,
                             Database* database);

// Columns of the tables of images and cameras without which this version
// cannot read a database.
std::string RequiredImageColumns();

}  // namespace mfir::host

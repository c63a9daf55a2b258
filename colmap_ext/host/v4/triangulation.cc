#include "colmap_ext/host/triangulation.h"

#include <memory>

#include "colmap/math/random.h"
#include "colmap/scene/database_cache.h"
#include "colmap/sfm/observation_manager.h"

namespace mfir::host {

// Without COLMAP's mapper: that takes rigs, frames and cameras of the database
// into the reconstruction, which has its own.
void TriangulateImages(const TriangulationOptions& options,
                       const Database& database,
                       const std::vector<image_t>& image_ids,
                       Reconstruction* reconstruction) {
  colmap::DatabaseCache::Options cache_options;
  cache_options.min_num_matches = options.min_num_matches;
  cache_options.ignore_watermarks = options.ignore_watermarks;
  // Also those without matches: all images get their keypoints.
  cache_options.load_all_images = true;
  for (const image_t image_id : image_ids) {
    cache_options.image_names.insert(reconstruction->Image(image_id).Name());
  }
  const auto cache = colmap::DatabaseCache::Create(database, cache_options);
  for (const image_t image_id : image_ids) {
    reconstruction->Image(image_id).SetPoints2D(
        cache->Image(image_id).Points2D());
  }
  const auto graph = cache->CorrespondenceGraph();
  const auto observations =
      std::make_shared<colmap::ObservationManager>(*reconstruction, graph);
  colmap::SetPRNGSeed(colmap::kDefaultPRNGSeed);
  colmap::IncrementalTriangulator triangulator(
      graph, *reconstruction, observations);
  for (const image_t image_id : image_ids) {
    triangulator.TriangulateImage(options.triangulator, image_id);
  }
  triangulator.CompleteAllTracks(options.triangulator);
  triangulator.MergeAllTracks(options.triangulator);
  observations->FilterAllPoints3D(options.filter_max_reproj_error,
                                  options.filter_min_tri_angle);
}

}  // namespace mfir::host

#include "colmap_ext/host/triangulation.h"

#include <memory>

#include "colmap/math/random.h"
#include "colmap/scene/database_cache.h"
#include "colmap/sfm/incremental_mapper.h"

namespace mfir::host {

void TriangulateImages(const TriangulationOptions& options,
                       const Database& database,
                       const std::vector<image_t>& image_ids,
                       Reconstruction* reconstruction) {
  colmap::DatabaseCache::Options cache_options;
  cache_options.min_num_matches = options.min_num_matches;
  cache_options.ignore_watermarks = options.ignore_watermarks;
  // The mapper looks up every image of the reconstruction.
  cache_options.load_all_images = true;
  for (const image_t image_id : image_ids) {
    cache_options.image_names.insert(reconstruction->Image(image_id).Name());
  }
  const auto cache = colmap::DatabaseCache::Create(database, cache_options);
  colmap::IncrementalMapper::Options mapper_options;
  mapper_options.filter_max_reproj_error = options.filter_max_reproj_error;
  mapper_options.filter_min_tri_angle = options.filter_min_tri_angle;
  colmap::SetPRNGSeed(0);
  colmap::IncrementalMapper mapper(cache);
  const auto shared = std::make_shared<Reconstruction>(*reconstruction);
  mapper.BeginReconstruction(shared);
  for (const image_t image_id : image_ids) {
    mapper.TriangulateImage(options.triangulator, image_id);
  }
  mapper.CompleteTracks(options.triangulator);
  mapper.MergeTracks(options.triangulator);
  mapper.FilterPoints(mapper_options);
  mapper.EndReconstruction(/*discard=*/false);
  *reconstruction = *shared;
}

}  // namespace mfir::host

#include "colmap_ext/host/triangulation.h"

#include <unordered_set>

#include "base/database_cache.h"
#include "sfm/incremental_mapper.h"
#include "util/random.h"

namespace mfir::host {

void TriangulateImages(const TriangulationOptions& options,
                       const Database& database,
                       const std::vector<image_t>& image_ids,
                       Reconstruction* reconstruction) {
  std::unordered_set<std::string> image_names;
  for (const image_t image_id : image_ids) {
    image_names.insert(reconstruction->Image(image_id).Name());
  }
  colmap::DatabaseCache cache;
  cache.Load(database,
             options.min_num_matches,
             options.ignore_watermarks,
             image_names);
  colmap::IncrementalMapper::Options mapper_options;
  mapper_options.filter_max_reproj_error = options.filter_max_reproj_error;
  mapper_options.filter_min_tri_angle = options.filter_min_tri_angle;
  colmap::SetPRNGSeed(colmap::kDefaultPRNGSeed);
  colmap::IncrementalMapper mapper(&cache);
  mapper.BeginReconstruction(reconstruction);
  for (const image_t image_id : image_ids) {
    // The cache drops images without matches.
    if (cache.ExistsImage(image_id)) {
      mapper.TriangulateImage(options.triangulator, image_id);
    }
  }
  mapper.CompleteTracks(options.triangulator);
  mapper.MergeTracks(options.triangulator);
  mapper.FilterPoints(mapper_options);
  mapper.EndReconstruction(/*discard=*/false);
}

}  // namespace mfir::host

// What the refiner writes (docs/formats.md).

#pragma once

#include <string>
#include <vector>

#include "colmap_ext/io/output_folder.h"
#include "colmap_ext/options/option_parser.h"
#include "colmap_ext/refinement/refiner_result.h"
#include "colmap_ext/refinement/refiner_solves.h"
#include "colmap_ext/result/limits.h"
#include "colmap_ext/result/run_summary.h"
#include "src/refinement/stage.h"
#include "src/scene/scene.h"

namespace mfir {

// The files and folders of a result, as OutputFolder takes them.
const std::vector<std::string>& ResultNames();

// Throws SolverError, naming what, if a number of the result is not finite: no
// model of the frames and the rig and no rms may be written then.
void CheckFinite(const Scene& scene, const RefinerResult& result);

struct WrittenResult {
  std::string path;                  // see OutputFolder::Publish
  std::vector<std::string> remarks;  // what rig formats cannot hold
  std::vector<LimitViolation> violations;
};

// Writes all files to the temporary folder of `output` and publishes them when
// all are complete. Over ranks each writes its frames, the first all else and
// no model of all frames. Throws OutputError, and what CheckFinite throws.
WrittenResult WriteResult(const OptionParser& options,
                          const Tracks& tracks,
                          const RefinerResult& result,
                          const RunReport& report,
                          OutputFolder* output);

}  // namespace mfir

// What the refiner writes (README.md, "Output").

#pragma once

#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "colmap_ext/frames/frames.h"
#include "colmap_ext/io/output_folder.h"
#include "colmap_ext/options/option_parser.h"
#include "src/evaluation/drift_check.h"
#include "src/evaluation/evaluation.h"
#include "src/refinement/refinement.h"
#include "src/refinement/stage.h"
#include "src/refinement/static_points.h"
#include "src/scene/scene.h"

namespace mfir {

// Everything a run has found out.
struct RefinerResult {
  const Capture* capture = nullptr;
  const Scene* scene = nullptr;
  // By camera: refined intrinsics and, with soft extrinsics, corrected poses,
  // in the coordinates of RIG.
  std::vector<KnownCamera> cameras;
  bool soft_extrinsics = false;
  std::vector<std::vector<double>> initial_params;  // by camera
  // By camera: changes since initial_params, and since the intrinsics of RIG.
  std::vector<std::optional<CameraDrift>> drifts;
  std::vector<std::optional<CameraDrift>> drifts_from_rig;
  std::vector<PoseDisagreement> pose_disagreements;
  // By camera: whether tracks that it sees took part in the refinement.
  std::vector<bool> took_part;
  std::vector<double> rms_px_before;  // see RmsByCamera
  std::vector<double> rms_px_after;
  const StaticPoints* static_points = nullptr;
  double held_out_rms_px = 0.0;  // NaN: no tracks were held out
  RefinementResult refinement;
  // "converged", "not_converged" or "contradicting_extrinsics".
  std::string status;
  std::vector<Stage> stages;
  std::vector<std::pair<std::string, double>> timings_s;
  nlohmann::ordered_json inputs;
  nlohmann::ordered_json evaluation;  // null without a ground truth
};

// The files and folders of a result, as OutputFolder takes them.
const std::vector<std::string>& ResultNames();

// Throws SolverError, naming what, if a number of the result is not finite: no
// model of the frames and the rig and no rms may be written then.
void CheckFinite(const RefinerResult& result);

nlohmann::ordered_json MakeSummary(const OptionParser& options,
                                   const RefinerResult& result);

struct WrittenResult {
  std::string path;                  // see OutputFolder::Publish
  std::vector<std::string> remarks;  // what KRT cannot express
};

// Writes all files to the temporary folder of `output` and publishes them when
// all are complete. Throws OutputError, and what CheckFinite throws.
WrittenResult WriteResult(const OptionParser& options,
                          const RefinerResult& result,
                          OutputFolder* output);

}  // namespace mfir

// summary.json (docs/formats.md, docs/summary.schema.json).

#pragma once

#include <string>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>

#include "colmap_ext/options/option_parser.h"
#include "colmap_ext/refinement/refiner_result.h"
#include "colmap_ext/refinement/refiner_solves.h"
#include "colmap_ext/result/limits.h"
#include "src/refinement/stage.h"

namespace mfir {

// Of the run, not of the cameras.
struct RunReport {
  std::vector<Stage> stages;
  std::vector<std::pair<std::string, double>> timings_s;
  nlohmann::ordered_json inputs;
  nlohmann::ordered_json evaluation;      // null without a ground truth
  std::string image_path;                 // empty: none
  std::vector<std::string> output_types;  // names of RigFormats
  Limits limits;
  bool write_page = true;  // report.html
  int num_threads = 1;
};

// What all ranks know together.
struct Totals {
  nlohmann::ordered_json frames = nlohmann::ordered_json::array();
  // By camera.
  std::vector<size_t> num_frames;
  std::vector<size_t> num_observations;
  std::vector<size_t> peak_rss_bytes;  // by rank
};

// Of the tracks of this rank and of all others.
Totals AddUp(const Tracks& tracks);

// The refined intrinsics with the extrinsics as they were given.
std::vector<KnownCamera> GivenCameras(const Capture& capture,
                                      const RefinerResult& result);

nlohmann::ordered_json MakeSummary(const OptionParser& options,
                                   const Tracks& tracks,
                                   const RefinerResult& result,
                                   const RunReport& report,
                                   const Totals& totals);

}  // namespace mfir

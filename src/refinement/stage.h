// Record of one solve: what the log, summary.json and history.csv show.

#pragma once

#include <functional>
#include <string>
#include <utility>
#include <vector>

namespace mfir {

struct Stage {
  int index = 0;
  // "schedule", "principal_points", "start" or
  // "final", see README.
  std::string name;
  // Weight and cost of each term that takes part, by the names of the options
  // and of summary.json.
  std::vector<std::pair<std::string, double>> weights;
  std::vector<std::pair<std::string, double>> costs;
  int num_iterations = 0;
  double time_s = 0.0;
  // "converged", "max_num_iterations" or "failed".
  std::string termination;
  // Without outliers, see InlierRms.
  double rms_px = 0.0;
};

using StageCallback = std::function<void(const Stage&)>;

}  // namespace mfir

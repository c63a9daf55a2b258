#include "colmap_ext/refinement/refiner_progress.h"

#include <algorithm>
#include <iostream>

#include "colmap_ext/host/log.h"
#include "colmap_ext/host/util.h"

namespace mfir {

void Progress::Heading(const std::string& name) {
  EndTiming();
  name_ = name;
  start_ = std::chrono::steady_clock::now();
  if (!options_.quiet) host::PrintHeading1(name);
}

void Progress::Log(const std::string& line) const {
  if (!options_.quiet) std::cout << line << std::endl;
}

StageCallback Progress::RecordStages() {
  return [this](const Stage& stage) {
    stages_.push_back(stage);
    stages_.back().index = static_cast<int>(stages_.size()) - 1;
    double cost = 0.0;
    for (const auto& name_and_cost : stage.costs) {
      cost += name_and_cost.second;
    }
    std::string prior;
    for (const auto& name_and_weight : stage.weights) {
      if (name_and_weight.first == "rotation_prior") {
        prior = host::StringPrintf(", prior weight %g of %g",
                                   name_and_weight.second,
                                   options_.max_prior_weight);
      }
    }
    const int num_schedule = options_.NumScheduleSolves();
    const std::string number =
        stage.name == "schedule"
            ? host::StringPrintf("%zu / %d", stages_.size(), num_schedule)
            : std::to_string(stages_.size());
    Log(host::StringPrintf(
        "Solve %s (%s%s): cost %.6g, rms %.3f px, %d iterations, %.1f s, %s",
        number.c_str(),
        stage.name.c_str(),
        prior.c_str(),
        cost,
        stage.rms_px,
        stage.num_iterations,
        stage.time_s,
        stage.termination.c_str()));
  };
}

std::vector<std::pair<std::string, double>> Progress::Timings() {
  EndTiming();
  double total = 0.0;
  for (const auto& timing : timings_) total += timing.second;
  std::vector<std::pair<std::string, double>> timings = timings_;
  timings.emplace_back("total", total);
  return timings;
}

void Progress::EndTiming() {
  if (!name_.empty()) {
    const std::chrono::duration<double> duration =
        std::chrono::steady_clock::now() - start_;
    const auto earlier =
        std::find_if(timings_.begin(), timings_.end(), [this](const auto& it) {
          return it.first == name_;
        });
    if (earlier == timings_.end()) {
      timings_.emplace_back(name_, duration.count());
    } else {
      earlier->second += duration.count();
    }
  }
  name_.clear();
}

}  // namespace mfir

// Progress of the command multi_frame_intrinsics_refiner.

#pragma once

#include <chrono>
#include <string>
#include <utility>
#include <vector>

#include "src/refinement/options.h"
#include "src/refinement/stage.h"

namespace mfir {

// Measures and logs the stages of the pipeline.
class Progress {
 public:
  // `options` must outlive this.
  explicit Progress(const MultiFrameOptions& options) : options_(options) {}

  // Begins a stage, or goes on with it.
  void Heading(const std::string& name);
  void Log(const std::string& line) const;
  // Keeps the solves and logs a line each. This must outlive the callback.
  StageCallback RecordStages();
  const std::vector<Stage>& Stages() const { return stages_; }
  // Of the stages so far, and their sum as "total".
  std::vector<std::pair<std::string, double>> Timings();

 private:
  void EndTiming();

  const MultiFrameOptions& options_;
  std::string name_;
  std::chrono::steady_clock::time_point start_;
  std::vector<std::pair<std::string, double>> timings_;
  std::vector<Stage> stages_;
};

}  // namespace mfir

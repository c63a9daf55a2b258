// COLMAP's bundle adjustment over all frames at once, with the refiner's terms
// in the same problem.

#pragma once

#include "colmap_ext/frames/frames.h"
#include "colmap_ext/host/bundle_adjustment.h"
#include "src/refinement/options.h"
#include "src/refinement/progressive_schedule.h"
#include "src/scene/estimate.h"
#include "src/scene/scene.h"

namespace mfir {

// Reprojection residuals and what is held constant are COLMAP's; loss, priors
// and solves are ProgressiveSchedule's.
class MultiFrameBundleAdjuster {
 public:
  explicit MultiFrameBundleAdjuster(const MultiFrameOptions& options);

  // Refines poses, points and intrinsics of the frames, and the intrinsics of
  // the rig's cameras. `scene` must be the capture's. Throws SolverError.
  Estimate Run(const StageCallback& callback,
               const Capture& capture,
               const Scene& scene,
               Estimate start);

 private:
  void AddFrame(const Frame& scene_frame,
                const FrameModel& frame,
                host::Reconstruction* reconstruction,
                ProgressiveSchedule* schedule);
  void AddFeaturemetric(const Frame& scene_frame,
                        const std::vector<ImageBlocks>& images,
                        host::Reconstruction* reconstruction,
                        ProgressiveSchedule* schedule);

  const MultiFrameOptions options_;
  host::BundleAdjuster adjuster_;
};

}  // namespace mfir

// COLMAP's bundle adjustment over all frames at once, with the refiner's terms
// in the same problem.

#pragma once

#include "colmap_ext/frames/frames.h"
#include "colmap_ext/host/compat.h"
#include "src/refinement/options.h"
#include "src/refinement/progressive_schedule.h"
#include "src/scene/estimate.h"
#include "src/scene/scene.h"

namespace mfir {

// Reuses COLMAP's reprojection blocks, parameterizations and options as they
// are (its SetUp functions are protected in the patched COLMAP); loss, priors
// and solves are ProgressiveSchedule's.
class MultiFrameBundleAdjuster : public colmap::BundleAdjuster {
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
                colmap::Reconstruction* reconstruction,
                ProgressiveSchedule* schedule);
  void AddFeaturemetric(const Frame& scene_frame,
                        const std::vector<ImageBlocks>& images,
                        colmap::Reconstruction* reconstruction,
                        ProgressiveSchedule* schedule);

  const MultiFrameOptions multi_frame_options_;
};

}  // namespace mfir

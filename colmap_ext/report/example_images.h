// Images with keypoints and projections, for the report.

#pragma once

#include <string>

#include "colmap_ext/host/reconstruction.h"
#include "src/report/report.h"

namespace mfir {

// Adds the worst, the median and the best camera (by rms) of a frame that has
// an image in inputs.image_path of the summary; without any,
// report->examples_remark says why. An image that cannot be read is left out.
void AddExamples(const std::string& frame_name,
                 const host::Reconstruction& frame,
                 Report* report);

}  // namespace mfir

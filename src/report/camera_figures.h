// Pictures of one camera. Scales are shared by all cameras, so that their
// pictures compare.

#pragma once

#include <string>

#include "src/report/report.h"

namespace mfir {

// What the pictures of all cameras have in common.
struct FigureScales {
  double residual_factor = 1.0;      // arrows of residuals are longer by this
  double displacement_factor = 1.0;  // the same for displacements
  double max_std = 1.0;              // px, upper end of the colours
  double max_coverage = 1.0;         // inliers per cell, upper end
};

// The reference that displacements are since: the last earlier result, else the
// start.
const Comparison& MainReference(const Report& report);

// Whether `comparison` knows the camera.
bool Knows(const Comparison& comparison, size_t camera_idx);

FigureScales MakeFigureScales(const Report& report);

// With captions. Empty where there is nothing to show.
std::string ResidualFigure(const Report& report,
                           const FigureScales& scales,
                           size_t camera_idx);
std::string CoverageFigure(const Report& report,
                           const FigureScales& scales,
                           size_t camera_idx);
std::string UncertaintyFigure(const Report& report,
                              const FigureScales& scales,
                              size_t camera_idx);
std::string DisplacementFigure(const Report& report,
                               const FigureScales& scales,
                               size_t camera_idx);
std::string DistortionFigure(const Report& report, size_t camera_idx);

// Focal length over the results, with two standard deviations; empty for fewer
// than two earlier ones.
std::string HistoryFigure(const Report& report, size_t camera_idx);

// The arrows of DisplacementFigure alone.
std::string DisplacementSvg(const Report& report,
                            const FigureScales& scales,
                            size_t camera_idx);

}  // namespace mfir

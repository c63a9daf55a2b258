// What is reported of observations and their residuals, those of all ranks.

#pragma once

#include <vector>

#include "src/parallel/communicator.h"
#include "src/scene/scene.h"

namespace mfir {

// The rule for outliers in everything that is reported: residual norm above 4
// sigma, where sigma = sqrt(median / (2 ln 2)) is the standard deviation of
// Gaussian noise with the same median of squared norms.
double MaxInlierSquaredResidual(const std::vector<double>& squared_residuals,
                                const Communicator& ranks = Alone(),
                                int num_threads = 1);

// Root mean square (px) of the residual norms without outliers; NaN without
// residuals.
double InlierRms(const std::vector<double>& squared_residuals,
                 const Communicator& ranks = Alone(),
                 int num_threads = 1);

// Root mean square (px) of the selected residual norms: one value per rig
// camera, then the one over all; NaN without observations.
std::vector<double> RmsByCamera(const Scene& scene,
                                const std::vector<double>& squared_residuals,
                                const std::vector<bool>& selected);

// Observations of each camera.
std::vector<size_t> NumObservationsByCamera(const Scene& scene);

}  // namespace mfir

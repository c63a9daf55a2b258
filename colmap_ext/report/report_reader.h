// Results of the refiner as the values of a report.

#pragma once

#include <string>
#include <vector>

#include "src/report/report.h"

namespace mfir {

// Reads the result in the folder `path`: summary.json, history.csv, the model
// rig, the models in frames one after another, and, where inputs.image_path of
// the summary still is a folder, three example images. `shown_path` is what the
// report calls the folder. `compare_paths` are earlier results of the same
// cameras (by name), in the order of their time if all have one.
//
// Throws InputError, naming file and field, for what is no result of the
// refiner or does not belong together.
Report ReadReport(const std::string& path,
                  const std::string& shown_path,
                  const std::vector<std::string>& compare_paths);

}  // namespace mfir

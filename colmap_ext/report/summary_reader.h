// summary.json as values.

#pragma once

#include <string>

#include <nlohmann/json.hpp>

#include "src/report/report.h"

namespace mfir {

// Reads PATH/summary.json. Throws InputError if there is none, or if it is not
// one of this schema.
nlohmann::ordered_json ReadSummary(const std::string& path);

// The cameras of a summary, without poses and observations. Throws InputError,
// naming `path` and the field.
std::vector<ReportCamera> ReadCameras(const std::string& path,
                                      const nlohmann::ordered_json& summary);

// What the cameras have changed since, by what the summary has of the start
// ("params_initial") and of RIG.
Comparison CompareWithStart(const Report& report);
Comparison CompareWithRig(const Report& report);

// The same since the result in the folder `path`. Throws as ReadSummary and
// ReadCameras.
Comparison CompareWithResult(const Report& report, const std::string& path);

}  // namespace mfir

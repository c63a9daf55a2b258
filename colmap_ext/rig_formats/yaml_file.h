// YAML, read by yaml-cpp.

#pragma once

#include <string>

#include <yaml-cpp/yaml.h>

namespace mfir {

// The root of the file's first document. Bears OpenCV's directive %YAML:1.0
// and tabs at the end of a line, which are not YAML. Throws InputError, with
// the line.
YAML::Node ReadYamlFile(const std::string& path);

}  // namespace mfir

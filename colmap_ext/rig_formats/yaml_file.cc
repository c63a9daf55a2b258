#include "colmap_ext/rig_formats/yaml_file.h"

#include <sstream>

#include "colmap_ext/io/input_file.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

std::string WithoutTrailingBlanks(const std::string& text) {
  std::istringstream lines(text);
  std::string result;
  for (std::string line; std::getline(lines, line);) {
    line.erase(line.find_last_not_of(" \t\r") + 1);
    result += line + "\n";
  }
  return result;
}

}  // namespace

YAML::Node ReadYamlFile(const std::string& path) {
  std::string text = WithoutTrailingBlanks(ReadTextFile(path));
  // A comment, so that lines keep their numbers.
  if (text.rfind("%YAML:", 0) == 0) text[0] = '#';
  try {
    return YAML::Load(text);
  } catch (const YAML::Exception& error) {
    throw InputError(path + ":" + std::to_string(error.mark.line + 1) +
                     ": not valid YAML: " + error.msg +
                     ". Correct the line, or export the file again.");
  }
}

}  // namespace mfir

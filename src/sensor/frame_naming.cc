#include "src/sensor/frame_naming.h"

#include <algorithm>
#include <functional>

#include "src/sensor/camera_naming.h"
#include "src/sensor/image_name.h"

namespace mfir {
namespace {

constexpr char kOption[] = "frame_name_regex";
const char* const kPaperFrameRegex = R"(camera\d+_frame(\d+))";

using Names = std::vector<std::string>;
using Rule = std::function<std::string(const std::string&)>;

// What cannot lead out of a folder.
std::string FolderName(std::string name) {
  for (char& c : name) {
    if (c == '/' || c == '\\' || c == '\0') c = '_';
  }
  const bool is_dots =
      !name.empty() && name.find_first_not_of('.') == std::string::npos;
  return is_dots ? "_" + name : name;
}

Names Apply(const Rule& rule, const Names& image_names) {
  Names names;
  for (const std::string& image_name : image_names) {
    names.push_back(FolderName(rule(image_name)));
  }
  return names;
}

Rule RegexRule(const std::string& pattern) {
  return [regex = NameRegex(kOption, pattern)](const std::string& image_name) {
    return regex.Captured(image_name);
  };
}

bool AllFramesNamed(const Names& names) {
  return std::find(names.begin(), names.end(), "") == names.end();
}

bool AreCameras(const Rule& rule,
                const Names& image_names,
                const std::set<std::string>& camera_names) {
  return std::all_of(
      image_names.begin(),
      image_names.end(),
      [&](const std::string& image_name) {
        return camera_names.count(CanonicalCameraName(rule(image_name))) > 0;
      });
}

}  // namespace

std::vector<std::string> FrameNames(const std::vector<std::string>& image_names,
                                    const std::set<std::string>& camera_names,
                                    const std::string& regex) {
  if (!regex.empty()) return Apply(RegexRule(regex), image_names);
  std::vector<Rule> rules = {FirstFolder, RegexRule(kPaperFrameRegex)};
  if (AreCameras(FirstFolder, image_names, camera_names) &&
      !AreCameras(FileStem, image_names, camera_names)) {
    rules.insert(rules.begin(), PathInFirstFolder);
  }
  for (const Rule& rule : rules) {
    Names names = Apply(rule, image_names);
    if (AllFramesNamed(names)) return names;
  }
  return Names(image_names.size(), "frame");
}

std::vector<std::string> NamesOfFrames(
    const std::vector<std::vector<std::string>>& image_names_of_frames) {
  const auto apply = [&](const Rule& rule) {
    Names names;  // of the frames; "" where the images do not agree
    for (const Names& image_names : image_names_of_frames) {
      const std::set<std::string> shared = [&] {
        const Names all = Apply(rule, image_names);
        return std::set<std::string>(all.begin(), all.end());
      }();
      names.push_back(shared.size() == 1 ? *shared.begin() : "");
    }
    return names;
  };
  for (const Rule& rule : {Rule(FirstFolder),
                           Rule(PathInFirstFolder),
                           RegexRule(kPaperFrameRegex)}) {
    Names names = apply(rule);
    if (AllFramesNamed(names) &&
        std::set<std::string>(names.begin(), names.end()).size() ==
            names.size()) {
      return names;
    }
  }
  Names names;
  for (size_t i = 0; i < image_names_of_frames.size(); ++i) {
    names.push_back("frame" + std::to_string(i + 1));
  }
  return names;
}

}  // namespace mfir

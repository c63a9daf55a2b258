#include "src/sensor/camera_naming.h"

#include <algorithm>
#include <set>

#include "src/sensor/image_name.h"

namespace mfir {
namespace {

constexpr const char* kRegexOption = "camera_name_regex";
const char* const kPaperCameraRegex = R"(camera(\d+)_frame\d+)";
bool IsNumber(const std::string& name) {
  return !name.empty() && std::all_of(name.begin(), name.end(), [](char c) {
    return c >= '0' && c <= '9';
  });
}

template <typename Rule>
std::vector<std::string> Apply(const Rule& rule,
                               const std::vector<std::string>& image_names) {
  std::vector<std::string> names;
  names.reserve(image_names.size());
  for (const std::string& image_name : image_names) {
    names.push_back(CanonicalCameraName(rule(image_name)));
  }
  return names;
}

bool AllCamerasNamed(const std::vector<std::string>& names) {
  return std::find(names.begin(), names.end(), "") == names.end();
}

bool AllDiffer(const std::vector<std::string>& names) {
  return std::set<std::string>(names.begin(), names.end()).size() ==
         names.size();
}

}  // namespace

CameraNaming::CameraNaming(const std::string& regex) : regex_(regex) {
  if (!regex.empty()) NameRegex(kRegexOption, regex);
}

std::vector<std::string> CameraNaming::Names(
    const std::vector<std::string>& image_names) const {
  const auto regex_rule = [](const std::string& pattern) {
    return [regex = NameRegex(kRegexOption, pattern)](
               const std::string& image_name) {
      return regex.Captured(image_name);
    };
  };
  if (!regex_.empty()) {
    return Apply(regex_rule(regex_), image_names);
  }

  std::vector<std::string> fallback;
  for (std::vector<std::string> names :
       {Apply(regex_rule(kPaperCameraRegex), image_names),
        Apply(
            [this](const std::string& image_name) {
              return WithoutName(FileStem(image_name), frame_name_);
            },
            image_names),
        Apply(FileStem, image_names),
        Apply(FirstFolder, image_names)}) {
    if (!AllCamerasNamed(names)) {
      continue;
    }
    if (AllDiffer(names)) {
      return names;
    }
    if (fallback.empty()) {
      fallback = std::move(names);
    }
  }
  // Only names without any stem, such as "", fit no rule.
  return fallback.empty() ? Apply(FileStem, image_names) : fallback;
}

CameraNaming CameraNaming::OfFrame(const std::string& frame_name) const {
  CameraNaming naming = *this;
  naming.frame_name_ = frame_name;
  return naming;
}

std::string CameraNaming::CameraName(const std::string& name) const {
  const std::string captured =
      regex_.empty() ? "" : NameRegex(kRegexOption, regex_).Captured(name);
  return CanonicalCameraName(captured.empty() ? name : captured);
}

std::string CanonicalCameraName(const std::string& name) {
  if (!IsNumber(name)) {
    return name;
  }
  return name.substr(std::min(name.find_first_not_of('0'), name.size() - 1));
}

bool CameraNameLess(const std::string& a, const std::string& b) {
  const bool is_number = IsNumber(a);
  if (is_number != IsNumber(b)) {
    return is_number;
  }
  if (!is_number) {
    return a < b;
  }
  const std::string canonical_a = CanonicalCameraName(a);
  const std::string canonical_b = CanonicalCameraName(b);
  return canonical_a.size() != canonical_b.size()
             ? canonical_a.size() < canonical_b.size()
             : canonical_a < canonical_b;
}

std::string WithoutName(const std::string& text, const std::string& name) {
  const std::string separators = "_-.";
  if (name.empty() || text.size() < name.size() + 2) return "";
  const size_t num_rest = text.size() - name.size() - 1;
  if (text.compare(0, name.size(), name) == 0 &&
      separators.find(text[name.size()]) != std::string::npos) {
    return text.substr(name.size() + 1);
  }
  if (text.compare(num_rest + 1, name.size(), name) == 0 &&
      separators.find(text[num_rest]) != std::string::npos) {
    return text.substr(0, num_rest);
  }
  return "";
}

}  // namespace mfir

#include "src/sensor/camera_naming.h"

#include <algorithm>
#include <set>
#include <stdexcept>

#include <boost/regex.hpp>

#include "src/util/errors.h"

namespace mfir {
namespace {

const char* const kPaperRegex = R"(camera(\d+)_frame\d+)";
constexpr size_t kMaxShownLength = 100;
const char* const kSeparators = "/\\";

bool IsNumber(const std::string& name) {
  return !name.empty() && std::all_of(name.begin(), name.end(), [](char c) {
    return c >= '0' && c <= '9';
  });
}

// The text of the regex's group, "" if it does not match. Boost gives up where
// std::regex runs for ever (nested repeats) or overflows the stack (long
// names). Throws UsageError then.
std::string Captured(const std::string& text,
                     const boost::regex& regex,
                     const std::string& option = "camera_name_regex") {
  try {
    boost::smatch match;
    return boost::regex_search(text, match, regex) ? match[1].str() : "";
  } catch (const std::runtime_error&) {
    throw UsageError(option + " '" + regex.str() +
                     "' is too complex to match the image name '" +
                     text.substr(0, kMaxShownLength) +
                     "'. Avoid repeats of repeats, such as (?:a+)+.");
  }
}

void CheckRegex(const std::string& option, const std::string& regex) {
  unsigned num_groups = 0;
  try {
    num_groups = boost::regex(regex).mark_count();
  } catch (const std::runtime_error& error) {
    throw UsageError(option + " '" + regex +
                     "' is not a valid regular expression (" + error.what() +
                     "). Use Perl syntax, e.g. 'camera(\\d+)_'.");
  }
  if (num_groups != 1) {
    throw UsageError(option + " '" + regex + "' has " +
                     std::to_string(num_groups) +
                     " capture groups. Give exactly one, around the " +
                     (option == "camera_name_regex" ? "camera" : "frame") +
                     " name, and write other groups as (?:...).");
  }
}

// "cam07/a/000123.jpg" -> "cam07", "" if there is no folder.
std::string FirstFolder(const std::string& image_name) {
  const size_t begin = image_name.find_first_not_of(kSeparators);
  if (begin == std::string::npos) {
    return "";
  }
  const size_t end = image_name.find_first_of(kSeparators, begin);
  return end == std::string::npos ? "" : image_name.substr(begin, end - begin);
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

bool AllNamed(const std::vector<std::string>& names) {
  return std::find(names.begin(), names.end(), "") == names.end();
}

bool AllDiffer(const std::vector<std::string>& names) {
  return std::set<std::string>(names.begin(), names.end()).size() ==
         names.size();
}

}  // namespace

CameraNaming::CameraNaming(const std::string& regex) : regex_(regex) {
  if (!regex.empty()) CheckRegex("camera_name_regex", regex);
}

std::vector<std::string> CameraNaming::Names(
    const std::vector<std::string>& image_names) const {
  const auto regex_rule = [](const std::string& pattern) {
    return [regex = boost::regex(pattern)](const std::string& image_name) {
      return Captured(image_name, regex);
    };
  };
  if (!regex_.empty()) {
    return Apply(regex_rule(regex_), image_names);
  }

  std::vector<std::string> fallback;
  for (std::vector<std::string> names :
       {Apply(regex_rule(kPaperRegex), image_names),
        Apply(
            [this](const std::string& image_name) {
              return WithoutName(ImageStem(image_name), frame_name_);
            },
            image_names),
        Apply(ImageStem, image_names),
        Apply(FirstFolder, image_names)}) {
    if (!AllNamed(names)) {
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
  return fallback.empty() ? Apply(ImageStem, image_names) : fallback;
}

CameraNaming CameraNaming::OfFrame(const std::string& frame_name) const {
  CameraNaming naming = *this;
  naming.frame_name_ = frame_name;
  return naming;
}

std::string CameraNaming::CameraName(const std::string& name) const {
  const std::string captured =
      regex_.empty() ? "" : Captured(name, boost::regex(regex_));
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

std::string ImageStem(const std::string& image_name) {
  const size_t separator = image_name.find_last_of(kSeparators);
  const std::string file_name = separator == std::string::npos
                                    ? image_name
                                    : image_name.substr(separator + 1);
  const size_t dot = file_name.rfind('.');
  return dot == std::string::npos || dot == 0 ? file_name
                                              : file_name.substr(0, dot);
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

std::string CapturedText(const std::string& option,
                         const std::string& regex,
                         const std::string& text) {
  CheckRegex(option, regex);
  return Captured(text, boost::regex(regex), option);
}

}  // namespace mfir

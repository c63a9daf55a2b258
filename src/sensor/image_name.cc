#include "src/sensor/image_name.h"

#include <stdexcept>

#include "src/util/errors.h"

namespace mfir {
namespace {

constexpr size_t kMaxShownLength = 100;
const char* const kSeparators = "/\\";

std::string WithoutExtension(const std::string& path) {
  const size_t separator = path.find_last_of(kSeparators);
  const size_t name_begin = separator == std::string::npos ? 0 : separator + 1;
  const size_t dot = path.rfind('.');
  // ".cam09" has no extension.
  return dot == std::string::npos || dot <= name_begin ? path
                                                       : path.substr(0, dot);
}

boost::regex Compiled(const std::string& option, const std::string& pattern) {
  try {
    return boost::regex(pattern);
  } catch (const std::runtime_error& error) {
    throw UsageError(option + " '" + pattern +
                     "' is not a valid regular expression (" + error.what() +
                     "). Use Perl syntax, e.g. 'camera(\\d+)_'.");
  }
}

}  // namespace

std::string FileStem(const std::string& image_name) {
  const size_t separator = image_name.find_last_of(kSeparators);
  return WithoutExtension(separator == std::string::npos
                              ? image_name
                              : image_name.substr(separator + 1));
}

std::string FirstFolder(const std::string& image_name) {
  const size_t begin = image_name.find_first_not_of(kSeparators);
  if (begin == std::string::npos) {
    return "";
  }
  const size_t end = image_name.find_first_of(kSeparators, begin);
  return end == std::string::npos ? "" : image_name.substr(begin, end - begin);
}

std::string PathInFirstFolder(const std::string& image_name) {
  const std::string folder = FirstFolder(image_name);
  if (folder.empty()) return "";
  const size_t begin = image_name.find_first_not_of(
      kSeparators, image_name.find(folder) + folder.size());
  return begin == std::string::npos
             ? ""
             : WithoutExtension(image_name.substr(begin));
}

NameRegex::NameRegex(const std::string& option, const std::string& pattern)
    : option_(option), regex_(Compiled(option, pattern)) {
  if (regex_.mark_count() != 1) {
    throw UsageError(option + " '" + pattern + "' has " +
                     std::to_string(regex_.mark_count()) +
                     " capture groups. Give exactly one, around the name, and "
                     "write other groups as (?:...).");
  }
}

// Boost gives up where std::regex runs for ever (nested repeats) or overflows
// the stack (long names).
std::string NameRegex::Captured(const std::string& image_name) const {
  try {
    boost::smatch match;
    return boost::regex_search(image_name, match, regex_) ? match[1].str() : "";
  } catch (const std::runtime_error&) {
    throw UsageError(option_ + " '" + regex_.str() +
                     "' is too complex to match the image name '" +
                     image_name.substr(0, kMaxShownLength) +
                     "'. Avoid repeats of repeats, such as (?:a+)+.");
  }
}

}  // namespace mfir

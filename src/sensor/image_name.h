// Parts of image names, "FOLDER/.../FILE.EXT" relative to the folder of images.

#pragma once

#include <string>

#include <boost/regex.hpp>

namespace mfir {

// "a/cam07.png" -> "cam07".
std::string FileStem(const std::string& image_name);

// "cam07/a/000123.jpg" -> "cam07", "" if there is no folder.
std::string FirstFolder(const std::string& image_name);

// "cam07/a/000123.jpg" -> "a/000123", "" if there is no folder.
std::string PathInFirstFolder(const std::string& image_name);

// A regular expression (Perl syntax) with one capture group, searched in image
// names: the value of an option.
class NameRegex {
 public:
  // Throws UsageError, naming the option, when `pattern` is not valid or has
  // not exactly one group.
  NameRegex(const std::string& option, const std::string& pattern);

  // The text of the group, "" if the name does not match. Throws UsageError if
  // the expression is too complex to match the name.
  std::string Captured(const std::string& image_name) const;

 private:
  std::string option_;
  boost::regex regex_;
};

}  // namespace mfir

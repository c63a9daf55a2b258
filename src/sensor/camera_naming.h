// From image names to physical cameras.

#pragma once

#include <string>
#include <vector>

namespace mfir {

// Rule that extracts a camera name from an image name.
//
// With a regular expression (one capture group, searched in the image name):
// the captured text. Without one, the first rule below whose result differs for
// all given names of one frame (all images of a frame belong to different
// cameras); if none does, the first that applies to all of them, so that the
// caller finds the duplicates:
//   1. the paper's "camera(\d+)_frame\d+",
//   2. the file stem without the name of the frame, where that is known
//      ("cam07_000123.jpg" of the frame 000123 -> "cam07"),
//   3. the file stem ("cam07.png" -> "cam07"),
//   4. the first folder ("cam07/000123.jpg" -> "cam07").
// Names that are numbers compare as numbers: results are canonical, "000012"
// and "12" both give "12".
class CameraNaming {
 public:
  // An empty `regex` selects the default rules. Throws UsageError when it is
  // not a valid regular expression (Perl syntax) or has not exactly one group.
  explicit CameraNaming(const std::string& regex = "");

  // Camera names for the image names of one frame (or of RIG), in order. An
  // image the regex does not match gets "" (the caller reports it).
  std::vector<std::string> Names(
      const std::vector<std::string>& image_names) const;

  // The same rule for the images of a frame whose name is known (rule 2).
  CameraNaming OfFrame(const std::string& frame_name) const;

  // The same for a file that names cameras, not images (KRT, OpenCV): the name
  // itself, or what the regex captures of it if one is given and matches.
  std::string CameraName(const std::string& name) const;

  // Empty: the default rules.
  const std::string& Regex() const { return regex_; }

 private:
  std::string regex_;
  std::string frame_name_;
};

// "000012" -> "12"; other names unchanged.
std::string CanonicalCameraName(const std::string& name);

// What is left of "NAME_rest" or "rest_NAME"; "" if `text` is neither. One of
// "_-." separates.
std::string WithoutName(const std::string& text, const std::string& name);

// Numbers by value before text, text alphabetically: the order of cameras in
// all outputs.
bool CameraNameLess(const std::string& a, const std::string& b);

}  // namespace mfir

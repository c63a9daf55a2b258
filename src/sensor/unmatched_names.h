// Names of cameras that RIG and the images do not share.

#pragma once

#include <map>
#include <ostream>
#include <string>
#include <vector>

namespace mfir {

// An image for each camera name that images have and RIG has not.
using ImageOfName = std::map<std::string, std::string>;

// Prints a warning with the most similar name for each camera of RIG that has
// no image (the first ten). Nothing if there are no cameras or no images: then
// nothing speaks for a mere difference of names.
void WarnOfUnmatchedNames(const std::vector<std::string>& cameras,
                          const ImageOfName& images,
                          std::ostream& stream);

}  // namespace mfir

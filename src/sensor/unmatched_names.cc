#include "src/sensor/unmatched_names.h"

#include <algorithm>
#include <cctype>
#include <utility>

#include "src/sensor/camera_naming.h"
#include "src/util/edit_distance.h"

namespace mfir {
namespace {

constexpr size_t kMaxNumShown = 10;

// Without what people write in different ways: "Cam_07" -> "cam7".
std::string Simplified(const std::string& name) {
  const std::string kDigits = "0123456789";
  std::string simplified;
  for (size_t i = 0; i < name.size();) {
    const size_t end =
        std::min(name.find_first_not_of(kDigits, i), name.size());
    if (end > i) {
      simplified += CanonicalCameraName(name.substr(i, end - i));
      i = end;
      continue;
    }
    const auto c = static_cast<unsigned char>(name[i++]);
    // Letters of other alphabets are not ASCII.
    if (std::isalpha(c) || c >= 128) {
      simplified += static_cast<char>(std::tolower(c));
    }
  }
  return simplified;
}

ImageOfName::const_iterator NearestImage(const std::string& camera,
                                         const ImageOfName& images) {
  const auto difference = [&](const ImageOfName::value_type& image) {
    return std::make_pair(
        EditDistance(Simplified(camera), Simplified(image.first)),
        EditDistance(camera, image.first));
  };
  return std::min_element(
      images.begin(), images.end(), [&](const auto& a, const auto& b) {
        return difference(a) < difference(b);
      });
}

}  // namespace

void WarnOfUnmatchedNames(const std::vector<std::string>& cameras,
                          const ImageOfName& images,
                          std::ostream& stream) {
  if (cameras.empty() || images.empty()) return;
  const size_t num_shown = std::min(cameras.size(), kMaxNumShown);
  for (size_t i = 0; i < num_shown; ++i) {
    const auto& [name, image] = *NearestImage(cameras[i], images);
    stream << "WARNING: camera '" << cameras[i]
           << "' of RIG has no image; nearest among the images without camera: "
              "'"
           << image << "', "
           << (name.empty() ? "without camera name" : "camera '" + name + "'")
           << "\n";
  }
  stream << "WARNING: "
         << (cameras.size() > num_shown
                 ? std::to_string(cameras.size() - num_shown) +
                       " more cameras of RIG have no image. "
                 : "")
         << "Where both are the same camera, correct the name, or set "
            "--MultiFrame.camera_name_regex so that both give the same."
         << std::endl;
}

}  // namespace mfir

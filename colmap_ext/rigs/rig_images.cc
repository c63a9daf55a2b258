#include "colmap_ext/rigs/rig_images.h"

#include <algorithm>
#include <functional>
#include <map>
#include <numeric>

#include "src/sensor/image_name.h"
#include "src/util/errors.h"
#include "src/util/parse_number.h"

namespace mfir {
namespace {

constexpr double kMaxPoseDifference = 1e-6;

// Largest distance of a camera from the first.
double RigSize(const std::vector<KnownCamera>& cameras) {
  double size = 0.0;
  for (const KnownCamera& camera : cameras) {
    size = std::max(size,
                    (camera.cam_from_world.Center() -
                     cameras.front().cam_from_world.Center())
                        .norm());
  }
  return size;
}

double AngleBetween(const KnownCamera& a, const KnownCamera& b) {
  return a.cam_from_world.rotation.angularDistance(b.cam_from_world.rotation);
}

double DistanceBetween(const KnownCamera& a, const KnownCamera& b) {
  return (a.cam_from_world.Center() - b.cam_from_world.Center()).norm();
}

bool HaveSamePose(const KnownCamera& a, const KnownCamera& b, double size) {
  return AngleBetween(a, b) <= kMaxPoseDifference &&
         DistanceBetween(a, b) <= kMaxPoseDifference * size;
}

// By camera a number that those with the same pose share. Sorted along an axis,
// so that only neighbours are compared.
std::vector<size_t> PoseGroups(const std::vector<KnownCamera>& cameras,
                               size_t* num_groups) {
  const double size = RigSize(cameras);
  std::vector<double> x(cameras.size());
  for (size_t i = 0; i < cameras.size(); ++i) {
    x[i] = cameras[i].cam_from_world.Center().x();
  }
  std::vector<size_t> order(cameras.size());
  std::iota(order.begin(), order.end(), 0);
  std::sort(order.begin(), order.end(), [&x](size_t a, size_t b) {
    return x[a] < x[b];
  });
  constexpr size_t kNone = static_cast<size_t>(-1);
  std::vector<size_t> groups(cameras.size(), kNone);
  *num_groups = 0;
  for (size_t i = 0; i < order.size(); ++i) {
    if (groups[order[i]] != kNone) continue;
    groups[order[i]] = *num_groups;
    for (size_t j = i + 1; j < order.size() && x[order[j]] - x[order[i]] <=
                                                   kMaxPoseDifference * size;
         ++j) {
      if (groups[order[j]] == kNone &&
          HaveSamePose(cameras[order[i]], cameras[order[j]], size)) {
        groups[order[j]] = *num_groups;
      }
    }
    ++*num_groups;
  }
  return groups;
}

// Whether each name stands for one group and each group has one name.
bool MatchOneToOne(const std::vector<std::string>& names,
                   const std::vector<size_t>& groups,
                   size_t num_groups) {
  std::map<std::string, size_t> group_of_name;
  for (size_t i = 0; i < names.size(); ++i) {
    if (names[i].empty()) return false;
    const auto inserted = group_of_name.emplace(names[i], groups[i]);
    if (inserted.first->second != groups[i]) return false;
  }
  return group_of_name.size() == num_groups;
}

// Rules for the names of images of many frames: file stem, folders, and the
// stem up to or after its first or last separator.
std::vector<std::function<std::string(const std::string&)>> Rules() {
  const auto folder = [](size_t depth) {
    return [depth](const std::string& name) {
      size_t begin = 0;
      for (size_t i = 0; i < depth; ++i) {
        begin = name.find('/', begin);
        if (begin == std::string::npos) return std::string();
        ++begin;
      }
      const size_t end = name.find('/', begin);
      return end == std::string::npos ? std::string()
                                      : name.substr(begin, end - begin);
    };
  };
  const auto part = [](bool before, bool first) {
    return [before, first](const std::string& name) {
      const std::string stem = FileStem(name);
      const size_t position =
          first ? stem.find_first_of("_-.") : stem.find_last_of("_-.");
      if (position == std::string::npos) return std::string();
      return before ? stem.substr(0, position) : stem.substr(position + 1);
    };
  };
  return {FileStem,
          folder(0),
          folder(1),
          folder(2),
          part(true, false),
          part(true, true),
          part(false, true),
          part(false, false)};
}

[[noreturn]] void ThrowDifferent(const std::string& path,
                                 const KnownCamera& a,
                                 const KnownCamera& b,
                                 const std::string& what) {
  throw InputError(path + ": '" + a.image_name + "' and '" + b.image_name +
                   "' are both camera '" + a.name + "', but " + what +
                   ". Remove one, or tell them apart by "
                   "--MultiFrame.camera_name_regex.");
}

}  // namespace

void NameRigImages(const CameraNaming& naming,
                   std::vector<KnownCamera>* cameras) {
  std::vector<std::string> image_names;
  for (const KnownCamera& camera : *cameras) {
    image_names.push_back(camera.image_name);
  }
  std::vector<std::string> names = naming.Names(image_names);
  size_t num_groups = 0;
  const std::vector<size_t> groups = PoseGroups(*cameras, &num_groups);
  if (naming.Regex().empty() && num_groups < cameras->size() &&
      !MatchOneToOne(names, groups, num_groups)) {
    for (const auto& rule : Rules()) {
      std::vector<std::string> other_names;
      for (const std::string& image_name : image_names) {
        other_names.push_back(CanonicalCameraName(rule(image_name)));
      }
      if (MatchOneToOne(other_names, groups, num_groups)) {
        names = other_names;
        break;
      }
    }
  }
  for (size_t i = 0; i < cameras->size(); ++i) {
    (*cameras)[i].name =
        names[i].empty() ? naming.CameraName(image_names[i]) : names[i];
  }
}

std::vector<KnownCamera> MergeRigImages(const std::string& path,
                                        std::vector<KnownCamera> cameras) {
  std::sort(cameras.begin(),
            cameras.end(),
            [](const KnownCamera& a, const KnownCamera& b) {
              return a.name != b.name ? CameraNameLess(a.name, b.name)
                                      : a.image_name < b.image_name;
            });
  const double size = cameras.empty() ? 0.0 : RigSize(cameras);
  std::vector<KnownCamera> merged;
  for (KnownCamera& camera : cameras) {
    if (merged.empty() || merged.back().name != camera.name) {
      merged.push_back(std::move(camera));
      continue;
    }
    const KnownCamera& first = merged.back();
    if (!HaveSamePose(first, camera, size)) {
      ThrowDifferent(
          path,
          first,
          camera,
          "their poses differ by " + FormatNumber(AngleBetween(first, camera)) +
              " rad and " + FormatNumber(DistanceBetween(first, camera)) +
              " units");
    }
    if (first.model != camera.model || first.params != camera.params ||
        first.width != camera.width || first.height != camera.height) {
      ThrowDifferent(path, first, camera, "their intrinsics differ");
    }
  }
  return merged;
}

}  // namespace mfir

// The known extrinsics of a camera array (RIG): reading and writing.

#pragma once

#include <string>
#include <vector>

#include "colmap_ext/rig_formats/known_camera.h"
#include "colmap_ext/rig_formats/rig_format.h"
#include "src/sensor/camera_naming.h"

namespace mfir {

struct Rig {
  std::string format;  // name of a RigFormat
  std::vector<KnownCamera> cameras;
  RigRemarks remarks;  // what the log should say
  // Whether intrinsics may be scaled to the size of the images.
  bool scale_intrinsics = false;
};

// Reads RIG from `path`.
//
//   format        name of a RigFormat; "" or "auto": detected from what lies
//                 at `path`
//   pixel_offset  added to principal points; NaN: that of the format
//
// Distortion: OpenCV's coefficients become PINHOLE when all zero, OPENCV when
// k3 and all after it are 0, FULL_OPENCV otherwise.
//
// Cameras are in the order of their names (CameraNameLess). An image that the
// regex of `naming` does not match goes by its own name. Several images are one
// camera where name, pose (to 1e-6) and intrinsics agree. Intrinsics may be
// missing (intri.yml, rig_config.json).
//
// Throws UsageError for an unknown format, and InputError (names file and line
// or field) for: missing path, unreadable or malformed file, non-finite values,
// rotation that is not one (RtR differs from the identity by more than 1e-3 or
// det < 0), focal length <= 0, skew, the same camera twice, no camera at all.
Rig ReadRig(const std::string& path,
            const std::string& format,
            const CameraNaming& naming,
            double pixel_offset);

// Throws UsageError, naming `option`, for a value that cannot be an offset of
// principal points (NaN, the default of the format, can).
void CheckPixelOffset(const std::string& option, double pixel_offset);

// Writes RIG. `path` is complete or, if it exists, as it was before. Returns
// what the format cannot hold, one line each. Throws OutputError, and
// InputError for cameras without what the format needs.
RigRemarks WriteRig(const std::string& path,
                    const RigFormat& format,
                    const std::vector<KnownCamera>& cameras);

}  // namespace mfir

// All of the host, and the names of its functions in our own namespace, for
// files that do not name what they use.

#pragma once

#include "colmap_ext/host/bundle_adjustment.h"
#include "colmap_ext/host/camera.h"
#include "colmap_ext/host/camera_models.h"
#include "colmap_ext/host/database.h"
#include "colmap_ext/host/feature.h"
#include "colmap_ext/host/image_file.h"
#include "colmap_ext/host/log.h"
#include "colmap_ext/host/reconstruction.h"
#include "colmap_ext/host/triangulation.h"
#include "colmap_ext/host/util.h"

#if MFIR_COLMAP_MAJOR < 4
#include "base/cost_functions.h"
#include "base/pose.h"
#include "exe/extension.h"
#include "optim/bundle_adjustment.h"
#include "util/version.h"
#endif

namespace mfir {

using host::CamFromWorld;
using host::SetCamFromWorld;
using host::StableQuaternion;
using host::TransformReconstruction;

}  // namespace mfir

// What we use of COLMAP's helpers.

#pragma once

#include <string>

#if MFIR_COLMAP_MAJOR >= 4
#include "colmap/math/math.h"
#include "colmap/util/string.h"
#include "colmap/util/threading.h"
#include "colmap/util/timer.h"
#include "colmap/util/version.h"
#else
#include "util/math.h"
#include "util/string.h"
#include "util/threading.h"
#include "util/timer.h"
#include "util/version.h"
#endif

namespace mfir::host {

using colmap::GetEffectiveNumThreads;
using colmap::Median;
using colmap::RadToDeg;
using colmap::StringPrintf;
using colmap::StringTrim;
using colmap::Timer;

// "COLMAP 3.8"
inline std::string VersionInfo() { return colmap::GetVersionInfo(); }

}  // namespace mfir::host

#include "colmap_ext/host/util.h"

#if MFIR_COLMAP_MAJOR >= 4
#include "colmap/util/version.h"
#else
#include "util/version.h"
#endif

namespace mfir::host {

std::string VersionInfo() { return colmap::GetVersionInfo(); }

}  // namespace mfir::host

#include "colmap_ext/result/version.h"

namespace mfir {

const char* Version() { return MFIR_VERSION; }

const char* GitCommit() { return MFIR_GIT_COMMIT; }

}  // namespace mfir

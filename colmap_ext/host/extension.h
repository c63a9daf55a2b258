// COLMAP_REGISTER_COMMAND: the hook that our patch adds to COLMAP.

#pragma once

#if MFIR_COLMAP_MAJOR >= 4
#include "colmap/exe/extension.h"
#else
#include "exe/extension.h"
#endif

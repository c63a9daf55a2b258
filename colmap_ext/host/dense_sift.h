// VLFeat's dense SIFT and smoothing, which COLMAP has in its sources.

#pragma once

#if MFIR_COLMAP_MAJOR >= 4
#include "thirdparty/VLFeat/dsift.h"
#include "thirdparty/VLFeat/imopv.h"
#else
#include "VLFeat/dsift.h"
#include "VLFeat/imopv.h"
#endif

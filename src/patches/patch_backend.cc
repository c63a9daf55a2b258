#include "src/patches/patch_backend.h"

#include <cstddef>

#include "src/patches/patch_alignment.h"

namespace mfir {

void CpuPatchBackend::SetImages(const std::vector<SplineImage>& images) {
  images_ = &images;
}

void CpuPatchBackend::SetTemplates(
    const std::vector<PatchTemplate>& templates) {
  templates_ = &templates;
}

void CpuPatchBackend::Fit(const std::vector<PatchJob>& jobs,
                          std::vector<PatchFit>* results) {
  results->assign(jobs.size(), PatchFit());
  for (size_t i = 0; i < jobs.size(); ++i) {
    // Outside it writes nothing.
    FitPatch(Template(jobs[i]), Image(jobs[i]), jobs[i].warp, &(*results)[i]);
  }
}

void CpuPatchBackend::Align(const std::vector<PatchJob>& jobs,
                            std::vector<AlignedPatch>* results) {
  results->resize(jobs.size());
  for (size_t i = 0; i < jobs.size(); ++i) {
    PatchWarp warp = jobs[i].warp;
    const PatchAlignment alignment =
        AlignPatch(Template(jobs[i]), Image(jobs[i]), &warp);
    (*results)[i] = {alignment, {warp.center[0], warp.center[1]}};
  }
}

void CpuPatchBackend::Search(const std::vector<PatchJob>& jobs,
                             std::vector<FoundPatch>* results) {
  results->resize(jobs.size());
  for (size_t i = 0; i < jobs.size(); ++i) {
    PatchWarp warp = jobs[i].warp;
    const float zncc = SearchPatch(Template(jobs[i]), Image(jobs[i]), &warp);
    (*results)[i] = {zncc, {warp.center[0], warp.center[1]}};
  }
}

}  // namespace mfir

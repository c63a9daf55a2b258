// Where many patches are fitted, aligned and searched: on the CPU or a GPU.

#pragma once

#include <string>
#include <vector>

#include "src/patches/patch_alignment_kernels.h"
#include "src/patches/spline_image.h"

namespace mfir {

// The jobs of a call name images and templates by their indices in the lists
// set before, which have to live until the next are set. All functions may
// throw GpuError; then the lists have to be set anew, on another backend.
class PatchBackend {
 public:
  virtual ~PatchBackend() = default;

  // For the log, e.g. "CPU".
  virtual std::string Name() const = 0;

  virtual void SetImages(const std::vector<SplineImage>& images) = 0;
  virtual void SetTemplates(const std::vector<PatchTemplate>& templates) = 0;

  // A result per job. FitPatch, with a gain that is not positive where that
  // fails; AlignPatch; SearchPatch.
  virtual void Fit(const std::vector<PatchJob>& jobs,
                   std::vector<PatchFit>* results) = 0;
  virtual void Align(const std::vector<PatchJob>& jobs,
                     std::vector<AlignedPatch>* results) = 0;
  virtual void Search(const std::vector<PatchJob>& jobs,
                      std::vector<FoundPatch>* results) = 0;
};

// On the calling thread.
class CpuPatchBackend final : public PatchBackend {
 public:
  std::string Name() const override { return "CPU"; }
  void SetImages(const std::vector<SplineImage>& images) override;
  void SetTemplates(const std::vector<PatchTemplate>& templates) override;
  void Fit(const std::vector<PatchJob>& jobs,
           std::vector<PatchFit>* results) override;
  void Align(const std::vector<PatchJob>& jobs,
             std::vector<AlignedPatch>* results) override;
  void Search(const std::vector<PatchJob>& jobs,
              std::vector<FoundPatch>* results) override;

 private:
  const SplineImage& Image(const PatchJob& job) const {
    return (*images_)[static_cast<size_t>(job.image_idx)];
  }
  const PatchTemplate& Template(const PatchJob& job) const {
    return (*templates_)[static_cast<size_t>(job.template_idx)];
  }

  const std::vector<SplineImage>* images_ = nullptr;
  const std::vector<PatchTemplate>* templates_ = nullptr;
};

}  // namespace mfir

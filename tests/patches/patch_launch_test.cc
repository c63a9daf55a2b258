// What the CUDA launcher does, executed on the CPU: the same functions without
// the CPU's vector instructions, by warps of threads and by single threads.

#include <cmath>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "cuda/patch_alignment_gpu.h"
#include "src/patches/patch_alignment.h"
#include "src/patches/patch_backend.h"
#include "src/util/gpu_choice.h"
#include "src/util/random.h"
#include "tests/support/patch_images.h"
#include "tests/support/thread_block.h"

namespace mfir {
namespace {

constexpr size_t kLaunchWidth = 90;
constexpr size_t kLaunchHeight = 80;
constexpr size_t kNumTemplates = 20;
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

// Patches of the first image, which the second shows with noise; the third
// shows something else, the last is none.
struct PatchCase {
  std::vector<SplineImage> images;
  std::vector<PatchTemplate> templates;
  std::vector<PatchJob> jobs;
};

SplineImage RenderNoisy(const WaveTexture& texture, double sigma) {
  Random random({12});
  return RenderFunction(kLaunchWidth, kLaunchHeight, [&](double x, double y) {
    return texture.Value(x, y) + random.Normal(0.0, sigma);
  });
}

PatchJob MakeJob(size_t template_idx, int image_idx, double x, double y) {
  return {static_cast<int>(template_idx),
          image_idx,
          {{x, y}, {1.0f, 0.0f, 0.0f, 1.0f}, {}}};
}

PatchCase MakeCase(size_t num_jobs) {
  PatchCase result;
  result.images = {RenderNoisy(WaveTexture(6.0, 5), 0.0),
                   RenderNoisy(WaveTexture(6.0, 5), 2.0),
                   RenderNoisy(WaveTexture(6.0, 77), 0.0),
                   SplineImage()};
  Random random({13});
  std::vector<Eigen::Vector2d> positions;
  while (positions.size() < kNumTemplates) {
    const Eigen::Vector2d xy(random.Uniform(12.0, kLaunchWidth - 12.0),
                             random.Uniform(12.0, kLaunchHeight - 12.0));
    PatchTemplate patch;
    if (!MakePatchTemplate(result.images[0], xy, &patch)) continue;
    result.templates.push_back(patch);
    positions.push_back(xy);
  }
  while (result.jobs.size() < num_jobs) {
    const size_t i = result.jobs.size() % kNumTemplates;
    PatchJob job = MakeJob(i,
                           result.jobs.size() % 5 == 4 ? 2 : 1,
                           positions[i].x() + random.Normal(0.0, 0.7),
                           positions[i].y() + random.Normal(0.0, 0.7));
    for (float& entry : job.warp.affine) {
      entry += static_cast<float>(random.Normal(0.0, 0.05));
    }
    for (float& entry : job.warp.quadratic) {
      entry += static_cast<float>(random.Normal(0.0, 0.001));
    }
    result.jobs.push_back(job);
  }
  // Outside, near a border, nowhere.
  result.jobs[0] = MakeJob(0, 1, 3.0, 40.0);
  result.jobs[1] = MakeJob(1, 1, 9.0, 40.0);
  result.jobs[2] = MakeJob(2, 1, kNan, 40.0);
  return result;
}

template <typename Result>
using Method = void (PatchBackend::*)(const std::vector<PatchJob>&,
                                      std::vector<Result>*);

template <typename Result>
std::vector<Result> RunOn(PatchBackend* backend,
                          const PatchCase& c,
                          Method<Result> method) {
  std::vector<Result> results;
  backend->SetImages(c.images);
  backend->SetTemplates(c.templates);
  (backend->*method)(c.jobs, &results);
  return results;
}

template <typename Result>
std::vector<Result> RunOnCpu(const PatchCase& c, Method<Result> method) {
  CpuPatchBackend cpu;
  return RunOn(&cpu, c, method);
}

// One of the groups of a grid.
template <typename Result, typename Group>
void RunGroup(const PatchCase& c,
              const Group& group,
              int first,
              int stride,
              float* scratch,
              std::vector<Result>* results) {
  std::vector<SplineView> views;
  for (const SplineImage& image : c.images) views.push_back(image.View());
  RunPatchJobs(group,
               first,
               stride,
               GetPatchDisc(),
               c.templates.data(),
               views.data(),
               c.jobs.data(),
               static_cast<int64_t>(c.jobs.size()),
               scratch,
               results->data());
}

// By one thread, as it is compiled for any CPU.
template <typename Result>
std::vector<Result> RunPlainly(const PatchCase& c) {
  std::vector<Result> results(c.jobs.size());
  std::vector<float> scratch(kPatchScratchSize);
  RunGroup(c, SerialGroup(), 0, 1, scratch.data(), &results);
  return results;
}

// By the warps of a grid, one after another.
template <typename Result>
std::vector<Result> RunByWarps(const PatchCase& c) {
  constexpr int kNumWarps = 3;
  std::vector<Result> results(c.jobs.size());
  for (int warp = 0; warp < kNumWarps; ++warp) {
    std::vector<float> scratch(kPatchScratchSize);
    RunBlock<1, WarpGroup::Size()>([&](const auto& group) {
      RunGroup(c, group, warp, kNumWarps, scratch.data(), &results);
    });
  }
  return results;
}

void ExpectEqual(const std::vector<PatchFit>& results,
                 const std::vector<PatchFit>& expected) {
  ASSERT_EQ(results.size(), expected.size());
  for (size_t i = 0; i < expected.size(); ++i) {
    for (int k = 0; k < kNumPatchBasis; ++k) {
      // The offset is a grey level, the others are times the contrast.
      ASSERT_NEAR(
          results[i].coefficients[k], expected[i].coefficients[k], 5e-3f)
          << i << " " << k;
    }
    if (!(expected[i].coefficients[kGainIdx] > 1.0f)) continue;
    ASSERT_NEAR(results[i].zncc, expected[i].zncc, 1e-3f) << i;
    ASSERT_NEAR(results[i].noise_variance,
                expected[i].noise_variance,
                1e-4f + 1e-2f * expected[i].noise_variance)
        << i;
  }
}

void ExpectEqual(const std::vector<AlignedPatch>& results,
                 const std::vector<AlignedPatch>& expected) {
  ASSERT_EQ(results.size(), expected.size());
  size_t num_different = 0;
  for (size_t i = 0; i < expected.size(); ++i) {
    const PatchAlignment& alignment = expected[i].alignment;
    // Where it does not end at once, rounding grows.
    num_different += results[i].alignment.end != alignment.end;
    if (results[i].alignment.end != PatchEnd::kConverged ||
        alignment.end != PatchEnd::kConverged || alignment.zncc < 0.8f) {
      continue;
    }
    for (int k = 0; k < 2; ++k) {
      // One may end a step earlier; the last steps are shorter than 1e-3 px.
      ASSERT_NEAR(results[i].center[k], expected[i].center[k], 2e-3) << i;
    }
    ASSERT_NEAR(results[i].alignment.zncc, alignment.zncc, 1e-3f) << i;
    for (int k = 0; k < 3; ++k) {
      ASSERT_NEAR(results[i].alignment.covariance[k],
                  alignment.covariance[k],
                  1e-5f + 5e-2f * std::abs(alignment.covariance[k]))
          << i << " " << k;
    }
  }
  EXPECT_LE(num_different, expected.size() / 100);
}

void ExpectEqual(const std::vector<FoundPatch>& results,
                 const std::vector<FoundPatch>& expected) {
  ASSERT_EQ(results.size(), expected.size());
  size_t num_different = 0;
  for (size_t i = 0; i < expected.size(); ++i) {
    ASSERT_NEAR(results[i].zncc, expected[i].zncc, 1e-3f) << i;
    if (std::isnan(expected[i].center[0])) continue;
    for (int k = 0; k < 2; ++k) {
      num_different +=
          std::abs(results[i].center[k] - expected[i].center[k]) > 1e-6;
    }
  }
  // Ties within rounding.
  EXPECT_LE(num_different, expected.size() / 100);
}

// That the jobs are of all kinds.
void ExpectAllKinds(const PatchCase& c) {
  const auto aligned = RunOnCpu(c, &PatchBackend::Align);
  size_t num_converged = 0, num_outside = 0;
  for (const AlignedPatch& result : aligned) {
    num_converged += result.alignment.end == PatchEnd::kConverged &&
                     result.alignment.zncc > 0.8f;
    num_outside += result.alignment.end == PatchEnd::kOutside;
  }
  EXPECT_GT(num_converged, c.jobs.size() / 2);
  EXPECT_LT(num_converged, c.jobs.size() * 9 / 10);
  EXPECT_GE(num_outside, 2u);
  EXPECT_EQ(RunOnCpu(c, &PatchBackend::Fit)[0].coefficients[kGainIdx], 0.0f);
  EXPECT_EQ(RunOnCpu(c, &PatchBackend::Search)[1].zncc, -1.0f);
}

TEST(PatchLaunch, PlainCodeEqualsTheCpusInstructions) {
  const PatchCase c = MakeCase(1000);
  ExpectAllKinds(c);
  ExpectEqual(RunPlainly<PatchFit>(c), RunOnCpu(c, &PatchBackend::Fit));
  ExpectEqual(RunPlainly<AlignedPatch>(c), RunOnCpu(c, &PatchBackend::Align));
  ExpectEqual(RunPlainly<FoundPatch>(c), RunOnCpu(c, &PatchBackend::Search));
}

TEST(PatchLaunch, WarpsOfThreadsEqualTheCpu) {
  const PatchCase c = MakeCase(22);
  ExpectEqual(RunByWarps<PatchFit>(c), RunOnCpu(c, &PatchBackend::Fit));
  ExpectEqual(RunByWarps<AlignedPatch>(c), RunOnCpu(c, &PatchBackend::Align));
  ExpectEqual(RunByWarps<FoundPatch>(c), RunOnCpu(c, &PatchBackend::Search));
}

TEST(PatchLaunch, GridCoversAnyNumberOfJobs) {
  constexpr int kWarps = PatchLaunch::kWarpsPerBlock;
  EXPECT_EQ(PatchLaunch::NumBlocks(1), 1);
  EXPECT_EQ(PatchLaunch::NumBlocks(kWarps), 1);
  EXPECT_EQ(PatchLaunch::NumBlocks(kWarps + 1), 2);
  EXPECT_EQ(PatchLaunch::NumBlocks(int64_t{1} << 40),
            PatchLaunch::kMaxNumBlocks);
  // Fewer warps than jobs: each takes every n-th.
  const PatchCase c = MakeCase(50);
  std::vector<PatchFit> results(c.jobs.size());
  std::vector<float> scratch(kPatchScratchSize);
  for (int warp = 0; warp < 7; ++warp) {
    RunGroup(c, SerialGroup(), warp, 7, scratch.data(), &results);
  }
  ExpectEqual(results, RunOnCpu(c, &PatchBackend::Fit));
  // Shared memory of a block on any GPU without asking for more.
  EXPECT_LE(kWarps * kPatchScratchSize * sizeof(float), 48u << 10);
}

// The twin of the GPU, where there is one.
TEST(PatchGpu, EqualsTheCpu) {
  std::unique_ptr<PatchBackend> gpu;
  try {
    gpu = CreateGpuPatchBackend(-1);
  } catch (const GpuError& error) {
    GTEST_SKIP() << "no GPU: " << error.what();
  }
  // More than one batch, then fewer jobs.
  for (const size_t num_jobs :
       {static_cast<size_t>(PatchLaunch::kMaxNumJobs) + 1000, size_t{100}}) {
    const PatchCase c = MakeCase(num_jobs);
    ExpectEqual(RunOn(gpu.get(), c, &PatchBackend::Fit),
                RunOnCpu(c, &PatchBackend::Fit));
    ExpectEqual(RunOn(gpu.get(), c, &PatchBackend::Align),
                RunOnCpu(c, &PatchBackend::Align));
    ExpectEqual(RunOn(gpu.get(), c, &PatchBackend::Search),
                RunOnCpu(c, &PatchBackend::Search));
  }
}

TEST(PatchGpu, UnknownGpuIsAnError) {
  try {
    CreateGpuPatchBackend(1000);
    FAIL() << "there is no such GPU";
  } catch (const GpuError& error) {
    EXPECT_STRNE(error.what(), "");
    EXPECT_EQ(std::string(error.what()).find('\n'), std::string::npos);
  }
}

}  // namespace
}  // namespace mfir

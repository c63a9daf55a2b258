#include "src/util/gpu_choice.h"

#include <memory>
#include <string>
#include <vector>

#include <gtest/gtest.h>

namespace mfir {
namespace {

struct FakeGpu {
  bool works = true;
  void Compute() const {
    if (!works) throw GpuError("it broke");
  }
};

GpuChoice<FakeGpu> Choose(int use_gpu, bool is_there, bool works) {
  return {use_gpu, "On the CPU", [=] {
            if (!is_there) throw GpuError("there is none");
            return std::make_unique<FakeGpu>(FakeGpu{works});
          }};
}

// Which were called, in order.
std::string Calls(GpuChoice<FakeGpu>* choice) {
  std::string calls;
  choice->Call([&](FakeGpu* gpu) {
    calls += gpu != nullptr ? "G" : "C";
    if (gpu != nullptr) gpu->Compute();
  });
  return calls;
}

TEST(GpuChoice, TakesWhatTheOptionSays) {
  GpuChoice<FakeGpu> gpu = Choose(-1, true, true);
  EXPECT_EQ(Calls(&gpu), "G");
  EXPECT_EQ(gpu.TakeFallback(), "");
  GpuChoice<FakeGpu> cpu = Choose(0, true, true);
  EXPECT_EQ(Calls(&cpu), "C");
  EXPECT_EQ(cpu.TakeFallback(), "");
  GpuChoice<FakeGpu> forced = Choose(1, true, true);
  EXPECT_EQ(Calls(&forced), "G");
}

TEST(GpuChoice, FallsBackToTheCpuAndSaysWhyOnce) {
  GpuChoice<FakeGpu> none = Choose(-1, false, true);
  EXPECT_EQ(none.Get(), nullptr);
  EXPECT_EQ(Calls(&none), "C");
  EXPECT_EQ(none.TakeFallback(), "On the CPU: there is none");
  EXPECT_EQ(none.TakeFallback(), "");
  GpuChoice<FakeGpu> broken = Choose(-1, true, false);
  EXPECT_EQ(broken.TakeFallback(), "");
  EXPECT_EQ(Calls(&broken), "GC");
  EXPECT_EQ(broken.TakeFallback(), "On the CPU: it broke");
  // It is not tried again.
  EXPECT_EQ(Calls(&broken), "C");
  EXPECT_EQ(broken.TakeFallback(), "");
}

TEST(GpuChoice, AskedForItIsAnError) {
  EXPECT_THROW(Choose(1, false, true), UsageError);
  GpuChoice<FakeGpu> broken = Choose(1, true, false);
  try {
    Calls(&broken);
    FAIL() << "the GPU does not work";
  } catch (const UsageError& error) {
    EXPECT_EQ(std::string(error.what()),
              "use_gpu=1: it broke; use_gpu=-1 takes the CPU then");
  }
}

}  // namespace
}  // namespace mfir

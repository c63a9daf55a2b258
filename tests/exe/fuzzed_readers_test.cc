// What the fuzzer runs (scripts/run_fuzzers.sh), on its seeds, on cut and
// changed ones, and on inputs that it has found.

#include <algorithm>
#include <filesystem>

#include "src/util/random.h"
#include "tests/fuzz/seeds.h"
#include "tests/fuzz/targets.h"
#include "tests/support/test_files.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

class FuzzedReadersTest : public testing::TestWithParam<FuzzTarget> {};

TEST_P(FuzzedReadersTest, Seeds) {
  const std::vector<std::string> seeds = FuzzSeeds(GetParam());
  EXPECT_FALSE(seeds.empty());
  for (const std::string& seed : seeds) GetParam().run(GetParam(), seed);
}

TEST_P(FuzzedReadersTest, CutSeeds) {
  for (const std::string& seed : FuzzSeeds(GetParam())) {
    const size_t step = std::max<size_t>(1, seed.size() / 30);
    for (size_t size = 0; size < seed.size(); size += step) {
      GetParam().run(GetParam(), seed.substr(0, size));
    }
  }
}

TEST_P(FuzzedReadersTest, ChangedSeeds) {
  Random random({1});
  for (std::string seed : FuzzSeeds(GetParam())) {
    for (int i = 0; i < 30; ++i) {
      const size_t at = static_cast<size_t>(random.Uniform() * seed.size());
      seed[at] = static_cast<char>(random.Uniform() * 256);
      GetParam().run(GetParam(), seed);
    }
  }
}

TEST_P(FuzzedReadersTest, Corpus) {
  const fs::path folder =
      fs::path(MFIR_SOURCE_DIR) / "tests" / "fuzz" / "corpus" / GetParam().name;
  if (!fs::exists(folder)) GTEST_SKIP() << "none kept";
  for (const auto& entry : fs::directory_iterator(folder)) {
    SCOPED_TRACE(entry.path());
    GetParam().run(GetParam(), ReadFile(entry.path().string()));
  }
}

INSTANTIATE_TEST_SUITE_P(Readers,
                         FuzzedReadersTest,
                         testing::ValuesIn(FuzzTargets()),
                         [](const auto& info) { return info.param.name; });

}  // namespace
}  // namespace mfir

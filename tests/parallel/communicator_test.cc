#include "src/parallel/communicator.h"

#include <cmath>
#include <limits>
#include <random>

#include <gtest/gtest.h>

#include "src/parallel/order_statistics.h"
#include "src/util/median.h"
#include "tests/support/thread_ranks.h"

namespace mfir {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

// Of each rank: every third value.
std::vector<double> Share(const std::vector<double>& values,
                          const Communicator& ranks) {
  std::vector<double> share;
  for (size_t i = ranks.Rank(); i < values.size(); i += ranks.NumRanks()) {
    share.push_back(values[i]);
  }
  return share;
}

std::vector<double> RandomValues(size_t count, uint64_t seed) {
  std::mt19937_64 engine(seed);
  std::lognormal_distribution<double> distribution(0.0, 4.0);
  std::vector<double> values;
  for (size_t i = 0; i < count; ++i) values.push_back(distribution(engine));
  return values;
}

TEST(Communicator, ConcatenatesInTheOrderOfRanks) {
  RunRanks(3, [](const Communicator& ranks) {
    // Also of ranks that have none.
    const std::vector<int> items(ranks.Rank(), ranks.Rank());
    EXPECT_EQ(Concatenate(ranks, items), std::vector<int>({1, 2, 2}));
    const std::vector<std::string> texts = {"", std::string(ranks.Rank(), 'x')};
    EXPECT_EQ(Concatenate(ranks, texts),
              std::vector<std::string>({"", "", "", "x", "", "xx"}));
    EXPECT_EQ(Sum(ranks, size_t{2}), 6);
    EXPECT_TRUE(Any(ranks, ranks.Rank() == 1));
    EXPECT_FALSE(Any(ranks, false));
  });
}

TEST(OrderStatistics, MediansAreThoseOfAllValues) {
  for (const size_t count : {1, 2, 3, 10, 1001, 5000}) {
    std::vector<double> values = RandomValues(count, count);
    values[count / 2] = kInfinity;
    values[count / 3] = 0.0;
    EXPECT_EQ(Median(values, Alone()), Median(values)) << count;
    EXPECT_EQ(UpperMedian(values, Alone()), UpperMedian(values)) << count;
    RunRanks(3, [&](const Communicator& ranks) {
      EXPECT_EQ(Median(Share(values, ranks), ranks), Median(values)) << count;
      EXPECT_EQ(UpperMedian(Share(values, ranks), ranks), UpperMedian(values))
          << count;
    });
  }
  EXPECT_TRUE(std::isnan(UpperMedian({}, Alone())));
  // Chunks on several threads.
  const std::vector<double> many = RandomValues(200000, 1);
  EXPECT_EQ(Median(many, Alone(), /*num_threads=*/3), Median(many));
}

// Against the definition: the first in ascending order at which the sum of the
// weights is reached.
TEST(OrderStatistics, FindsTheValueAtAWeight) {
  std::vector<WeightedValue> values;
  for (const double value : RandomValues(500, 1)) {
    values.push_back({value, 0.25 * (1 + values.size() % 7)});
  }
  // Equal ones, and neighbours in the last bit.
  values.push_back(values[0]);
  values.push_back({std::nextafter(values[0].value, kInfinity), 0.5});
  std::vector<WeightedValue> sorted = values;
  std::sort(sorted.begin(),
            sorted.end(),
            [](const WeightedValue& a, const WeightedValue& b) {
              return a.value < b.value;
            });
  double sum = 0.0;
  for (const WeightedValue& expected : sorted) {
    sum += expected.weight;
    EXPECT_EQ(
        ValueAtWeight(
            values.size(), [&](size_t i) { return values[i]; }, sum, Alone()),
        expected.value);
  }
}

}  // namespace
}  // namespace mfir

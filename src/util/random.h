// Random numbers that are the same on every machine and for any number of
// threads: the distributions of <random> differ between standard libraries.

#pragma once

#include <cmath>
#include <cstdint>
#include <initializer_list>
#include <random>

namespace mfir {

class Random {
 public:
  // An independent stream per key, e.g. {seed, purpose, frame, camera}.
  explicit Random(std::initializer_list<uint64_t> key) {
    uint64_t state = 0;
    for (const uint64_t part : key) {
      state = Mix(state ^ Mix(part));
    }
    engine_.seed(state);
  }

  // In [0, 1).
  double Uniform() { return static_cast<double>(engine_() >> 11) * 0x1p-53; }

  double Uniform(double low, double high) {
    return low + (high - low) * Uniform();
  }

  // In [low, high].
  int Integer(int low, int high) {
    return low + static_cast<int>(Uniform() * (high - low + 1));
  }

  // Normal distribution (Box and Muller).
  double Normal(double mean = 0.0, double sigma = 1.0) {
    const double radius = std::sqrt(-2.0 * std::log(1.0 - Uniform()));
    return mean + sigma * radius * std::cos(2.0 * M_PI * Uniform());
  }

  // Finalizer of SplitMix64: all bits of the result depend on all of `x`.
  static uint64_t Mix(uint64_t x) {
    x += 0x9e3779b97f4a7c15;
    x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9;
    x = (x ^ (x >> 27)) * 0x94d049bb133111eb;
    return x ^ (x >> 31);
  }

 private:
  std::mt19937_64 engine_;
};

}  // namespace mfir

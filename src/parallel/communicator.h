// Processes ("ranks") that work on one capture, each with some of its frames.
// The maths sums over them and knows nothing of how they talk to each other.

#pragma once

#include <cstddef>
#include <cstring>
#include <string>
#include <vector>

namespace mfir {

class Communicator {
 public:
  virtual ~Communicator() = default;

  virtual int Rank() const = 0;
  virtual int NumRanks() const = 0;

  // All ranks call these in the same order, each from one thread. Where one has
  // failed in between, they throw on all others.

  // Replaces the values by their sums over the ranks: the same bytes on all.
  virtual void Sum(double* values, size_t count) const = 0;
  // The bytes of all ranks in their order, on the first; empty on the others.
  virtual std::vector<std::string> Gather(const std::string& bytes) const = 0;
  // Replaces the bytes by those of the first rank.
  virtual void Broadcast(std::string* bytes) const = 0;

  bool IsFirst() const { return Rank() == 0; }
  bool IsAlone() const { return NumRanks() == 1; }
};

// One process has everything. `Base`: Communicator, or a class that asks for
// more.
template <typename Base>
class OnlyProcess : public Base {
 public:
  int Rank() const override { return 0; }
  int NumRanks() const override { return 1; }
  void Sum(double*, size_t) const override {}
  std::vector<std::string> Gather(const std::string& bytes) const override {
    return {bytes};
  }
  void Broadcast(std::string*) const override {}
};

inline const Communicator& Alone() {
  static const OnlyProcess<Communicator> alone;
  return alone;
}

inline double Sum(const Communicator& ranks, double value) {
  ranks.Sum(&value, 1);
  return value;
}

// Counts are exact: doubles hold them up to 2^53.
inline size_t Sum(const Communicator& ranks, size_t count) {
  return static_cast<size_t>(Sum(ranks, static_cast<double>(count)));
}

inline bool Any(const Communicator& ranks, bool is_true) {
  return Sum(ranks, is_true ? 1.0 : 0.0) > 0.0;
}

// Element by element.
inline std::vector<bool> Any(const Communicator& ranks,
                             const std::vector<bool>& are_true) {
  std::vector<double> counts(are_true.begin(), are_true.end());
  ranks.Sum(counts.data(), counts.size());
  std::vector<bool> any;
  any.reserve(counts.size());
  for (const double count : counts) any.push_back(count > 0.0);
  return any;
}

inline std::vector<size_t> Sum(const Communicator& ranks,
                               const std::vector<size_t>& counts) {
  std::vector<double> sums(counts.begin(), counts.end());
  ranks.Sum(sums.data(), sums.size());
  return std::vector<size_t>(sums.begin(), sums.end());
}

// The items of all ranks in their order, on all of them.
template <typename T>
std::vector<T> Concatenate(const Communicator& ranks,
                           const std::vector<T>& items) {
  if (ranks.IsAlone()) return items;
  std::string all;
  for (const std::string& bytes :
       ranks.Gather(std::string(reinterpret_cast<const char*>(items.data()),
                                items.size() * sizeof(T)))) {
    all += bytes;
  }
  ranks.Broadcast(&all);
  std::vector<T> concatenated(all.size() / sizeof(T));
  if (!all.empty()) {
    std::memcpy(
        static_cast<void*>(concatenated.data()), all.data(), all.size());
  }
  return concatenated;
}

template <>
inline std::vector<std::string> Concatenate(
    const Communicator& ranks, const std::vector<std::string>& texts) {
  if (ranks.IsAlone()) return texts;
  std::vector<size_t> lengths;
  std::vector<char> chars;
  for (const std::string& text : texts) {
    lengths.push_back(text.size());
    chars.insert(chars.end(), text.begin(), text.end());
  }
  const std::vector<char> all = Concatenate(ranks, chars);
  std::vector<std::string> concatenated;
  size_t begin = 0;
  for (const size_t length : Concatenate(ranks, lengths)) {
    concatenated.emplace_back(all.data() + begin, length);
    begin += length;
  }
  return concatenated;
}

}  // namespace mfir

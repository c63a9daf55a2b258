// Keypoints of one image, to be found by their position.

#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <unordered_map>
#include <vector>

namespace mfir {

class KeypointGrid {
 public:
  // Pixels. Larger cells: fewer to look into, but more keypoints in each.
  KeypointGrid(double max_distance, double cell_size)
      : max_distance_(max_distance), cell_size_(cell_size) {}

  // `idx`: what ForEachNear gives for it.
  void Add(const Eigen::Vector2d& xy, size_t idx) {
    const auto [cell, is_new] =
        cells_.emplace(Cell(CellOf(xy.x()), CellOf(xy.y())), kNone);
    entries_.push_back({xy, idx, cell->second});
    cell->second = entries_.size() - 1;
  }

  // Those with erase(idx).
  template <typename Function>
  void EraseIf(const Function& erase) {
    std::vector<Entry> entries;
    entries.swap(entries_);
    cells_.clear();
    for (const Entry& entry : entries) {
      if (!erase(entry.idx)) Add(entry.xy, entry.idx);
    }
  }

  // Calls function(idx) for those within `max_distance`.
  template <typename Function>
  void ForEachNear(const Eigen::Vector2d& xy, const Function& function) const {
    for (int64_t x = CellOf(xy.x() - max_distance_);
         x <= CellOf(xy.x() + max_distance_);
         ++x) {
      for (int64_t y = CellOf(xy.y() - max_distance_);
           y <= CellOf(xy.y() + max_distance_);
           ++y) {
        const auto cell = cells_.find(Cell(x, y));
        if (cell == cells_.end()) continue;
        for (size_t i = cell->second; i != kNone; i = entries_[i].next) {
          if ((entries_[i].xy - xy).norm() > max_distance_) continue;
          function(entries_[i].idx);
        }
      }
    }
  }

 private:
  static constexpr size_t kNone = SIZE_MAX;

  struct Entry {
    Eigen::Vector2d xy;
    size_t idx;
    size_t next;  // in the same cell
  };

  int64_t CellOf(double coordinate) const {
    return static_cast<int64_t>(
        std::floor(std::clamp(coordinate, -1e9, 1e9) / cell_size_));
  }

  // Cells far apart may share a key: distances are checked anyway.
  static uint64_t Cell(int64_t x, int64_t y) {
    constexpr uint64_t kMask = (uint64_t{1} << 32) - 1;
    return (static_cast<uint64_t>(x) << 32) |
           (static_cast<uint64_t>(y) & kMask);
  }

  double max_distance_;
  double cell_size_;
  std::unordered_map<uint64_t, size_t> cells_;  // the last entry of each
  std::vector<Entry> entries_;
};

}  // namespace mfir

// Binary files of COLMAP models (little endian), read such that errors name the
// entry and the byte.

#pragma once

#include <cstdint>
#include <cstring>
#include <string>
#include <utility>

#include "src/util/errors.h"

namespace mfir {

// Walks over a binary file and never beyond its end.
class BinaryFile {
 public:
  // `path` is for messages, `data` is the content of the file.
  BinaryFile(const std::string& path, std::string data)
      : path_(path), data_(std::move(data)) {}

  // The entry that messages name from here on, e.g. "image" 2 of 5.
  void SetEntry(const char* kind, uint64_t idx, uint64_t num) {
    kind_ = kind;
    idx_ = idx;
    num_ = num;
  }

  // That as many entries of this size can follow.
  void Require(uint64_t count, size_t size) const {
    if (count > (data_.size() - position_) / size) {
      Fail("needs " + std::to_string(count) + " x " + std::to_string(size) +
           " bytes, but the file ends before");
    }
  }

  template <typename T>
  T Read() {
    T value;
    Require(1, sizeof(T));
    std::memcpy(&value, data_.data() + position_, sizeof(T));
    position_ += sizeof(T);
    return value;
  }

  void Skip(uint64_t count, size_t size) {
    Require(count, size);
    position_ += count * size;
  }

  // Number of entries, each of at least `min_size` bytes.
  uint64_t ReadCount(size_t min_size) {
    const uint64_t count = Read<uint64_t>();
    Require(count, min_size);
    return count;
  }

  // Zero-terminated.
  std::string ReadString() {
    const size_t end = data_.find('\0', position_);
    if (end == std::string::npos) {
      Fail("the file ends within a name");
    }
    std::string text = data_.substr(position_, end - position_);
    position_ = end + 1;
    return text;
  }

  void RequireEnd() const {
    if (position_ != data_.size()) {
      throw InputError(path_ + ": " + std::to_string(data_.size() - position_) +
                       " bytes too many after the last entry. The file is "
                       "damaged, or its first 8 bytes (the number of entries) "
                       "are wrong: copy or export the model again.");
    }
  }

  [[noreturn]] void Fail(const std::string& what) const {
    std::string where = path_ + ": ";
    if (kind_ != nullptr) {
      where += std::string(kind_) + " " + std::to_string(idx_ + 1) + " of " +
               std::to_string(num_) + ": ";
    }
    throw InputError(where + what + " (byte " + std::to_string(position_) +
                     " of " + std::to_string(data_.size()) +
                     "). The file is truncated or damaged: copy or export the "
                     "model again.");
  }

 private:
  const std::string path_;
  const std::string data_;
  size_t position_ = 0;
  const char* kind_ = nullptr;
  uint64_t idx_ = 0;
  uint64_t num_ = 0;
};

}  // namespace mfir

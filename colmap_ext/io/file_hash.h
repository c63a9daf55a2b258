// Sizes and hashes of files, so that a run can be repeated with the same ones.

#pragma once

#include <cstdint>
#include <string>

namespace mfir {

struct FileHash {
  uint64_t bytes = 0;
  std::string sha256;  // 64 hexadecimal digits
};

// Of the content. Throws InputError if the file cannot be read.
FileHash HashFile(const std::string& path);

}  // namespace mfir

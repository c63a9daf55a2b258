// Arrays of NumPy in one file, .npz: a zip archive of .npy files.

#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace mfir {

struct NumpyArray {
  std::vector<size_t> shape;
  std::vector<double> numbers;     // row by row; empty of an array of texts
  std::vector<std::string> texts;  // UTF-8
};

class NpzFile {
 public:
  // Throws InputError if there is no such file or it is no zip archive.
  explicit NpzFile(const std::string& path);
  ~NpzFile();
  NpzFile(const NpzFile&) = delete;
  NpzFile& operator=(const NpzFile&) = delete;

  // The array of numbers (float or int, 4 or 8 bytes) or texts of that name.
  // Throws InputError for a damaged one and other types.
  std::optional<NumpyArray> Find(const std::string& name) const;
  NumpyArray At(const std::string& name) const;

  // Throws InputError: FILE: the array NAME `text`.
  [[noreturn]] void Fail(const std::string& name,
                         const std::string& text) const;

 private:
  std::string ReadMember(const std::string& name) const;

  const std::string path_;
  void* archive_;
};

// Writes numbers as 8-byte floats, texts as NumPy's unicode. Throws
// OutputError, and InputError for a text that is not UTF-8.
void WriteNpz(const std::string& path,
              const std::vector<std::pair<std::string, NumpyArray>>& arrays);

}  // namespace mfir

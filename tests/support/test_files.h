// Files that tests write and read.

#pragma once

#include <filesystem>
#include <fstream>
#include <functional>
#include <sstream>
#include <string>

#include <gtest/gtest.h>

#include "src/util/errors.h"

namespace mfir {

// A private folder, removed with the object.
class TemporaryFolder {
 public:
  TemporaryFolder() {
    std::string path =
        (std::filesystem::temp_directory_path() / "mfir_test_XXXXXX").string();
    if (mkdtemp(path.data()) == nullptr) {
      throw std::runtime_error("cannot make " + path);
    }
    path_ = path;
  }
  ~TemporaryFolder() {
    std::error_code error;
    std::filesystem::remove_all(path_, error);
  }
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;

  std::string operator/(const std::string& name) const {
    return (path_ / name).string();
  }
  std::string Path() const { return path_.string(); }

 private:
  std::filesystem::path path_;
};

inline std::string ReadFile(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::stringstream content;
  content << file.rdbuf();
  return content.str();
}

inline void WriteFile(const std::string& path, const std::string& content) {
  std::filesystem::create_directories(
      std::filesystem::path(path).parent_path());
  std::ofstream(path, std::ios::binary) << content;
}

// `text` with its only occurrence of `from` replaced.
inline std::string Replaced(std::string text,
                            const std::string& from,
                            const std::string& to) {
  const size_t begin = text.find(from);
  EXPECT_NE(begin, std::string::npos) << from;
  EXPECT_EQ(text.find(from, begin + 1), std::string::npos) << from;
  return begin == std::string::npos ? text
                                    : text.replace(begin, from.size(), to);
}

// `text` with all that editors add to it and nobody sees: a byte order mark,
// blanks at the ends of lines, and Windows line ends.
inline std::string WithInvisibles(const std::string& text) {
  std::string result = "\xef\xbb\xbf";
  for (const char c : text) {
    result += c == '\n' ? " \t\r\n" : std::string(1, c);
  }
  return result;
}

// Expects an InputError whose message contains all of `parts`.
inline void ExpectInputError(const std::function<void()>& body,
                             const std::vector<std::string>& parts) {
  try {
    body();
    ADD_FAILURE() << "no error, expected: " << testing::PrintToString(parts);
  } catch (const InputError& error) {
    for (const std::string& part : parts) {
      EXPECT_NE(std::string(error.what()).find(part), std::string::npos)
          << "'" << part << "' is not in: " << error.what();
    }
  }
}

}  // namespace mfir

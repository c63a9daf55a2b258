#include "colmap_ext/io/input_file.h"

#include <filesystem>
#include <fstream>
#include <sstream>
#include <string_view>
#include <system_error>

#include "colmap_ext/host/util.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

constexpr std::string_view kByteOrderMark = "\xef\xbb\xbf";

bool BeginsWith(std::string_view data, std::string_view begin) {
  return data.substr(0, begin.size()) == begin;
}

}  // namespace

std::string ReadInputFile(const std::string& path) {
  std::error_code error;
  const auto status = std::filesystem::status(path, error);
  if (!std::filesystem::exists(status)) {
    throw InputError(path + ": there is no such file. Correct the path.");
  }
  if (!std::filesystem::is_regular_file(status)) {
    throw InputError(path + " is not a regular file but a " +
                     (std::filesystem::is_directory(status)
                          ? "folder. Give a file."
                          : "pipe or device. Save its content to a file."));
  }
  std::ifstream file(path, std::ios::binary | std::ios::ate);
  std::string data(file ? static_cast<size_t>(file.tellg()) : 0, '\0');
  file.seekg(0);
  file.read(data.data(), static_cast<std::streamsize>(data.size()));
  if (!file) {
    throw InputError(path +
                     ": cannot read the file. Check its permissions and the "
                     "disk.");
  }
  return data;
}

std::string ReadTextFile(const std::string& path) {
  std::string data = ReadInputFile(path);
  // Not ff ff: that is no text at all.
  if (BeginsWith(data, "\xff\xfe") || BeginsWith(data, "\xfe\xff")) {
    throw InputError(path + ": the text is in UTF-16. Save it as UTF-8.");
  }
  if (BeginsWith(data, kByteOrderMark)) {
    data.erase(0, kByteOrderMark.size());
  }
  return data;
}

bool HasByteOrderMark(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::string begin(kByteOrderMark.size(), '\0');
  return file.read(begin.data(), static_cast<std::streamsize>(begin.size())) &&
         begin == kByteOrderMark;
}

std::vector<ListEntry> ReadNameList(const std::string& option,
                                    const std::string& path) {
  std::istringstream file;
  try {
    file.str(ReadTextFile(path));
  } catch (const InputError& error) {
    throw InputError(option + " " + error.what());
  }
  std::vector<ListEntry> entries;
  std::string line;
  for (int number = 1; std::getline(file, line); ++number) {
    host::StringTrim(&line);
    if (!line.empty() && line[0] != '#') {
      entries.push_back({line, path + ":" + std::to_string(number) + ": "});
    }
  }
  if (entries.empty()) {
    throw InputError(option + " " + path +
                     " has no name in it. Write one per line.");
  }
  return entries;
}

}  // namespace mfir

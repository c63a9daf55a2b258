// Files that a user names.

#pragma once

#include <string>
#include <vector>

namespace mfir {

// The whole file. Only regular files (or links to one): a pipe or device may
// never end. Throws InputError.
std::string ReadInputFile(const std::string& path);

// The same for text: without the byte order mark that some editors write.
// UTF-16 is an InputError.
std::string ReadTextFile(const std::string& path);

// Whether the file begins with the byte order mark of UTF-8.
bool HasByteOrderMark(const std::string& path);

struct ListEntry {
  std::string name;
  std::string where;  // "PATH:LINE: ", for messages
};

// A list of names, one per line; empty lines and those that begin with '#' are
// left out. Throws InputError, naming `option`, if the file cannot be read or
// has no name.
std::vector<ListEntry> ReadNameList(const std::string& option,
                                    const std::string& path);

}  // namespace mfir

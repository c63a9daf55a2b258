// Numbers in text files and option values.

#pragma once

#include <charconv>
#include <iterator>
#include <string>
#include <string_view>

namespace mfir {

// Parses the whole of `text` as a decimal number, independent of the locale.
// False for anything else: empty text, spaces, trailing characters, a value
// that T cannot hold. For doubles "nan" and "inf" are numbers.
template <typename T>
bool ParseNumber(std::string_view text, T* value) {
  if (text.size() > 1 && text[0] == '+' && text[1] != '-') {
    text.remove_prefix(1);
  }
  const char* end = text.data() + text.size();
  const auto [stop, error] = std::from_chars(text.data(), end, *value);
  return error == std::errc() && stop == end;
}

// The shortest text that reads back to the same number, for messages.
inline std::string FormatNumber(double value) {
  char text[32];
  return {text, std::to_chars(std::begin(text), std::end(text), value).ptr};
}

}  // namespace mfir

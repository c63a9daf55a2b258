// Text files of numbers, read line by line such that errors name the line.

#pragma once

#include <algorithm>
#include <cmath>
#include <string>
#include <string_view>

#include "src/util/errors.h"
#include "src/util/parse_number.h"

namespace mfir {

class TextFile {
 public:
  // What separates the tokens of a line: exactly one space, as for COLMAP's
  // reader, or any number of spaces and tabs.
  enum class Spacing { kOneSpace, kAny };

  // `path` is for messages, `data` is the content of the file.
  TextFile(const std::string& path, std::string data, Spacing spacing)
      : path_(path), data_(std::move(data)), spacing_(spacing) {}
  TextFile(const TextFile&) = delete;
  TextFile& operator=(const TextFile&) = delete;

  // Goes to the next line; false at the end of the file. A line is what COLMAP
  // takes for one: without surrounding white space.
  bool NextLine() {
    if (position_ >= data_.size()) {
      return false;
    }
    ++line_number_;
    const size_t end = std::min(data_.find('\n', position_), data_.size());
    line_ = std::string_view(data_).substr(position_, end - position_);
    position_ = end + 1;
    const char* const kSpace = " \n\r\t";
    line_.remove_prefix(
        std::min(line_.find_first_not_of(kSpace), line_.size()));
    line_ = line_.substr(0, line_.find_last_not_of(kSpace) + 1);
    rest_ = line_;
    return true;
  }

  // Goes to the next line that is neither empty nor a comment.
  bool NextContentLine() {
    while (NextLine()) {
      if (!line_.empty() && line_[0] != '#') {
        return true;
      }
    }
    return false;
  }

  std::string_view Line() const { return line_; }
  size_t LineNumber() const { return line_number_; }
  bool AtLineEnd() const { return rest_.empty(); }

  // The next token of the line.
  std::string_view Token(const char* field) {
    if (AtLineEnd()) {
      Fail(std::string(field) + " is missing at the end of the line");
    }
    const char* const separators = spacing_ == Spacing::kAny ? " \t" : " ";
    const size_t end = std::min(rest_.find_first_of(separators), rest_.size());
    const std::string_view token = rest_.substr(0, end);
    size_t next = std::min(end + 1, rest_.size());
    if (spacing_ == Spacing::kAny) {
      next = std::min(rest_.find_first_not_of(separators, end), rest_.size());
    }
    rest_.remove_prefix(next);
    if (token.empty()) {
      Fail(std::string("two spaces in a row before ") + field +
           "; one is allowed");
    }
    return token;
  }

  template <typename T>
  T Number(const char* field) {
    const std::string_view token = Token(field);
    T value;
    if (!ParseNumber(token, &value)) {
      Fail(std::string(field) + ": '" + Shortened(token) +
           "' is not a number that fits");
    }
    return value;
  }

  double FiniteNumber(const char* field) {
    const double value = Number<double>(field);
    if (!std::isfinite(value)) {
      Fail(std::string(field) + " is not finite");
    }
    return value;
  }

  void RequireLineEnd(const char* last_field) {
    if (!AtLineEnd()) {
      Fail("unexpected '" + Shortened(rest_) + "' after " + last_field);
    }
  }

  [[noreturn]] void Fail(const std::string& what) const {
    throw InputError(path_ + ":" + std::to_string(line_number_) + ": " + what +
                     ". Correct the line, or export the file again.");
  }

 private:
  static std::string Shortened(std::string_view text) {
    const size_t kMaxLength = 40;
    return text.size() <= kMaxLength
               ? std::string(text)
               : std::string(text.substr(0, kMaxLength)) + "...";
  }

  const std::string path_;
  const std::string data_;
  const Spacing spacing_;
  size_t position_ = 0;
  size_t line_number_ = 0;
  std::string_view line_;
  std::string_view rest_;
};

}  // namespace mfir

// JSON files whose errors name file and field.

#pragma once

#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>
#include <nlohmann/json.hpp>

namespace mfir {

// A value of the file and where it is: "FILE: cameras[3].K". All throw
// InputError.
class JsonValue {
 public:
  JsonValue(const nlohmann::json* value,
            const std::string& path,
            const std::string& field)
      : value_(value), path_(path), field_(field) {}

  bool IsObject() const { return value_->is_object(); }
  bool IsArray() const { return value_->is_array(); }

  // A member that must be there, or may.
  JsonValue At(const std::string& key) const;
  std::optional<JsonValue> Find(const std::string& key) const;
  // Elements of an array; members of an object, with their names.
  std::vector<JsonValue> Elements() const;
  std::vector<std::pair<std::string, JsonValue>> Members() const;

  std::string Text() const;
  bool Flag() const;  // true, false, or a number
  double Number() const;
  // A whole number of pixels.
  size_t ImageSize() const;
  // Numbers of an array of any depth, in the order of the file.
  std::vector<double> Numbers() const;
  std::vector<double> Numbers(size_t size) const;
  // Nested arrays, or one with all elements row by row.
  template <int kRows, int kCols>
  Eigen::Matrix<double, kRows, kCols> Matrix() const {
    const std::vector<double> values = Numbers(kRows * kCols);
    constexpr int kOrder = kCols == 1 ? Eigen::ColMajor : Eigen::RowMajor;
    return Eigen::Map<const Eigen::Matrix<double, kRows, kCols, kOrder>>(
        values.data());
  }

  // "FILE: FIELD"
  std::string Where() const;
  [[noreturn]] void Fail(const std::string& what) const;

 private:
  const nlohmann::json* value_;
  std::string path_;
  std::string field_;
};

// Throws InputError, naming line and column, for text that is no JSON, and for
// a key that stands twice in one object.
nlohmann::json ParseJson(const std::string& path, const std::string& text);

}  // namespace mfir

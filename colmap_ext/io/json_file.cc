#include "colmap_ext/io/json_file.h"

#include <cmath>
#include <set>

#include "src/util/errors.h"

namespace mfir {
namespace {

using Event = nlohmann::json::parse_event_t;

void AppendNumbers(const JsonValue& value,
                   const nlohmann::json& json,
                   std::vector<double>* numbers) {
  if (json.is_array()) {
    for (const nlohmann::json& element : json) {
      AppendNumbers(value, element, numbers);
    }
    return;
  }
  if (!json.is_number() || !std::isfinite(json.get<double>())) {
    value.Fail("element " + std::to_string(numbers->size() + 1) +
               " is not a finite number");
  }
  numbers->push_back(json.get<double>());
}

}  // namespace

std::optional<JsonValue> JsonValue::Find(const std::string& key) const {
  if (!value_->is_object()) Fail("is not an object");
  const auto it = value_->find(key);
  if (it == value_->end()) return std::nullopt;
  return JsonValue(&*it, path_, field_.empty() ? key : field_ + "." + key);
}

JsonValue JsonValue::At(const std::string& key) const {
  const std::optional<JsonValue> value = Find(key);
  if (!value) {
    JsonValue(nullptr, path_, field_.empty() ? key : field_ + "." + key)
        .Fail("is missing");
  }
  return *value;
}

std::vector<JsonValue> JsonValue::Elements() const {
  if (!value_->is_array()) Fail("is not a list");
  std::vector<JsonValue> elements;
  for (const nlohmann::json& element : *value_) {
    elements.emplace_back(
        &element, path_, field_ + "[" + std::to_string(elements.size()) + "]");
  }
  return elements;
}

std::vector<std::pair<std::string, JsonValue>> JsonValue::Members() const {
  if (!value_->is_object()) Fail("is not an object");
  std::vector<std::pair<std::string, JsonValue>> members;
  for (const auto& [key, value] : value_->items()) {
    members.emplace_back(
        key,
        JsonValue(&value, path_, field_.empty() ? key : field_ + "." + key));
  }
  return members;
}

std::string JsonValue::Text() const {
  // Names that are numbers are often written without quotes.
  if (value_->is_number_integer()) return value_->dump();
  if (!value_->is_string() || value_->get_ref<const std::string&>().empty()) {
    Fail("is not a text");
  }
  return value_->get<std::string>();
}

bool JsonValue::Flag() const {
  if (value_->is_boolean()) return value_->get<bool>();
  if (value_->is_number()) return value_->get<double>() != 0.0;
  Fail("is neither true nor false");
}

double JsonValue::Number() const {
  if (!value_->is_number() || !std::isfinite(value_->get<double>())) {
    Fail("is not a finite number");
  }
  return value_->get<double>();
}

size_t JsonValue::ImageSize() const {
  const double size = Number();
  if (!(size >= 1.0 && size <= 1e6) || size != std::floor(size)) {
    Fail("is not an image size in pixels");
  }
  return static_cast<size_t>(size);
}

std::vector<double> JsonValue::Numbers() const {
  if (!value_->is_array()) Fail("is not a list of numbers");
  std::vector<double> numbers;
  AppendNumbers(*this, *value_, &numbers);
  return numbers;
}

std::vector<double> JsonValue::Numbers(size_t size) const {
  std::vector<double> numbers = Numbers();
  if (numbers.size() != size) {
    Fail("has " + std::to_string(numbers.size()) + " numbers, not " +
         std::to_string(size));
  }
  return numbers;
}

std::string JsonValue::Where() const {
  return field_.empty() ? path_ : path_ + ": " + field_;
}

void JsonValue::Fail(const std::string& what) const {
  throw InputError(Where() + " " + what +
                   ". Correct the field, or export the calibration again.");
}

nlohmann::json ParseJson(const std::string& path, const std::string& text) {
  // The parser takes the last of two: a camera would be lost in silence.
  std::vector<std::set<std::string>> keys;
  const auto check_keys = [&](int, Event event, const nlohmann::json& value) {
    if (event == Event::object_start) keys.emplace_back();
    if (event == Event::object_end) keys.pop_back();
    if (event == Event::key && !keys.back().insert(value).second) {
      throw InputError(path + ": the key '" + value.get<std::string>() +
                       "' stands twice in one object. Remove one, or give it "
                       "a name of its own.");
    }
    return true;
  };
  try {
    return nlohmann::json::parse(text, check_keys);
  } catch (const nlohmann::json::exception& error) {
    // "[json.exception.parse_error.101] parse error at line 1, column 2: ..."
    const std::string what = error.what();
    const size_t begin = what.find("] ");
    throw InputError(
        path + ": not valid JSON: " +
        (begin == std::string::npos ? what : what.substr(begin + 2)) +
        ". Correct the file, or export the calibration again.");
  }
}

}  // namespace mfir

// Pieces of HTML: text that is only text, numbers, tables.

#pragma once

#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace mfir {

// `text` such that a browser shows it as it is, in content and in quoted
// attributes. Bytes that are not UTF-8 become U+FFFD.
std::string EscapeHtml(const std::string& text);

// JSON that may stand in a <script> element.
std::string ScriptJson(const nlohmann::ordered_json& json);

// Rounded to `digits` decimals; a dash where the value is not finite.
std::string Fixed(double value, int digits);

// The same with a sign.
std::string Signed(double value, int digits);

// 1234567 as "1 234 567", with thin spaces.
std::string Count(size_t count);

// The number at `pointer` (a JSON pointer) of the summary, times `scale`, with
// `digits` decimals. The element names the field and has the exact value, so
// that page and file can be compared. A dash where there is no number.
std::string Field(const nlohmann::ordered_json& summary,
                  const std::string& pointer,
                  int digits,
                  double scale = 1.0);

// The string at `pointer` of the summary, in the same way.
std::string TextField(const nlohmann::ordered_json& summary,
                      const std::string& pointer);

// The number at `pointer`, NaN where there is none.
double NumberAt(const nlohmann::ordered_json& summary,
                const std::string& pointer);

// The string at `pointer`, "" where there is none.
std::string TextAt(const nlohmann::ordered_json& summary,
                   const std::string& pointer);

// "1 camera", "3 cameras".
std::string Plural(size_t count, const std::string& noun);

// A table row of cells that are HTML already.
std::string Row(const std::vector<std::string>& cells, const char* tag = "td");

// A table that a click on a column's head sorts.
std::string Table(const std::vector<std::string>& heads,
                  const std::vector<std::vector<std::string>>& rows);

// What is folded up on the screen and open in print.
std::string Folded(const std::string& title,
                   const std::string& content,
                   bool open = false);

// A picture with what it shows.
std::string Figure(const std::string& picture, const std::string& caption);

}  // namespace mfir

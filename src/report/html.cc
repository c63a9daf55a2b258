#include "src/report/html.h"

#include <cmath>
#include <cstdio>
#include <limits>

namespace mfir {

using Json = nlohmann::ordered_json;

std::string EscapeHtml(const std::string& text) {
  const std::string utf8 =
      Json::parse(
          Json(text).dump(-1, ' ', false, Json::error_handler_t::replace))
          .get<std::string>();
  std::string escaped;
  for (const char c : utf8) {
    switch (c) {
      case '&':
        escaped += "&amp;";
        break;
      case '<':
        escaped += "&lt;";
        break;
      case '>':
        escaped += "&gt;";
        break;
      case '"':
        escaped += "&quot;";
        break;
      case '\'':
        escaped += "&#39;";
        break;
      default:
        escaped += c;
    }
  }
  return escaped;
}

std::string ScriptJson(const Json& json) {
  std::string text;
  for (const char c :
       json.dump(-1, ' ', true, Json::error_handler_t::replace)) {
    text += c == '<' ? "\\u003c" : std::string(1, c);
  }
  return text;
}

std::string Fixed(double value, int digits) {
  if (!std::isfinite(value)) return "&ndash;";
  char text[64];
  std::snprintf(text, sizeof(text), "%.*f", digits, value);
  // No negative zero.
  const std::string fixed = text;
  return fixed.find_first_not_of("-0.") == std::string::npos && text[0] == '-'
             ? fixed.substr(1)
             : fixed;
}

std::string Signed(double value, int digits) {
  const std::string fixed = Fixed(value, digits);
  return std::isfinite(value) && value > 0.0 ? "+" + fixed : fixed;
}

std::string Count(size_t count) {
  std::string digits = std::to_string(count);
  for (size_t i = digits.size(); i > 3; i -= 3) {
    digits.insert(i - 3, "&#8239;");
  }
  return digits;
}

double NumberAt(const Json& summary, const std::string& pointer) {
  const Json::json_pointer at(pointer);
  if (!summary.contains(at) || !summary.at(at).is_number()) {
    return std::numeric_limits<double>::quiet_NaN();
  }
  return summary.at(at).get<double>();
}

std::string TextAt(const Json& summary, const std::string& pointer) {
  const Json::json_pointer at(pointer);
  if (!summary.contains(at) || !summary.at(at).is_string()) return "";
  return summary.at(at).get<std::string>();
}

std::string Field(const Json& summary,
                  const std::string& pointer,
                  int digits,
                  double scale) {
  const double value = NumberAt(summary, pointer);
  if (!std::isfinite(value)) return "&ndash;";
  return "<data data-field=\"" + EscapeHtml(pointer) + "\" value=\"" +
         summary.at(Json::json_pointer(pointer)).dump() + "\">" +
         Fixed(value * scale, digits) + "</data>";
}

std::string TextField(const Json& summary, const std::string& pointer) {
  const Json::json_pointer at(pointer);
  if (!summary.contains(at) || !summary.at(at).is_string()) return "&ndash;";
  return "<span data-text=\"" + EscapeHtml(pointer) + "\">" +
         EscapeHtml(summary.at(at).get<std::string>()) + "</span>";
}

std::string Plural(size_t count, const std::string& noun) {
  return Count(count) + " " + noun + (count == 1 ? "" : "s");
}

std::string Row(const std::vector<std::string>& cells, const char* tag) {
  std::string row = "<tr>";
  for (const std::string& cell : cells) {
    row += std::string("<") + tag + ">" + cell + "</" + tag + ">";
  }
  return row + "</tr>\n";
}

std::string Table(const std::vector<std::string>& heads,
                  const std::vector<std::vector<std::string>>& rows) {
  std::string table =
      "<div class=\"scroll\"><table class=\"sortable\"><thead>" +
      Row(heads, "th") + "</thead><tbody>\n";
  for (const std::vector<std::string>& row : rows) table += Row(row);
  return table + "</tbody></table></div>\n";
}

std::string Folded(const std::string& title,
                   const std::string& content,
                   bool open) {
  return std::string("<details") + (open ? " open" : "") + "><summary>" +
         title + "</summary>\n" + content + "</details>\n";
}

std::string Figure(const std::string& picture, const std::string& caption) {
  return "<figure>" + picture + "<figcaption>" + caption +
         "</figcaption></figure>\n";
}

}  // namespace mfir

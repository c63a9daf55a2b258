#include "src/util/option_checks.h"

#include <algorithm>
#include <cmath>

#include "src/util/errors.h"
#include "src/util/parse_number.h"

namespace mfir {

void CheckAtLeast(const char* name, double value, double minimum) {
  if (!std::isfinite(value) || value < minimum) {
    throw UsageError(
        "--MultiFrame." + std::string(name) + " is " + FormatNumber(value) +
        ", but must be finite and >= " + FormatNumber(minimum) + ".");
  }
}

void CheckOneOf(const char* name,
                const std::string& value,
                const std::vector<std::string>& choices) {
  if (std::find(choices.begin(), choices.end(), value) != choices.end()) {
    return;
  }
  std::string list;
  for (const std::string& choice : choices) {
    if (!choice.empty()) list += (list.empty() ? "" : ", ") + choice;
  }
  throw UsageError("--MultiFrame." + std::string(name) + " is '" + value +
                   "', but must be one of: " + list + ".");
}

}  // namespace mfir

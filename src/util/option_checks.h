// Checks of option values of the section [MultiFrame].

#pragma once

#include <string>
#include <vector>

namespace mfir {

// Each throws UsageError that names the option --MultiFrame.`name` and what is
// allowed.
void CheckAtLeast(const char* name, double value, double minimum);
void CheckOneOf(const char* name,
                const std::string& value,
                const std::vector<std::string>& choices);

}  // namespace mfir

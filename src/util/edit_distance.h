// How different two names are, for "did you mean".

#pragma once

#include <cstddef>
#include <string>

namespace mfir {

// Levenshtein distance: insertions, deletions and substitutions of characters.
size_t EditDistance(const std::string& a, const std::string& b);

}  // namespace mfir

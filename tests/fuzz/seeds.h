// Good inputs for the readers, from the examples of the other tests.

#pragma once

#include <string>
#include <vector>

#include "tests/fuzz/targets.h"

namespace mfir {

std::vector<std::string> FuzzSeeds(const FuzzTarget& target);

}  // namespace mfir

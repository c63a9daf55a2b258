// How far a piece of work has come.

#pragma once

#include <cstddef>
#include <functional>

namespace mfir {

// Called when `num_done` of `num_all` parts are done, from any thread. May be
// empty.
using ProgressFunction = std::function<void(size_t num_done, size_t num_all)>;

}  // namespace mfir

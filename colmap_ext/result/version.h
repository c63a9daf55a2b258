// Which version of the project this is.

#pragma once

namespace mfir {

// "0.1.0"
const char* Version();

// Of the sources; "unknown" outside of a clone.
const char* GitCommit();

}  // namespace mfir

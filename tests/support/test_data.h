// Real captures that some tests read where they exist.

#pragma once

#include <cstdlib>
#include <filesystem>
#include <string>

#include <gtest/gtest.h>

namespace mfir {

// Folder of the captures: the environment variable MFIR_DATA_DIR, else
// ../shared/data relative to the source tree.
inline std::filesystem::path TestDataFolder() {
  const char* folder = std::getenv("MFIR_DATA_DIR");
  return folder != nullptr ? std::filesystem::path(folder)
                           : std::filesystem::path(MFIR_SOURCE_DIR) / ".." /
                                 "shared" / "data";
}

}  // namespace mfir

// Skips the test if `path` within the captures does not exist.
#define MFIR_REQUIRE_TEST_DATA(path)                                       \
  if (!std::filesystem::exists(mfir::TestDataFolder() / (path))) {         \
    GTEST_SKIP() << (mfir::TestDataFolder() / (path))                      \
                 << " does not exist: set MFIR_DATA_DIR to the folder of " \
                    "the captures";                                        \
  }

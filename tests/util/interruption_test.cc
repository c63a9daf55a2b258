// What libraries do to end the process. Signals: tests/interrupted_runs.sh.

#include "src/util/interruption.h"

#include <cstdlib>
#include <filesystem>
#include <functional>
#include <new>
#include <stdexcept>
#include <thread>

#include <gtest/gtest.h>

#include "tests/support/test_files.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

// Runs in a process of its own, with a temporary folder that must be gone.
void ExpectEnds(const std::function<void()>& body,
                int exit_code,
                const std::string& line) {
  const TemporaryFolder folder;
  const std::string path = folder / "temporary";
  EXPECT_EXIT(
      {
        const CleanFailures clean_failures;
        const ScopedTemporaryPath temporary(path);
        WriteFile(path + "/file", "x");
        body();
      },
      testing::ExitedWithCode(exit_code),
      line);
  EXPECT_TRUE(fs::is_empty(folder.Path()));
}

TEST(CleanFailures, OfThreads) {
  ExpectEnds([] { std::thread([] { throw std::bad_alloc(); }).join(); },
             3,
             "^ERROR: Out of memory[^\n]*\n$");
  ExpectEnds([] { std::thread([] { throw 1; }).join(); },
             3,
             "^ERROR: Unexpected failure[^\n]*\n$");
}

TEST(CleanFailures, ExitOfALibrary) {
  ExpectEnds([] { std::exit(1); }, 4, "^ERROR: COLMAP cannot go on[^\n]*\n$");
  ExpectEnds([] { std::thread([] { std::exit(1); }).join(); },
             4,
             "^ERROR: COLMAP cannot go on[^\n]*\n$");
}

// As COLMAP 4 ends a failure of SQLite, from destructors, too.
TEST(CleanFailures, DatabaseFailure) {
  const auto fails_with = [](const std::string& reason) {
    return [reason] {
      std::thread([reason] {
        throw std::runtime_error("[database.cc:50] SQLite error: " + reason);
      }).join();
    };
  };
  ExpectEnds(fails_with("database or disk is full"),
             4,
             "^ERROR: COLMAP cannot go on[^\n]*\n$");
  ExpectEnds(fails_with("out of memory"), 3, "^ERROR: Out of memory[^\n]*\n$");
}

// As while a result is published.
TEST(CleanFailures, WithinASignalDelay) {
  ExpectEnds(
      [] {
        const SignalDelay delay;
        std::exit(1);
      },
      4,
      "ERROR: COLMAP");
}

TEST(CleanFailures, ExitOfOurs) {
  EXPECT_EXIT(
      {
        { const CleanFailures clean_failures; }
        std::exit(1);
      },
      testing::ExitedWithCode(1),
      "^$");
  EXPECT_EXIT(
      {
        const CleanFailures clean_failures;
        std::exit(0);
      },
      testing::ExitedWithCode(0),
      "^$");
}

}  // namespace
}  // namespace mfir

// A real browser that opens a page, where there is one.

#pragma once

#include <cstdlib>
#include <string>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "tests/support/refiner_runner.h"

namespace mfir {

// Chromium of the path, or what the environment variable MFIR_BROWSER names;
// empty without.
inline std::string FindBrowser() {
  const char* browser = std::getenv("MFIR_BROWSER");
  if (browser != nullptr) return browser;
  const std::string path =
      RunShell("command -v chromium || command -v chromium-browser").output;
  return path.substr(0, path.find('\n'));
}

// Opens a page without any network and returns the document as it is after
// its scripts.
inline std::string OpenPage(const std::string& path,
                            int width,
                            int height,
                            const std::string& more_options = "") {
  const TemporaryFolder profile;
  const CommandResult result =
      RunShell("timeout 100 " + ShellQuoted(FindBrowser()) +
               " --headless --no-sandbox --disable-gpu --disable-dev-shm-usage "
               "--no-first-run --host-resolver-rules='MAP * ~NOTFOUND' "
               "--virtual-time-budget=8000 --window-size=" +
               std::to_string(width) + "," + std::to_string(height) +
               " --user-data-dir=" + ShellQuoted(profile.Path()) + " " +
               more_options + " --dump-dom " + ShellQuoted("file://" + path));
  EXPECT_EQ(result.exit_code, 0) << result.error;
  return result.output;
}

}  // namespace mfir

// Skips the test where there is no browser.
#define MFIR_REQUIRE_BROWSER()                                                \
  if (mfir::FindBrowser().empty()) {                                          \
    GTEST_SKIP() << "there is no chromium: install the package, or name the " \
                    "program in MFIR_BROWSER";                                \
  }

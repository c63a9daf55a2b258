#include "colmap_ext/exe/command.h"

#include <cctype>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <iostream>
#include <new>
#include <string>

#include "src/util/errors.h"
#include "src/util/interruption.h"

namespace mfir {

namespace {

// One line without control characters, whatever names are in the message: those
// of files and cameras are the input's.
void PrintError(const std::string& message) {
  std::string line = "ERROR: ";
  for (const char c : message) {
    if (std::iscntrl(static_cast<unsigned char>(c))) {
      char escaped[8];
      std::snprintf(escaped, sizeof(escaped), "\\x%02x", c & 0xff);
      line += escaped;
    } else {
      line += c;
    }
  }
  std::cerr << line << std::endl;
}

}  // namespace

int RunCommand(const std::function<void()>& body) {
  try {
    EndCleanlyAtSignals();
    const CleanFailures clean_failures;
    body();
    return kExitSuccess;
  } catch (const Error& error) {
    WaitIfInterrupted();
    PrintError(error.what());
    return error.exit_code;
  } catch (const std::bad_alloc&) {
    PrintError("Out of memory. Select fewer frames with --frame_list_path.");
    return kExitSolver;
  } catch (const std::filesystem::filesystem_error& error) {
    WaitIfInterrupted();
    // Outputs have their own checks: this is a path that the system rejects.
    PrintError(std::string(error.what()) + ". Correct the path.");
    return kExitBadInput;
  } catch (const std::exception& error) {
    WaitIfInterrupted();
    PrintError(std::string("Unexpected failure: ") + error.what());
    return kExitSolver;
  }
}

}  // namespace mfir

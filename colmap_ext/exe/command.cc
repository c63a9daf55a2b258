#include "colmap_ext/exe/command.h"

#include <exception>
#include <filesystem>
#include <iostream>
#include <new>

#include "src/util/errors.h"
#include "src/util/interruption.h"

namespace mfir {

namespace {

int RunBody(const std::function<void()>& body) {
  try {
    body();
    return kExitSuccess;
  } catch (const Error& error) {
    WaitIfInterrupted();
    std::cerr << "ERROR: " << error.what() << std::endl;
    return error.exit_code;
  } catch (const std::bad_alloc&) {
    std::cerr << "ERROR: Out of memory. Select fewer frames with "
                 "--frame_list_path."
              << std::endl;
    return kExitSolver;
  } catch (const std::filesystem::filesystem_error& error) {
    WaitIfInterrupted();
    // Outputs have their own checks: this is a path that the system rejects.
    std::cerr << "ERROR: " << error.what() << ". Correct the path."
              << std::endl;
    return kExitBadInput;
  } catch (const std::exception& error) {
    WaitIfInterrupted();
    std::cerr << "ERROR: Unexpected failure: " << error.what() << std::endl;
    return kExitSolver;
  }
}

}  // namespace

int RunCommand(const std::function<void()>& body) {
  EndCleanlyAtSignals();
  return RunBody(body);
}

}  // namespace mfir

// libFuzzer over one reader:
//
//   mfir_fuzzer --target=NAME [OPTIONS AND FOLDERS OF LIBFUZZER]
//   mfir_fuzzer --seeds=FOLDER    writes FOLDER/NAME/... for all readers
//   mfir_fuzzer --names           prints the names of all readers

#include <cstdint>
#include <cstdlib>
#include <iostream>
#include <string>

#include "tests/fuzz/seeds.h"
#include "tests/fuzz/targets.h"
#include "tests/support/test_files.h"

namespace {

const mfir::FuzzTarget* chosen_target = nullptr;

void WriteSeeds(const std::string& folder) {
  for (const mfir::FuzzTarget& target : mfir::FuzzTargets()) {
    const std::vector<std::string> seeds = mfir::FuzzSeeds(target);
    for (size_t i = 0; i < seeds.size(); ++i) {
      mfir::WriteFile(folder + "/" + target.name + "/seed" + std::to_string(i),
                      seeds[i]);
    }
  }
}

}  // namespace

// libFuzzer skips arguments that begin with two dashes.
extern "C" int LLVMFuzzerInitialize(int* argc, char*** argv) {
  const std::string kTarget = "--target=", kSeeds = "--seeds=";
  for (int i = 1; i < *argc; ++i) {
    const std::string argument = (*argv)[i];
    if (argument == "--names") {
      for (const mfir::FuzzTarget& target : mfir::FuzzTargets()) {
        std::cout << target.name << "\n";
      }
      std::exit(0);
    }
    if (argument.rfind(kSeeds, 0) == 0) {
      WriteSeeds(argument.substr(kSeeds.size()));
      std::exit(0);
    }
    if (argument.rfind(kTarget, 0) == 0) {
      chosen_target = mfir::FindFuzzTarget(argument.substr(kTarget.size()));
    }
  }
  if (chosen_target == nullptr) {
    std::cerr << "Give --target=NAME, one of those that --names prints.\n";
    std::exit(1);
  }
  return 0;
}

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  chosen_target->run(*chosen_target,
                     {reinterpret_cast<const char*>(data), size});
  return 0;
}

// Readers of files that come from elsewhere, each as a function of bytes: what
// the fuzzer runs, and the test fuzzed_readers on the kept inputs.

#pragma once

#include <string>
#include <vector>

namespace mfir {

// A reader. `run` reads the input and does with the result what the commands do
// first; it returns for good input and for errors that our commands report. All
// else, an exception of another type say, is a bug.
struct FuzzTarget {
  std::string name;
  void (*run)(const FuzzTarget& target, const std::string& input);
  // Names of the files that the input is written to. The parts of an input for
  // several files stand one after another with kNextFile between.
  std::vector<std::string> files;
  // What is read, within the folder of the files; empty: the folder.
  std::string path;
};

// An empty line would be content of some text formats.
constexpr char kNextFile[] = "<<next file>>\n";

const std::vector<FuzzTarget>& FuzzTargets();

// nullptr: there is no such target.
const FuzzTarget* FindFuzzTarget(const std::string& name);

}  // namespace mfir

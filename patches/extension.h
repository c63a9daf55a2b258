// Lets code outside of the COLMAP source tree add commands to the `colmap`
// program: list its folder in the CMake variable COLMAP_EXTENSION_DIRS, add
// its OBJECT library to the global property COLMAP_EXTENSION_OBJECTS, and use
//
//   COLMAP_REGISTER_COMMAND("command_name", RunCommand);
//
// at namespace scope, where RunCommand is an int(int argc, char** argv).

#ifndef COLMAP_SRC_EXE_EXTENSION_H_
#define COLMAP_SRC_EXE_EXTENSION_H_

#include <functional>
#include <string>
#include <utility>
#include <vector>

namespace colmap {

using ExtensionCommandList =
    std::vector<std::pair<std::string, std::function<int(int, char**)>>>;

inline ExtensionCommandList& ExtensionCommands() {
  static ExtensionCommandList commands;
  return commands;
}

}  // namespace colmap

#define COLMAP_REGISTER_COMMAND(name, function) \
  static const bool k##function##Registered =   \
      (colmap::ExtensionCommands().emplace_back(name, function), true)

#endif  // COLMAP_SRC_EXE_EXTENSION_H_

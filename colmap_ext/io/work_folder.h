// Where a result is prepared before it gets its name.

#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "src/util/errors.h"
#include "src/util/interruption.h"

namespace mfir {

// Another run has the folder.
struct FolderInUse : OutputError {
  using OutputError::OutputError;
};

// A folder of this run alone, empty at first; it goes, with what is in it, when
// the object goes or when a signal ends the process.
class WorkFolder {
 public:
  // Makes the folder in one that exists. What a killed run has left there is
  // removed; a link is removed, not followed. Throws OutputError if it cannot
  // be made, FolderInUse while another run has it. File systems without locks
  // go without. Not within a SignalDelay.
  explicit WorkFolder(const std::filesystem::path& path);
  ~WorkFolder();
  WorkFolder(const WorkFolder&) = delete;
  WorkFolder& operator=(const WorkFolder&) = delete;

  // The one beside `path`, for a result that is to get this name. Its own name
  // is short: that of the result may be as long as names can be.
  static std::filesystem::path Beside(const std::filesystem::path& path);

  const std::filesystem::path& Path() const { return path_; }

 private:
  bool Lock();

  const std::filesystem::path path_;
  int lock_ = -1;
  // While the folder is locked.
  std::optional<ScopedTemporaryPath> removed_at_end_;
};

// Writes a text file such that `path` has all of `text` or what it had before.
// Links are replaced, not followed. Throws OutputError.
void ReplaceFile(const std::string& path, const std::string& text);

}  // namespace mfir

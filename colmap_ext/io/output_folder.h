// The folder of a result: kept apart from the inputs, locked, and replaced only
// by complete results.

#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "src/util/interruption.h"

namespace mfir {

class OutputFolder {
 public:
  // Creates the folder and makes sure, before any time is spent, that it can be
  // written to. Until the object goes, no other run may write there.
  //
  //   names        the files and folders of a result, in the order in which
  //                they are moved into place; the last one marks a folder that
  //                holds a result
  //   frames_path  folder whose sub-folders are frames: the output must not
  //                lie among them
  //   input_paths  other inputs (empty ones are skipped): none may be the
  //                folder itself, or what a result would replace
  //
  // Throws UsageError for a folder that is not apart from the inputs,
  // OutputError for one that cannot be written to or whose content is not a
  // result.
  OutputFolder(const std::string& path,
               const std::vector<std::string>& names,
               const std::string& frames_path,
               const std::vector<std::string>& input_paths);

  // The folder that another process has made and will publish: this one may
  // write to its temporary folder, too.
  OutputFolder(const std::string& path, const std::vector<std::string>& names);
  ~OutputFolder();
  OutputFolder(const OutputFolder&) = delete;
  OutputFolder& operator=(const OutputFolder&) = delete;

  // Throws UsageError if a result would replace one of these inputs. Links are
  // followed.
  void CheckKeeps(const std::vector<std::string>& input_paths) const;

  const std::filesystem::path& Path() const { return path_; }

  // Where a result is prepared; removed with the object.
  const std::filesystem::path& TemporaryPath() const { return temporary_path_; }

  // Moves what was prepared into place; parts of an earlier result that the new
  // one has not are removed. A result that is not `good` never replaces an
  // earlier one: it then becomes the sub-folder "not_converged", which the next
  // good result removes. Returns the folder that has the new result. Throws
  // OutputError.
  std::filesystem::path Publish(bool good);

 private:
  void CheckApart(const std::string& frames_path,
                  const std::vector<std::string>& input_paths) const;
  void Lock();
  void MakeTemporaryFolder();

  const std::filesystem::path path_;
  const std::vector<std::string> names_;
  const std::filesystem::path temporary_path_;
  int lock_ = -1;
  // While the folder is locked.
  std::optional<ScopedTemporaryPath> removed_at_end_;
};

}  // namespace mfir

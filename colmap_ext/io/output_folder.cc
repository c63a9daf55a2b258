#include "colmap_ext/io/output_folder.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <fstream>
#include <system_error>

#include "src/util/errors.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

constexpr char kNotConverged[] = "not_converged";

// Absolute, links followed, no slash at the end.
fs::path Canonical(const fs::path& path) {
  std::error_code error;
  fs::path canonical = fs::weakly_canonical(fs::absolute(path), error);
  // What the system cannot follow is an error later.
  if (error) canonical = fs::absolute(path).lexically_normal();
  return canonical.has_filename() ? canonical : canonical.parent_path();
}

bool IsSameOrInside(const fs::path& path, const fs::path& folder) {
  const fs::path canonical_path = Canonical(path);
  const fs::path canonical_folder = Canonical(folder);
  return std::mismatch(canonical_folder.begin(),
                       canonical_folder.end(),
                       canonical_path.begin(),
                       canonical_path.end())
             .first == canonical_folder.end();
}

}  // namespace

OutputFolder::OutputFolder(const std::string& path,
                           const std::vector<std::string>& names,
                           const std::string& frames_path,
                           const std::vector<std::string>& input_paths)
    : path_(path), names_(names), temporary_path_(path_ / ".unfinished") {
  std::error_code error;
  if (fs::exists(path_, error) && !fs::is_directory(path_, error)) {
    throw OutputError("--output_path " + path + " is a file. Give a folder.");
  }
  CheckApart(frames_path, input_paths);
  for (const std::string& name : names_) {
    if (fs::exists(path_ / name, error) &&
        !fs::exists(path_ / names_.back(), error)) {
      throw OutputError("--output_path " + path + " has '" + name +
                        "' but no " + names_.back() +
                        ": it is not a result that may be replaced. Give "
                        "another folder, or empty this one.");
    }
  }
  fs::create_directories(path_, error);
  if (error) {
    throw OutputError("--output_path " + path +
                      ": cannot create the folder: " + error.message() + ".");
  }
  Lock();
  // In between a signal would remove what is not there yet.
  const SignalDelay delay;
  removed_at_end_.emplace(temporary_path_);
  try {
    MakeTemporaryFolder();
  } catch (...) {
    removed_at_end_.reset();
    close(lock_);
    throw;
  }
}

OutputFolder::OutputFolder(const std::string& path,
                           const std::vector<std::string>& names)
    : path_(path), names_(names), temporary_path_(path_ / ".unfinished") {}

OutputFolder::~OutputFolder() {
  removed_at_end_.reset();
  if (lock_ >= 0) close(lock_);
}

void OutputFolder::CheckApart(
    const std::string& frames_path,
    const std::vector<std::string>& input_paths) const {
  const auto fail = [this](const std::string& what) {
    throw UsageError("--output_path " + path_.string() + " " + what +
                     ". Give a folder apart from the inputs.");
  };
  if (IsSameOrInside(path_, frames_path)) {
    fail("lies in the folder of the frames, " + frames_path);
  }
  std::error_code error;
  for (fs::directory_iterator it(frames_path, error), end; !error && it != end;
       it.increment(error)) {
    std::error_code ignored;
    if (it->is_directory(ignored) && IsSameOrInside(path_, it->path())) {
      fail("lies in the frame " + it->path().string());
    }
  }
  for (const std::string& input_path : input_paths) {
    if (!input_path.empty() && Canonical(input_path) == Canonical(path_)) {
      fail("is the input " + input_path);
    }
  }
  CheckKeeps({frames_path});
  CheckKeeps(input_paths);
}

void OutputFolder::CheckKeeps(
    const std::vector<std::string>& input_paths) const {
  std::vector<std::string> names = names_;
  names.push_back(kNotConverged);
  for (const std::string& input_path : input_paths) {
    for (const std::string& name : names) {
      if (!input_path.empty() && IsSameOrInside(input_path, path_ / name)) {
        throw UsageError("--output_path " + path_.string() +
                         ": the result's '" + name +
                         "' would replace the input " + input_path +
                         ". Give a folder apart from the inputs.");
      }
    }
  }
}

// The lock of the folder goes with the process, however that ends. File systems
// without locks go without.
void OutputFolder::Lock() {
  lock_ = open(path_.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (flock(lock_, LOCK_EX | LOCK_NB) != 0 && errno == EWOULDBLOCK) {
    close(lock_);
    throw OutputError("--output_path " + path_.string() +
                      ": another run is writing to this folder. Wait for it, "
                      "or give another folder.");
  }
}

// What is there already was left by a killed run, since the lock is ours.
void OutputFolder::MakeTemporaryFolder() {
  std::error_code error;
  fs::remove_all(temporary_path_, error);
  if (!error) fs::create_directory(temporary_path_, error);
  if (error) {
    throw OutputError("--output_path " + path_.string() +
                      ": cannot write to the folder: " + error.message() + ".");
  }
}

fs::path OutputFolder::Publish(bool good) {
  const SignalDelay delay;
  const bool has_result = fs::exists(path_ / names_.back());
  fs::path not_converged_path = path_ / kNotConverged;
  if (!good && has_result) {
    fs::remove_all(not_converged_path);
    fs::rename(temporary_path_, not_converged_path);
    return not_converged_path;
  }
  for (const std::string& name : names_) {
    // What was there before goes away with the temporary folder.
    if (fs::exists(path_ / name)) {
      fs::rename(path_ / name, temporary_path_ / ("old_" + name));
    }
    if (fs::exists(temporary_path_ / name)) {
      fs::rename(temporary_path_ / name, path_ / name);
    }
  }
  fs::remove_all(not_converged_path);
  return path_;
}

}  // namespace mfir

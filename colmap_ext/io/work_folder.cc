#include "colmap_ext/io/work_folder.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdint>
#include <cstdio>
#include <fstream>
#include <system_error>
#include <utility>

namespace mfir {
namespace {

namespace fs = std::filesystem;

// Without a slash at the end: the last part is the name.
fs::path WithoutSlash(const fs::path& path) {
  return path.has_filename() ? path : path.parent_path();
}

std::string LastError() { return std::generic_category().message(errno); }

// Whether the open folder still is what has this path.
bool IsAt(int folder, const fs::path& path) {
  struct stat opened = {}, named = {};
  return fstat(folder, &opened) == 0 && lstat(path.c_str(), &named) == 0 &&
         opened.st_dev == named.st_dev && opened.st_ino == named.st_ino;
}

[[noreturn]] void Fail(const fs::path& path, const std::string& why) {
  const fs::path parent = path.parent_path();
  throw OutputError((parent.empty() ? "." : parent.string()) +
                    ": cannot write to the folder: " + why + ".");
}

}  // namespace

WorkFolder::WorkFolder(const fs::path& path) : path_(path) {
  const SignalDelay delay;
  // A run that ends meanwhile takes its folder with it.
  while (!Lock()) {
  }
  removed_at_end_.emplace(path_);
  std::error_code error;
  for (fs::directory_iterator it(path_, error), end; !error && it != end;
       it.increment(error)) {
    fs::remove_all(it->path(), error);
    if (error) break;
  }
  if (error) {
    removed_at_end_.reset();
    close(lock_);
    Fail(path_, error.message());
  }
}

WorkFolder::~WorkFolder() {
  removed_at_end_.reset();
  close(lock_);
}

fs::path WorkFolder::Beside(const fs::path& path) {
  const fs::path result = WithoutSlash(path);
  // FNV-1a.
  uint64_t hash = 14695981039346656037u;
  for (const char c : result.filename().string()) {
    hash = (hash ^ static_cast<unsigned char>(c)) * 1099511628211u;
  }
  char name[40];
  std::snprintf(name,
                sizeof(name),
                ".unfinished_%016llx",
                static_cast<unsigned long long>(hash));
  return result.parent_path() / name;
}

// False if the folder went away before it was locked.
bool WorkFolder::Lock() {
  // A link or a file. Not a folder, even if another run makes it just now.
  unlink(path_.c_str());
  if (mkdir(path_.c_str(), 0777) != 0 && errno != EEXIST) {
    Fail(path_, LastError());
  }
  lock_ = open(path_.c_str(), O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC);
  if (lock_ < 0) {
    if (errno == ENOENT) return false;
    Fail(path_, LastError());
  }
  if (flock(lock_, LOCK_EX | LOCK_NB) != 0 && errno == EWOULDBLOCK) {
    close(lock_);
    throw FolderInUse(path_.string() +
                      ": another run is writing to this folder. Wait for it, "
                      "or give another --output_path.");
  }
  if (IsAt(lock_, path_)) return true;
  close(lock_);
  return false;
}

void ReplaceFile(const std::string& path, const std::string& text) {
  const auto fail = [&path]() {
    throw OutputError(path +
                      ": cannot write the file. Does its folder exist, is it "
                      "writable, and is the disk not full?");
  };
  if (!fs::path(path).has_filename()) fail();
  const WorkFolder folder(WorkFolder::Beside(path));
  const fs::path temporary = folder.Path() / "file";
  std::ofstream file(temporary, std::ios::binary);
  file << text;
  file.close();
  if (!file || std::rename(temporary.c_str(), path.c_str()) != 0) fail();
}

}  // namespace mfir

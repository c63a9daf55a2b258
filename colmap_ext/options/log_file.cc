#include "colmap_ext/options/log_file.h"

#include <unistd.h>

#include <ctime>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <memory>
#include <mutex>
#include <streambuf>

#include "src/util/errors.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

// From several threads, as the streams of the terminal. `terminal` may be null.
class CopyingBuffer : public std::streambuf {
 public:
  CopyingBuffer(std::streambuf* terminal,
                std::ofstream* file,
                std::mutex* mutex)
      : terminal_(terminal), file_(file), mutex_(mutex) {}

 protected:
  int_type overflow(int_type c) override {
    const char character = traits_type::to_char_type(c);
    xsputn(&character, 1);
    return traits_type::not_eof(c);
  }

  // A log that cannot be written ends no run.
  std::streamsize xsputn(const char* text, std::streamsize size) override {
    const std::lock_guard<std::mutex> lock(*mutex_);
    file_->write(text, size);
    if (terminal_ != nullptr) terminal_->sputn(text, size);
    return size;
  }

  int sync() override {
    const std::lock_guard<std::mutex> lock(*mutex_);
    file_->flush();
    return terminal_ == nullptr ? 0 : terminal_->pubsync();
  }

 private:
  std::streambuf* const terminal_;
  std::ofstream* const file_;
  std::mutex* const mutex_;
};

struct LogFile {
  explicit LogFile(const std::string& path) : file(path) {}
  ~LogFile() {
    std::cout.rdbuf(terminal_out);
    std::cerr.rdbuf(terminal_err);
  }

  void Begin(bool only_file) {
    out = std::make_unique<CopyingBuffer>(
        only_file ? nullptr : terminal_out, &file, &mutex);
    err = std::make_unique<CopyingBuffer>(terminal_err, &file, &mutex);
    std::cout.rdbuf(out.get());
    std::cerr.rdbuf(err.get());
  }

  std::ofstream file;
  std::mutex mutex;
  std::streambuf* const terminal_out = std::cout.rdbuf();
  std::streambuf* const terminal_err = std::cerr.rdbuf();
  std::unique_ptr<CopyingBuffer> out;
  std::unique_ptr<CopyingBuffer> err;
};

// The streams are the process's, and so are these.
std::unique_ptr<LogFile> log_file;
int num_scopes = 0;
int log_exit_code = 0;

std::string FileName(const std::string& command) {
  const std::time_t now = std::time(nullptr);
  std::tm local = {};
  localtime_r(&now, &local);
  char date[32];
  std::strftime(date, sizeof(date), "%Y%m%d-%H%M%S", &local);
  return command + "." + date + "." + std::to_string(getpid()) + ".log";
}

}  // namespace

void BeginLogFile(const host::LogOptions& options,
                  const std::string& command,
                  const std::vector<std::string>& arguments) {
  const std::string& folder = options.path;
  if (log_file != nullptr || folder.empty() || !options.ToFile()) return;
  std::error_code ignored;
  fs::create_directories(folder, ignored);
  auto begun = std::make_unique<LogFile>(
      (fs::path(folder) / FileName(command)).string());
  begun->file << "colmap " << command;
  for (const std::string& argument : arguments) begun->file << " " << argument;
  begun->file << std::endl;
  if (!begun->file) {
    throw OutputError("--log_path " + folder +
                      ": cannot write a file there. Is it a folder, is it "
                      "writable, and is the disk not full?");
  }
  log_file = std::move(begun);
  log_file->Begin(options.target == "file");
}

LogFileScope::LogFileScope() { ++num_scopes; }

LogFileScope::~LogFileScope() {
  if (exit_code_ != 0) log_exit_code = exit_code_;
  if (--num_scopes > 0) return;
  if (log_file != nullptr) {
    std::cout.flush();
    log_file->file << "Exit code " << log_exit_code << std::endl;
    log_file.reset();
  }
  log_exit_code = 0;
}

}  // namespace mfir

#include "colmap_ext/host/log.h"

#include <iostream>

#if MFIR_COLMAP_MAJOR >= 4
#include "colmap/util/logging.h"
#else
#include "util/logging.h"
#endif

namespace mfir::host {

void PrintHeading1(const std::string& heading) {
  const std::string line(78, '=');
  std::cout << '\n' << line << '\n' << heading << '\n' << line << "\n\n";
  std::cout.flush();
}

void InitializeLog(char** argv) { colmap::InitializeGlog(argv); }

SilentColmap::SilentColmap()
    : stdout_(std::cout.rdbuf()), min_log_level_(FLAGS_minloglevel) {
  std::cout.rdbuf(nullptr);
#if MFIR_COLMAP_MAJOR >= 4
  const bool on_terminal =
      FLAGS_logtostderr || FLAGS_alsologtostderr || FLAGS_logtostdout;
  if (on_terminal && FLAGS_v == 0) FLAGS_minloglevel = google::GLOG_ERROR;
#endif
}

SilentColmap::~SilentColmap() {
  FLAGS_minloglevel = min_log_level_;
  std::cout.rdbuf(stdout_);
  std::cout.clear();
}

}  // namespace mfir::host

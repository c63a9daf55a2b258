// OpenCV prints and logs its errors as well as throwing them; messages are
// ours.

#pragma once

#include <opencv2/core.hpp>
#include <opencv2/core/utility.hpp>
#include <opencv2/core/utils/logger.hpp>

namespace mfir {

// No such output while an object lives.
class QuietOpenCV {
 public:
  QuietOpenCV() {
    previous_ = cv::redirectError(
        [](int, const char*, const char*, const char*, int, void*) {
          return 0;
        },
        nullptr,
        &previous_data_);
    previous_level_ =
        cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT);
  }
  ~QuietOpenCV() {
    cv::utils::logging::setLogLevel(previous_level_);
    cv::redirectError(previous_, previous_data_);
  }
  QuietOpenCV(const QuietOpenCV&) = delete;
  QuietOpenCV& operator=(const QuietOpenCV&) = delete;

 private:
  cv::ErrorCallback previous_ = nullptr;
  void* previous_data_ = nullptr;
  cv::utils::logging::LogLevel previous_level_;
};

}  // namespace mfir

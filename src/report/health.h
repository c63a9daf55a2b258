// Whether the result can be used, in words.

#pragma once

#include <string>
#include <vector>

#include "src/report/report.h"

namespace mfir {

enum class Health { kGood, kLook, kBad };

// The class of the style sheet, and a word for people.
std::string HealthClass(Health health);
std::string HealthWord(Health health);

struct Finding {
  Health health = Health::kGood;
  std::string text;  // HTML
};

// What the flags, rms and change of a camera say, the gravest first; empty:
// nothing to say.
std::vector<Finding> CameraFindings(const Report& report, size_t camera_idx);

Health CameraHealth(const Report& report, size_t camera_idx);

// Reasons for and against the result as a whole, the gravest first.
std::vector<Finding> ResultFindings(const Report& report);

}  // namespace mfir

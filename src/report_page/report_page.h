// report.html: one file that needs nothing else.

#pragma once

#include <string>

#include "src/report/report.h"

namespace mfir {

// What the head of every page says it was made by.
extern const char kReportGenerator[];

// The page. Pictures are SVG; a little JavaScript turns the array, sorts tables
// and unfolds what is folded for print. Without it all but the array is there.
// Throws InputError for a summary whose fields have wrong types.
std::string MakeReportPage(const Report& report);

}  // namespace mfir

// The sections of report.html, each as HTML.

#pragma once

#include <string>

#include "src/report/report.h"

namespace mfir {

std::string VerdictSection(const Report& report);      // verdict_section.cc
std::string ChangesSection(const Report& report);      // changes_section.cc
std::string HistorySection(const Report& report);      // changes_section.cc
std::string ArraySection(const Report& report);        // array_section.cc
std::string CamerasSection(const Report& report);      // cameras_section.cc
std::string ResidualsSection(const Report& report);    // quality_sections.cc
std::string FramesSection(const Report& report);       // quality_sections.cc
std::string HeldOutSection(const Report& report);      // quality_sections.cc
std::string WeakModesSection(const Report& report);    // quality_sections.cc
std::string StaticSection(const Report& report);       // quality_sections.cc
std::string EvaluationSection(const Report& report);   // quality_sections.cc
std::string ConvergenceSection(const Report& report);  // run_sections.cc
std::string ExamplesSection(const Report& report);     // examples_section.cc
std::string RunSection(const Report& report);          // run_sections.cc

}  // namespace mfir

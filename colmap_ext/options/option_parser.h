// Command options on top of COLMAP's OptionManager, with what it lacks: the
// command line overrides the project ini file, sections and names of other
// commands are skipped, and a typo in a section of ours or before the first
// section is an error.

#pragma once

#include <functional>
#include <ostream>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "colmap_ext/host/options.h"

namespace mfir {

class OptionParser {
 public:
  // What --help says before the options: a sentence, and a command line.
  void SetHelp(const std::string& description, const std::string& example) {
    description_ = description;
    example_ = example;
  }

  // The heading, in --help, of the options that follow.
  void BeginGroup(const std::string& title) { group_ = title; }

  // Registers an option, "name" or "Section.name", of type bool, int, double or
  // std::string. The present *value is the default. `value` must outlive the
  // parser.
  template <typename T>
  void Add(const std::string& name, T* value, const std::string& help);

  // The same for a string that must not stay empty.
  void AddRequired(const std::string& name,
                   std::string* value,
                   const std::string& help);

  // A section that belongs to another command as well: names in it that are not
  // registered here are skipped in an ini file.
  void AddSharedSection(const std::string& section) {
    shared_sections_.push_back(section);
  }

  // Parses --project_path (if given), then the command line. If `preset_name`
  // names a registered string option, `apply_preset` is called with its value
  // before anything else is parsed, and sets defaults (explicit options win).
  // Begins the log file that --log_path asks for. Throws UsageError. With
  // --help: prints the options and exits with 0.
  void Parse(int argc,
             char** argv,
             const std::string& preset_name = "",
             const std::function<void(const std::string&)>& apply_preset = {});

  // Whether ini file or command line set the option.
  bool IsSet(const std::string& name) const;

  // All effective options as an ini file that --project_path takes. Throws
  // OutputError.
  void Write(const std::string& path) const;

  // The same as a JSON object by full name.
  nlohmann::ordered_json ToJson() const;

 private:
  struct Option {
    std::string name;
    std::string help;
    std::string group;
    std::string* required = nullptr;
    std::function<void(host::OptionManager*)> add;
    std::function<std::string()> value;
    std::function<nlohmann::ordered_json()> json;
  };

  std::string CommandName() const;
  void PrintHelp(std::ostream& stream) const;
  host::LogOptions ParsePass(const std::vector<std::string>& arguments) const;
  std::vector<std::string> ReadIni(const std::string& path) const;
  void CheckName(const std::string& argument) const;
  void CheckValues(const std::vector<std::string>& arguments) const;
  void CheckForeignKey(const std::string& key, const std::string& where) const;
  std::string DidYouMean(const std::string& name) const;
  const Option* Find(const std::string& name) const;

  std::string description_;
  std::string example_;
  std::string group_ = "Paths";
  std::vector<Option> options_;
  std::vector<std::string> set_names_;
  std::vector<std::string> shared_sections_;
};

}  // namespace mfir

#include "colmap_ext/options/option_parser.h"

#include <strings.h>

#include <algorithm>
#include <cctype>
#include <cstdlib>
#include <fstream>
#include <iomanip>
#include <iostream>
#include <limits>
#include <sstream>

#include <boost/program_options.hpp>

#include "colmap_ext/host/options.h"
#include "colmap_ext/io/input_file.h"
#include "colmap_ext/options/log_file.h"
#include "src/util/edit_distance.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

namespace po = boost::program_options;

std::string Section(const std::string& name) {
  const size_t dot = name.find('.');
  return dot == std::string::npos ? "" : name.substr(0, dot);
}

std::string Trimmed(const std::string& text) {
  const char* const kSpace = " \t\r\n\v\f";
  const size_t begin = text.find_first_not_of(kSpace);
  return begin == std::string::npos
             ? ""
             : text.substr(begin, text.find_last_not_of(kSpace) + 1 - begin);
}

// A '#' begins a comment only at the beginning of a word and outside of a
// quoted value: paths and regular expressions may contain others.
std::string WithoutComment(const std::string& line) {
  if (line.find("=\"") != std::string::npos && Trimmed(line)[0] != '#') {
    return line;
  }
  for (size_t i = 0; i < line.size(); ++i) {
    if (line[i] == '#' && (i == 0 || std::isspace(line[i - 1]))) {
      return line.substr(0, i);
    }
  }
  return line;
}

// A value with a '#' is written in double quotes.
std::string Quote(const std::string& value) {
  return value.find('#') == std::string::npos ? value : "\"" + value + "\"";
}

std::string Unquote(const std::string& value) {
  const bool quoted = value.size() >= 2 && value.front() == '"' &&
                      value.back() == '"' &&
                      value.find('#') != std::string::npos;
  return quoted ? value.substr(1, value.size() - 2) : value;
}

struct IniEntry {
  std::string key;  // "name" or "Section.name"
  std::string value;
  std::string where;  // "PATH:LINE: ", for messages
};

// Boost's reader of ini files, which COLMAP uses, knows no line numbers, cuts
// values at any '#' and takes [ MultiFrame ] for another section than
// [MultiFrame].
std::vector<IniEntry> ParseIni(const std::string& path) {
  std::istringstream file;
  try {
    file.str(ReadTextFile(path));
  } catch (const InputError& error) {
    throw UsageError(std::string("--project_path ") + error.what());
  }
  std::vector<IniEntry> entries;
  std::string section;
  std::string line;
  for (int number = 1; std::getline(file, line); ++number) {
    line = Trimmed(WithoutComment(line));
    const std::string where = path + ":" + std::to_string(number) + ": ";
    const size_t equals = line.find('=');
    if (line.empty()) continue;
    // COLMAP's parser would see the text before it only.
    if (line.find('\0') != std::string::npos) {
      throw UsageError(where +
                       "has a NUL character. Save the file as UTF-8 text.");
    }
    if (line.front() == '[' && line.back() == ']') {
      section = Trimmed(line.substr(1, line.size() - 2));
    } else if (line.front() == '[' || equals == std::string::npos ||
               equals == 0) {
      throw UsageError(where + "'" + line.substr(0, 60) +
                       "' is neither name=value nor a [section]. Correct the "
                       "line.");
    } else {
      entries.push_back({(section.empty() ? "" : section + ".") +
                             Trimmed(line.substr(0, equals)),
                         Unquote(Trimmed(line.substr(equals + 1))),
                         where});
    }
  }
  return entries;
}

// Names without a section that COLMAP's commands and ours take, found in their
// sources by CMake, and those that all commands of another version take: ini
// files outlive versions.
bool IsOptionOfAnotherCommand(const std::string& name) {
  static const char* const kNames[] = {
#include <option_names.inc>
      "default_random_seed",
      "log_color",
      "log_level",
      "log_path",
      "log_severity",
      "log_target",
      "log_to_stderr",
      "random_seed",
  };
  return std::find(std::begin(kNames), std::end(kNames), name) !=
         std::end(kNames);
}

template <typename T>
std::string ToString(const T& value) {
  std::ostringstream stream;
  // Shortest digits that read back to the same double.
  for (int digits = 6; digits <= std::numeric_limits<double>::max_digits10;
       ++digits) {
    stream.str("");
    stream << std::setprecision(digits) << value;
    T read_back{};
    if (std::istringstream(stream.str()) >> read_back && read_back == value) {
      break;
    }
  }
  return stream.str();
}

std::string ToString(const std::string& value) { return value; }

// Of COLMAP's log and random numbers: all our commands take them.
bool IsCommonOption(const std::string& name) {
  const std::vector<std::string>& names = host::CommonOptionNames();
  return name != "help" && name != "project_path" &&
         std::find(names.begin(), names.end(), name) != names.end();
}

// Of "--name=value" or "--name".
std::string ArgumentName(const std::string& argument) {
  return argument.rfind("--", 0) == 0
             ? argument.substr(2, argument.find('=') - 2)
             : "";
}

// The command line, and first what only the ini file sets of the common
// options: COLMAP resets these whenever it parses.
std::vector<std::string> WithCommonOptions(
    const std::vector<std::string>& ini_arguments,
    const std::vector<std::string>& command_line) {
  std::vector<std::string> arguments;
  for (const std::string& argument : ini_arguments) {
    const std::string name = ArgumentName(argument);
    if (IsCommonOption(name) && std::none_of(command_line.begin(),
                                             command_line.end(),
                                             [&name](const std::string& other) {
                                               return ArgumentName(other) ==
                                                      name;
                                             })) {
      arguments.push_back(argument);
    }
  }
  arguments.insert(arguments.end(), command_line.begin(), command_line.end());
  return arguments;
}

std::string DefaultText(const std::string& value) {
  return value.empty() ? "default: none" : "default: " + value;
}

}  // namespace

template <typename T>
void OptionParser::Add(const std::string& name,
                       T* value,
                       const std::string& help) {
  Option option;
  option.name = name;
  option.help = help;
  option.group = group_;
  option.add = [name, value, help](host::OptionManager* manager) {
    manager->AddDefaultOption(name, value, help);
  };
  option.value = [value]() { return ToString(*value); };
  option.json = [value]() { return nlohmann::ordered_json(*value); };
  options_.push_back(std::move(option));
}

template void OptionParser::Add(const std::string&, bool*, const std::string&);
template void OptionParser::Add(const std::string&, int*, const std::string&);
template void OptionParser::Add(const std::string&,
                                double*,
                                const std::string&);
template void OptionParser::Add(const std::string&,
                                std::string*,
                                const std::string&);

void OptionParser::AddRequired(const std::string& name,
                               std::string* value,
                               const std::string& help) {
  Add(name, value, help + " (required)");
  options_.back().required = value;
}

void OptionParser::Parse(
    int argc,
    char** argv,
    const std::string& preset_name,
    const std::function<void(const std::string&)>& apply_preset) {
  const std::vector<std::string> command_line(argv + 1, argv + argc);
  if (std::any_of(command_line.begin(),
                  command_line.end(),
                  [](const std::string& argument) {
                    return argument == "--help" || argument == "-h";
                  })) {
    PrintHelp(std::cout);
    std::exit(kExitSuccess);
  }

  po::options_description project_options;
  std::string project_path;
  std::string preset;
  project_options.add_options()("project_path",
                                po::value<std::string>(&project_path));
  if (!preset_name.empty()) {
    project_options.add_options()(preset_name.c_str(),
                                  po::value<std::string>(&preset));
  }
  try {
    po::variables_map map;
    // No guessing of abbreviated names: "--MultiFrame.foo" must not match
    // "--MultiFrame.foo_bar" while that is not registered here.
    const int style = po::command_line_style::default_style &
                      ~po::command_line_style::allow_guessing;
    po::store(po::command_line_parser(command_line)
                  .options(project_options)
                  .style(style)
                  .allow_unregistered()
                  .run(),
              map);
    map.notify();
  } catch (const po::error& error) {
    throw UsageError(std::string(error.what()) + ". See --help.");
  }

  std::vector<std::string> ini_arguments;
  if (!project_path.empty()) {
    ini_arguments = ReadIni(project_path);
  }
  if (preset.empty() && !preset_name.empty()) {
    const std::string prefix = "--" + preset_name + "=";
    for (const std::string& argument : ini_arguments) {
      if (argument.rfind(prefix, 0) == 0) {
        preset = argument.substr(prefix.size());
      }
    }
  }
  if (!preset.empty()) {
    apply_preset(preset);
  }

  // Each pass starts from the values the one before has set.
  set_names_.clear();
  ParsePass(ini_arguments);
  BeginLogFile(ParsePass(WithCommonOptions(ini_arguments, command_line)),
               CommandName(),
               command_line);
  ini_arguments.insert(
      ini_arguments.end(), command_line.begin(), command_line.end());
  for (const std::string& argument : ini_arguments) {
    const std::string name = ArgumentName(argument);
    if (!name.empty()) set_names_.push_back(name);
  }
  for (const Option& option : options_) {
    if (option.required != nullptr && option.required->empty()) {
      throw UsageError("The option --" + option.name +
                       " is required. See --help.");
    }
  }
}

// COLMAP calls commands with its own name in place of theirs.
std::string OptionParser::CommandName() const {
  std::istringstream words(example_);
  std::string name;
  words >> name >> name;
  return name;
}

void OptionParser::PrintHelp(std::ostream& stream) const {
  constexpr size_t kColumn = 34;
  constexpr size_t kWidth = 100;
  stream << description_ << "\n\nExample:\n  " << example_ << "\n";
  const std::string* group = nullptr;
  for (const Option& option : options_) {
    if (group == nullptr || *group != option.group) {
      stream << "\n" << option.group << ":\n";
      group = &option.group;
    }
    std::string line = "  --" + option.name;
    line.resize(std::max(line.size() + 2, kColumn), ' ');
    std::istringstream words(option.help +
                             (option.required != nullptr
                                  ? ""
                                  : " (" + DefaultText(option.value()) + ")"));
    std::string word;
    while (words >> word) {
      if (line.size() + word.size() > kWidth) {
        stream << line << "\n";
        line.assign(kColumn, ' ');
      }
      line += word + " ";
    }
    stream << line << "\n";
  }
  stream << "\nFurther:\n  --project_path FILE               ini file with "
            "options; the command line wins\n  --help                        "
            "    this text\n"
            "  --log_path DIR                  also write what is printed to a "
            "file in DIR\n  --log_target file               and warnings and "
            "errors alone to the terminal\n";
}

host::LogOptions OptionParser::ParsePass(
    const std::vector<std::string>& arguments) const {
  host::OptionManager manager;
  for (const Option& option : options_) {
    option.add(&manager);
  }
  std::vector<std::string> filtered;
  for (size_t i = 0; i < arguments.size(); ++i) {
    const bool is_value = i > 0 && arguments[i - 1].rfind("--", 0) == 0 &&
                          arguments[i - 1].find('=') == std::string::npos &&
                          arguments[i - 1] != "--help";
    if (!is_value) CheckName(arguments[i]);
    // Boost takes an empty value, of an unset variable in a script, for 1.
    if (is_value && arguments[i].empty()) {
      const Option* option = Find(arguments[i - 1].substr(2));
      if (option != nullptr && option->json().is_boolean()) {
        throw UsageError(arguments[i - 1] +
                         " has an empty value. Give 0 or 1.");
      }
    }
    // OptionManager would read the file itself and drop the command line.
    if (arguments[i] == "--project_path") {
      ++i;
    } else if (arguments[i].rfind("--project_path=", 0) != 0) {
      filtered.push_back(arguments[i]);
    }
  }
  CheckValues(filtered);
  return host::ParseOptions(filtered, &manager);
}

// COLMAP ends the program at a value that is not of the option's type.
void OptionParser::CheckValues(
    const std::vector<std::string>& arguments) const {
  po::options_description description;
  description.add_options()("random_seed", po::value<unsigned>())(
      "log_to_stderr", po::value<bool>())("log_level", po::value<int>());
  for (const Option& option : options_) {
    const nlohmann::ordered_json value = option.json();
    const char* const name = option.name.c_str();
    if (value.is_boolean()) {
      description.add_options()(name, po::value<bool>());
    } else if (value.is_number_integer()) {
      description.add_options()(name, po::value<int>());
    } else if (value.is_number()) {
      description.add_options()(name, po::value<double>());
    } else {
      description.add_options()(name, po::value<std::string>());
    }
  }
  // Boost's messages never end where a value has their placeholders
  // ("%value%").
  std::vector<std::string> spaced = arguments;
  for (std::string& argument : spaced) {
    for (size_t i = 0; (i = argument.find('%', i)) != std::string::npos;
         i += 2) {
      argument.insert(i + 1, " ");
    }
  }
  try {
    po::variables_map map;
    po::store(po::command_line_parser(spaced)
                  .options(description)
                  .allow_unregistered()
                  .run(),
              map);
  } catch (const po::error& error) {
    throw UsageError(std::string("Failed to parse options - ") + error.what() +
                     ". See --help.");
  }
}

// OptionManager accepts any unambiguous beginning of a name; a typo must not
// set another option.
void OptionParser::CheckName(const std::string& argument) const {
  if (argument == "-h") return;
  if (argument.rfind("--", 0) != 0) {
    throw UsageError("'" + argument +
                     "' is no option. Options are given as --name value.");
  }
  const std::string name = ArgumentName(argument);
  const std::vector<std::string>& common = host::CommonOptionNames();
  if (std::find(common.begin(), common.end(), name) != common.end()) return;
  if (Find(name) == nullptr) {
    const std::string place = host::PlaceOfOption(name);
    if (!place.empty()) throw UsageError(place);
    throw UsageError("There is no option --" + name + "." + DidYouMean(name) +
                     " See --help.");
  }
}

std::string OptionParser::DidYouMean(const std::string& name) const {
  const Option* nearest = nullptr;
  for (const Option& option : options_) {
    if (Section(option.name) == Section(name) &&
        (nearest == nullptr ||
         EditDistance(option.name, name) < EditDistance(nearest->name, name))) {
      nearest = &option;
    }
  }
  return nearest == nullptr ? "" : " Did you mean '" + nearest->name + "'?";
}

std::vector<std::string> OptionParser::ReadIni(const std::string& path) const {
  std::vector<std::string> arguments;
  std::vector<std::string> seen;
  for (const IniEntry& entry : ParseIni(path)) {
    if (Find(entry.key) == nullptr && !IsCommonOption(entry.key)) {
      CheckForeignKey(entry.key, entry.where);
      continue;
    }
    if (std::find(seen.begin(), seen.end(), entry.key) != seen.end()) {
      throw UsageError(entry.where + "'" + entry.key + "' is set twice.");
    }
    seen.push_back(entry.key);
    // An empty value, as Write leaves it for an unset path, is the default.
    if (entry.value.empty()) continue;
    arguments.push_back("--" + entry.key + "=" + entry.value);
  }
  return arguments;
}

// Throws unless `key`, which is none of ours, belongs to another command.
void OptionParser::CheckForeignKey(const std::string& key,
                                   const std::string& where) const {
  const std::string section = Section(key);
  bool own_section = section.empty();
  for (const Option& option : options_) {
    const std::string own = Section(option.name);
    own_section = own_section || own == section;
    if (own != section && strcasecmp(own.c_str(), section.c_str()) == 0) {
      throw UsageError(where + "the section [" + section + "] must be [" + own +
                       "].");
    }
  }
  const bool shared =
      std::find(shared_sections_.begin(), shared_sections_.end(), section) !=
      shared_sections_.end();
  const bool foreign =
      section.empty() ? IsOptionOfAnotherCommand(key) : !own_section || shared;
  if (!foreign) {
    throw UsageError(where + "there is no option '" + key + "'." +
                     DidYouMean(key));
  }
}

const OptionParser::Option* OptionParser::Find(const std::string& name) const {
  for (const Option& option : options_) {
    if (option.name == name) {
      return &option;
    }
  }
  return nullptr;
}

bool OptionParser::IsSet(const std::string& name) const {
  return std::find(set_names_.begin(), set_names_.end(), name) !=
         set_names_.end();
}

void OptionParser::Write(const std::string& path) const {
  std::ofstream file(path);
  // Options without a section must come first in an ini file.
  std::string section;
  for (const bool sectioned : {false, true}) {
    for (const Option& option : options_) {
      if (Section(option.name).empty() == sectioned) continue;
      if (Section(option.name) != section) {
        section = Section(option.name);
        file << "[" << section << "]\n";
      }
      file << option.name.substr(section.empty() ? 0 : section.size() + 1)
           << "=" << Quote(option.value()) << "\n";
    }
  }
  file.close();
  if (!file) {
    throw OutputError(path + ": cannot write the file. Is the disk full?");
  }
}

nlohmann::ordered_json OptionParser::ToJson() const {
  nlohmann::ordered_json json = nlohmann::ordered_json::object();
  for (const Option& option : options_) {
    json[option.name] = option.json();
  }
  return json;
}

}  // namespace mfir

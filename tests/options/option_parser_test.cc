#include "colmap_ext/options/option_parser.h"

#include <cmath>
#include <limits>
#include <utility>

#include <glog/logging.h>
#include <gtest/gtest.h>

#include "colmap_ext/host/util.h"
#include "tests/support/test_files.h"

namespace mfir {
namespace {

// A command with options of every type.
struct Command {
  std::string input_path;
  std::string image_path;
  double offset = std::numeric_limits<double>::quiet_NaN();
  std::string preset = "accurate";
  double loss_scale = 0.25;
  double max_weight = 1e6;
  int num_threads = -1;
  bool progressive = true;
  std::string regex;
  OptionParser parser;

  explicit Command(bool required = false) {
    if (required) {
      parser.AddRequired("input_path", &input_path, "folder");
    } else {
      parser.Add("input_path", &input_path, "folder");
    }
    parser.Add("image_path", &image_path, "images");
    parser.Add("offset", &offset, "px");
    parser.Add("MultiFrame.preset", &preset, "");
    parser.Add("MultiFrame.loss_scale", &loss_scale, "");
    parser.Add("MultiFrame.max_weight", &max_weight, "");
    parser.Add("MultiFrame.num_threads", &num_threads, "");
    parser.Add("MultiFrame.progressive", &progressive, "");
    parser.Add("MultiFrame.regex", &regex, "");
  }

  void Parse(std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), "colmap");
    std::vector<char*> argv;
    for (std::string& argument : arguments) argv.push_back(argument.data());
    parser.Parse(static_cast<int>(argv.size()),
                 argv.data(),
                 "MultiFrame.preset",
                 [this](const std::string& name) {
                   if (name != "paper" && name != "accurate") {
                     throw UsageError("preset " + name);
                   }
                   loss_scale = name == "paper" ? 0.25 : 0.0;
                   max_weight = name == "paper" ? 1e6 : 0.0;
                 });
  }
};

class OptionParserTest : public testing::Test {
 protected:
  // Arguments for an ini file with the given content.
  std::vector<std::string> Ini(const std::string& content) {
    WriteFile(path_, content);
    return {"--project_path", path_};
  }

  void ExpectUsageError(const std::vector<std::string>& arguments,
                        const std::vector<std::string>& parts,
                        bool required = false) {
    Command command(required);
    try {
      command.Parse(arguments);
      ADD_FAILURE() << "no error, expected " << testing::PrintToString(parts);
    } catch (const UsageError& error) {
      for (const std::string& part : parts) {
        EXPECT_NE(std::string(error.what()).find(part), std::string::npos)
            << "'" << part << "' is not in: " << error.what();
      }
    }
  }

  const TemporaryFolder folder_;
  const std::string path_ = folder_ / "project.ini";
};

TEST_F(OptionParserTest, DefaultsStayWithoutArguments) {
  Command command;
  command.Parse({});
  EXPECT_EQ(command.loss_scale, 0.25);
  EXPECT_EQ(command.num_threads, -1);
  EXPECT_TRUE(command.progressive);
  EXPECT_TRUE(std::isnan(command.offset));
  EXPECT_FALSE(command.parser.IsSet("MultiFrame.loss_scale"));
}

TEST_F(OptionParserTest, ReadsEveryTypeInBothSpellings) {
  for (const bool equals : {false, true}) {
    Command command;
    std::vector<std::string> arguments;
    const auto add = [&](const std::string& name, const std::string& value) {
      if (equals) {
        arguments.push_back("--" + name + "=" + value);
      } else {
        arguments.push_back("--" + name);
        arguments.push_back(value);
      }
    };
    add("input_path", "a folder/with = sign");
    add("offset", "-0.5");
    add("MultiFrame.loss_scale", "1e-3");
    add("MultiFrame.num_threads", "-1");
    add("MultiFrame.progressive", "0");
    add("MultiFrame.regex", "cam(\\d+)=");
    command.Parse(arguments);
    EXPECT_EQ(command.input_path, "a folder/with = sign");
    EXPECT_EQ(command.offset, -0.5);
    EXPECT_EQ(command.loss_scale, 1e-3);
    EXPECT_EQ(command.num_threads, -1);
    EXPECT_FALSE(command.progressive);
    EXPECT_EQ(command.regex, "cam(\\d+)=");
    EXPECT_TRUE(command.parser.IsSet("MultiFrame.loss_scale"));
    EXPECT_TRUE(command.parser.IsSet("input_path"));
    EXPECT_FALSE(command.parser.IsSet("MultiFrame.max_weight"));
  }
}

// Boost reads it as 1.
TEST_F(OptionParserTest, EmptyValuesOfSwitchesAreErrors) {
  ExpectUsageError({"--MultiFrame.progressive", ""}, {"progressive", "empty"});
}

TEST_F(OptionParserTest, CommandLineBeatsIniBeatsPreset) {
  const std::string ini = "[MultiFrame]\npreset=accurate\nloss_scale=3\n";
  Command from_ini;
  from_ini.Parse(Ini(ini));
  EXPECT_EQ(from_ini.loss_scale, 3.0);  // ini
  EXPECT_EQ(from_ini.max_weight, 0.0);  // preset of the ini
  EXPECT_TRUE(from_ini.parser.IsSet("MultiFrame.loss_scale"));
  EXPECT_FALSE(from_ini.parser.IsSet("MultiFrame.max_weight"));

  Command from_both;
  std::vector<std::string> arguments = Ini(ini);
  arguments.insert(arguments.begin(), {"--MultiFrame.max_weight", "7"});
  arguments.push_back("--MultiFrame.loss_scale=4");
  from_both.Parse(arguments);
  EXPECT_EQ(from_both.loss_scale, 4.0);
  EXPECT_EQ(from_both.max_weight, 7.0);

  // The command line's preset replaces the ini's, whose other options stay.
  Command preset;
  arguments = Ini(ini);
  arguments.push_back("--MultiFrame.preset=paper");
  preset.Parse(arguments);
  EXPECT_EQ(preset.preset, "paper");
  EXPECT_EQ(preset.loss_scale, 3.0);
  EXPECT_EQ(preset.max_weight, 1e6);

  Command spelled_apart;
  spelled_apart.Parse(
      {"--MultiFrame.loss_scale", "9", "--MultiFrame.preset", "accurate"});
  EXPECT_EQ(spelled_apart.loss_scale, 9.0);
  EXPECT_EQ(spelled_apart.max_weight, 0.0);
}

// COLMAP resets its own options whenever it parses.
TEST_F(OptionParserTest, OptionsOfTheLogMayBeInTheIniFile) {
  Command command;
  command.Parse(Ini("log_level=2\n"));
  EXPECT_EQ(FLAGS_v, 2);
  std::vector<std::string> arguments = Ini("log_level=2\n");
  arguments.push_back("--log_level=1");
  command.Parse(arguments);
  EXPECT_EQ(FLAGS_v, 1);
  command.Parse({});
  EXPECT_EQ(FLAGS_v, 0);
}

TEST_F(OptionParserTest, OptionsOfAnotherVersionNameTheirPlace) {
  const bool is_colmap4 = host::VersionInfo().find("COLMAP 4") == 0;
  const std::vector<std::pair<std::string, std::string>> pairs = {
      {"--random_seed", "--default_random_seed"},
      {"--SiftExtraction.use_gpu", "--FeatureExtraction.use_gpu"}};
  for (const auto& [in_3, in_4] : pairs) {
    ExpectUsageError({(is_colmap4 ? in_3 : in_4) + "=1"},
                     {is_colmap4 ? in_3 : in_4,
                      is_colmap4 ? "COLMAP 3.8;" : "COLMAP 4;",
                      "which has " + (is_colmap4 ? in_4 : in_3)});
  }
}

TEST_F(OptionParserTest, ForeignSectionsAreSkipped) {
  Command command;
  command.Parse(
      Ini("database_path=x.db\nlog_level=2\n"
          "[SiftExtraction]\nloss_scale=5\nmax_num_features=100\n"
          "[MultiFrame]\nloss_scale=6\n"
          "[Mapper]\nba_refine_focal_length=1\n"));
  EXPECT_EQ(command.loss_scale, 6.0);
}

TEST_F(OptionParserTest, TypoInOwnSectionNamesLineAndSuggestion) {
  ExpectUsageError(Ini("input_path=x\n\n[MultiFrame]\n# comment\n"
                       "los_scale = 5\n"),
                   {path_ + ":5:",
                    "MultiFrame.los_scale",
                    "Did you mean 'MultiFrame.loss_scale'?"});
}

TEST_F(OptionParserTest, SectionsMayHaveSpacesInTheirBrackets) {
  Command command;
  command.Parse(Ini("\xef\xbb\xbf[ MultiFrame ] # ours\nloss_scale=6\n"));
  EXPECT_EQ(command.loss_scale, 6.0);
  ExpectUsageError(Ini("\n[ MultiFrame ]\nlos_scale=6\n"),
                   {path_ + ":3:", "'MultiFrame.loss_scale'"});
}

TEST_F(OptionParserTest, SectionInTheWrongCaseNamesLine) {
  ExpectUsageError(Ini("\n[ multiframe ]\nloss scale = 6\n"),
                   {path_ + ":3:", "[multiframe]", "must be [MultiFrame]"});
}

TEST_F(OptionParserTest, TypoBeforeTheFirstSectionNamesLineAndSuggestion) {
  ExpectUsageError(Ini("\ninput_pth = x\n"),
                   {path_ + ":2:", "'input_pth'", "'input_path'"});
  // What COLMAP's commands and our other ones take.
  Command command;
  command.Parse(
      Ini("database_path=x\nlog_to_stderr=0\nimage_list_path=x\n"
          "vocab_tree_path=x\nground_truth_pixel_offset=0\n"));
}

TEST_F(OptionParserTest, LineThatIsNoOptionIsNamed) {
  for (const char* line : {"nonsense", "=5", "[MultiFrame", "[MultiFrame]x"}) {
    ExpectUsageError(Ini(std::string("# first\n") + line + "\n"),
                     {path_ + ":2:", line});
  }
}

TEST_F(OptionParserTest, TypoOnCommandLineNamesSuggestion) {
  ExpectUsageError(
      {"--MultiFrame.num_thread", "2"},
      {"--MultiFrame.num_thread", "Did you mean 'MultiFrame.num_threads'?"});
  ExpectUsageError({"--inputpath=x"}, {"--inputpath", "'input_path'"});
}

TEST_F(OptionParserTest, DuplicateKeyInIniIsAnError) {
  ExpectUsageError(Ini("[MultiFrame]\nloss_scale=1\nloss_scale=2\n"),
                   {path_, "MultiFrame.loss_scale", "twice"});
}

TEST_F(OptionParserTest, IniMayHaveCommentsBlanksAndWindowsLineEnds) {
  Command command;
  command.Parse(
      Ini("# first\r\ninput_path = /tmp/a b \r\n\r\n"
          "[MultiFrame]\r\n  loss_scale = 2.5  # px\r\n"
          "progressive=0\r\n"));
  EXPECT_EQ(command.input_path, "/tmp/a b");
  EXPECT_EQ(command.loss_scale, 2.5);
  EXPECT_FALSE(command.progressive);
}

TEST_F(OptionParserTest, IniMayHaveInvisibleCharacters) {
  Command command;
  command.Parse(
      Ini(WithInvisibles("input_path=/tmp/a\n[MultiFrame]\nloss_scale=2.5\n")));
  EXPECT_EQ(command.input_path, "/tmp/a");
  EXPECT_EQ(command.loss_scale, 2.5);
}

TEST_F(OptionParserTest, TypoIsFoundInWindowsIni) {
  ExpectUsageError(Ini("[MultiFrame]\r\nloss_scal = 5\r\n"),
                   {path_ + ":2:", "'MultiFrame.loss_scale'"});
}

TEST_F(OptionParserTest, MissingOrMalformedIniIsAnError) {
  ExpectUsageError({"--project_path", folder_ / "none.ini"},
                   {folder_ / "none.ini"});
  ExpectUsageError(Ini("[MultiFrame]\nloss_scale\n"), {path_});
  ExpectUsageError(Ini(std::string("\ninput_path=\0x\n", 15)),
                   {path_ + ":2:", "NUL"});
}

TEST_F(OptionParserTest, ErrorsOfValuesWithPlaceholdersEnd) {
  ExpectUsageError(Ini("[MultiFrame]\nloss_scale=3%value%\n"),
                   {"'--MultiFrame.loss_scale'", "3% value% "});
}

TEST_F(OptionParserTest, AbbreviationsAreRefused) {
  ExpectUsageError({"--MultiFrame.loss", "1"}, {"--MultiFrame.loss"});
  ExpectUsageError({"--input", "x"}, {"--input"});
  ExpectUsageError({"--MultiFrame.pre=paper"}, {"--MultiFrame.pre"});
  ExpectUsageError({"--project", path_}, {"--project"});
}

TEST_F(OptionParserTest, RequiredOptionMayComeFromTheIniOnly) {
  Command command(true);
  command.Parse(Ini("input_path=frames\n"));
  EXPECT_EQ(command.input_path, "frames");
  ExpectUsageError({}, {"--input_path", "required"}, true);
  ExpectUsageError(Ini("[MultiFrame]\nloss_scale=1\n"), {"--input_path"}, true);
}

TEST_F(OptionParserTest, UnreadableValuesAreErrors) {
  // A forked program would wait for the threads of COLMAP 4's libraries.
  testing::FLAGS_gtest_death_test_style = "threadsafe";
  for (const char* argument : {"--MultiFrame.loss_scale=abc",
                               "--MultiFrame.num_threads=1.5",
                               "--MultiFrame.num_threads=99999999999",
                               "--MultiFrame.progressive=7x"}) {
    EXPECT_EXIT(
        {
          try {
            Command().Parse({argument});
          } catch (const UsageError& error) {
            std::cerr << error.what();
            std::exit(kExitUsage);
          }
          std::exit(0);
        },
        testing::ExitedWithCode(kExitUsage),
        std::string(argument).substr(2, std::string(argument).find('=') - 2))
        << argument;
  }
}

TEST_F(OptionParserTest, UnknownPresetIsAnError) {
  ExpectUsageError({"--MultiFrame.preset=fast"}, {"fast"});
  ExpectUsageError(Ini("[MultiFrame]\npreset=fast\n"), {"fast"});
}

// What Write has written gives the same values again.
void ExpectRoundTrip(const Command& written, const std::string& path) {
  testing::FLAGS_gtest_death_test_style = "threadsafe";
  written.parser.Write(path);
  // COLMAP's parser ends the program where it does not understand a line.
  EXPECT_EXIT(
      {
        Command().Parse({"--project_path", path});
        std::exit(0);
      },
      testing::ExitedWithCode(0),
      "");
  if (testing::Test::HasFailure()) return;
  Command read;
  read.Parse({"--project_path", path});
  EXPECT_EQ(read.input_path, written.input_path);
  EXPECT_EQ(read.image_path, written.image_path);
  EXPECT_EQ(read.preset, written.preset);
  EXPECT_EQ(read.loss_scale, written.loss_scale);
  EXPECT_EQ(read.max_weight, written.max_weight);
  EXPECT_EQ(read.num_threads, written.num_threads);
  EXPECT_EQ(read.progressive, written.progressive);
  EXPECT_EQ(read.regex, written.regex);
  EXPECT_TRUE(read.offset == written.offset ||
              (std::isnan(read.offset) && std::isnan(written.offset)));
  EXPECT_EQ(read.parser.ToJson().dump(), written.parser.ToJson().dump());
}

TEST_F(OptionParserTest, WrittenDefaultsReadBack) {
  // Empty strings and a nan among them.
  ExpectRoundTrip(Command(), path_);
}

TEST_F(OptionParserTest, WrittenDoublesReadBackExactly) {
  for (const double value : {0.1 + 0.2,
                             1.0 / 3.0,
                             1e-300,
                             5e-324,
                             1.7e308,
                             -0.0,
                             123456789.123456789,
                             M_PI,
                             1e6}) {
    Command command;
    command.loss_scale = value;
    command.max_weight = -value;
    command.offset = value;
    command.num_threads = 17;
    command.progressive = false;
    ExpectRoundTrip(command, path_);
  }
}

TEST_F(OptionParserTest, WrittenStringsReadBack) {
  for (const char* value : {"/tmp/a folder/x",
                            "camera(\\d+)_frame\\d+",
                            "a=b",
                            "[x]",
                            "quoted \"text\"",
                            "--dashes",
                            "\xc3\xa4\xc3\xb6"}) {
    SCOPED_TRACE(value);
    Command command;
    command.input_path = value;
    command.regex = value;
    ExpectRoundTrip(command, path_);
  }
}

// '#' begins a comment in an ini file.
TEST_F(OptionParserTest, StringsThatAnIniCannotHoldAreNotCutSilently) {
  for (const char* value : {"cam#(\\d+)", "/data/#1/frames"}) {
    SCOPED_TRACE(value);
    Command command;
    command.regex = value;
    bool refused = false;
    try {
      command.parser.Write(path_);
    } catch (const Error&) {
      refused = true;
    }
    if (refused) continue;
    Command read;
    read.Parse({"--project_path", path_});
    EXPECT_EQ(read.regex, value);
  }
}

TEST_F(OptionParserTest, WriteNamesTheFileItCannotWrite) {
  const std::string path = folder_ / "none/project.ini";
  try {
    Command().parser.Write(path);
    FAIL();
  } catch (const OutputError& error) {
    EXPECT_NE(std::string(error.what()).find(path), std::string::npos);
  }
}

TEST_F(OptionParserTest, JsonHasTypedValuesByFullName) {
  Command command;
  command.Parse({"--MultiFrame.loss_scale", "2", "--input_path", "x"});
  const nlohmann::ordered_json json = command.parser.ToJson();
  EXPECT_EQ(json["input_path"], "x");
  EXPECT_EQ(json["MultiFrame.loss_scale"], 2.0);
  EXPECT_EQ(json["MultiFrame.num_threads"], -1);
  EXPECT_EQ(json["MultiFrame.progressive"], true);
  EXPECT_EQ(json.size(), 9u);
}

}  // namespace
}  // namespace mfir

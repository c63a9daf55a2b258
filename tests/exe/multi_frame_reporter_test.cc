// multi_frame_reporter and the report of every refinement.

#include "colmap_ext/io/work_folder.h"
#include "src/report/html.h"
#include "tests/support/browser.h"
#include "tests/support/refiner_runner.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

class ReporterTest : public RefinerReferenceTest {
 protected:
  CommandResult Report(const std::vector<std::string>& arguments) const {
    std::vector<std::string> all = {"multi_frame_reporter"};
    all.insert(all.end(), arguments.begin(), arguments.end());
    return RunColmap(all);
  }

  // Names with everything that means something in HTML and JavaScript.
  static std::string NastyName(const std::string& name) {
    return "\"<u>'&amp;" + name.substr(0, name.find('.')) +
           "</script><xmp>\xc3\xa4\xe5\xb7\xa6.png";
  }

  void RenameToNastyNames() const {
    // No slash in a file's name.
    const auto rename = [](const std::string& name) {
      std::string nasty = NastyName(name);
      nasty.erase(nasty.find('/'), 1);
      return nasty;
    };
    ChangeFrames(
        [&](host::Reconstruction* frame) { RenameImages(rename, frame); });
    ChangeRig([&](host::Reconstruction* rig) { RenameImages(rename, rig); });
    fs::rename(Path("frames/frame000001"),
               Path("frames/<u>\"fr\xc3\xa4me'&lt;"));
  }

  // The page with the checks of report_checks.js, opened in the browser.
  void ExpectGoodPage(const std::string& page_path,
                      const std::string& output,
                      int width) const {
    std::string page = ReadFile(page_path);
    const auto summary =
        nlohmann::ordered_json::parse(ReadFile(Path(output + "/summary.json")));
    page = Replaced(page,
                    "<head>",
                    "<head><script>window.checkErrors = [];"
                    "window.onerror = function (m) { checkErrors.push(m); };"
                    "console.error = window.onerror;</script>");
    page = Replaced(page,
                    "</body>",
                    "<script>window.checkSummary = " + ScriptJson(summary) +
                        ";</script><script>" +
                        ReadFile(std::string(MFIR_SOURCE_DIR) +
                                 "/tests/exe/report_checks.js") +
                        "</script></body>");
    WriteFile(Path("checked.html"), page);
    // The window of a browser is not as narrow as a phone, but a frame may be.
    WriteFile(
        Path("window.html"),
        "<body><iframe src=\"checked.html\" style=\"border:0;height:844px;"
        "width:" +
            std::to_string(width) +
            "px\"></iframe><script>"
            "addEventListener('message', function (event) {"
            "document.body.innerHTML = event.data; });</script></body>");
    const std::string document =
        OpenPage(Path("window.html"), std::max(width, 500), 900);
    const size_t begin = document.find("<pre id=\"check-result\">");
    ASSERT_NE(begin, std::string::npos) << document.substr(0, 2000);
    const std::string answer =
        document.substr(begin, document.find("</pre>", begin) - begin);
    EXPECT_NE(answer.find("problems: none"), std::string::npos) << answer;
  }
};

TEST_F(ReporterTest, EveryRefinementWritesOne) {
  const std::string page = ReadFile(Path("reference/report.html"));
  EXPECT_EQ(page.rfind("<!DOCTYPE html>", 0), 0);
  EXPECT_EQ(page.find("http"), std::string::npos);
  EXPECT_LT(page.size(), 1000000);
  ExpectRefines({{"MultiFrame.report", "0"}});
  EXPECT_FALSE(fs::exists(Path("out/report.html")));
}

TEST_F(ReporterTest, WritesTheSamePageAgain) {
  const std::string page = ReadFile(Path("reference/report.html"));
  fs::remove(Path("reference/report.html"));
  const CommandResult result = Report({"--input_path", Path("reference")});
  ASSERT_EQ(result.exit_code, kExitSuccess) << result.error;
  EXPECT_EQ(page, ReadFile(Path("reference/report.html")));
  // Over an earlier one.
  ASSERT_EQ(Report({"--input_path", Path("reference")}).exit_code,
            kExitSuccess);
  EXPECT_FALSE(fs::exists(WorkFolder::Beside(Path("reference/report.html"))));
}

TEST_F(ReporterTest, PageIsGoodInABrowser) {
  MFIR_REQUIRE_BROWSER();
  RenameToNastyNames();
  ExpectRefines();
  ASSERT_NE(Summary()["cameras"][0]["name"].get<std::string>().find("<u>"),
            std::string::npos);
  for (const int width : {1300, 390}) {
    ExpectGoodPage(Path("out/report.html"), "out", width);
  }
}

TEST_F(ReporterTest, ComparesWithEarlierResults) {
  // Yesterday the focal length of one camera was another, and one camera was
  // not there.
  for (const char* day : {"monday", "tuesday"}) {
    fs::copy(Path("reference"), Path(day), fs::copy_options::recursive);
  }
  nlohmann::ordered_json summary =
      nlohmann::ordered_json::parse(ReadFile(Path("monday/summary.json")));
  summary["created"] = "2026-11-28T08:00:00Z";
  summary["cameras"][2]["params"][0] =
      summary["cameras"][2]["params"][0].get<double>() * 0.97;
  summary["cameras"][2]["params"][1] =
      summary["cameras"][2]["params"][1].get<double>() * 0.97;
  WriteFile(Path("monday/summary.json"), summary.dump());
  summary["created"] = "2026-11-29T08:00:00Z";
  summary["cameras"].erase(5);
  WriteFile(Path("tuesday/summary.json"), summary.dump());
  const CommandResult result = Report({"--input_path",
                                       Path("reference"),
                                       "--compare_path",
                                       Path("tuesday"),
                                       "--compare_path=" + Path("monday") + "/",
                                       "--output_path",
                                       Path("week.html")});
  ASSERT_EQ(result.exit_code, kExitSuccess) << result.error;
  const std::string page = ReadFile(Path("week.html"));
  EXPECT_NE(page.find("id=\"history\""), std::string::npos);
  // Oldest first in the history.
  const size_t history = page.find("id=\"history\"");
  EXPECT_LT(page.find("2026-11-28", history), page.find("2026-11-29", history));
  EXPECT_NE(page.find("1 camera cannot be compared"), std::string::npos);
  // 1 / 0.97 - 1 is 30.93 permille.
  EXPECT_NE(page.find("<td>+30.93</td>"), std::string::npos);
  EXPECT_NE(page.find("has changed far more than the others since"),
            std::string::npos);
  if (!FindBrowser().empty())
    ExpectGoodPage(Path("week.html"), "reference", 1000);
}

TEST_F(ReporterTest, BadInputsAndOutputs) {
  const auto expect = [&](int exit_code,
                          const std::vector<std::string>& parts,
                          const std::vector<std::string>& arguments) {
    const CommandResult result = Report(arguments);
    EXPECT_EQ(result.exit_code, exit_code) << result.error;
    EXPECT_EQ(result.error.rfind("ERROR: ", 0), 0) << result.error;
    for (const std::string& part : parts) {
      EXPECT_NE(result.error.find(part), std::string::npos) << result.error;
    }
  };
  const std::string reference = Path("reference");
  const std::string summary_path = Path("reference/summary.json");
  expect(kExitUsage, {"input_path"}, {});
  expect(kExitUsage, {"--nonsense"}, {"--nonsense", "1"});
  expect(kExitBadInput, {"no such folder"}, {"--input_path", Path("none")});
  expect(kExitBadInput,
         {"summary.json", "no such file"},
         {"--input_path", Path("frames")});
  expect(kExitBadInput,
         {"frames/summary.json"},
         {"--input_path", reference, "--compare_path", Path("frames")});
  // What is there and is no report is kept.
  expect(kExitOutput,
         {"is no report"},
         {"--input_path", reference, "--output_path", summary_path});
  expect(kExitOutput,
         {"cannot write"},
         {"--input_path", reference, "--output_path", Path("none/a.html")});

  const std::string summary = ReadFile(summary_path);
  const std::string page = ReadFile(Path("reference/report.html"));
  const auto expect_bad_summary = [&](const std::string& text,
                                      const std::string& part) {
    WriteFile(summary_path, text);
    expect(kExitBadInput, {"summary.json", part}, {"--input_path", reference});
    EXPECT_EQ(page, ReadFile(Path("reference/report.html")));
  };
  expect_bad_summary(summary.substr(0, summary.size() / 2), "not valid JSON");
  expect_bad_summary("[1, 2]", "schema_version");
  expect_bad_summary("{\"schema_version\": 1}", "'frames' is missing");
  nlohmann::json json = nlohmann::json::parse(summary);
  json["cameras"][3]["model"] = "NO_LENS";
  expect_bad_summary(json.dump(), "cameras[3]: the camera model 'NO_LENS'");
  json = nlohmann::json::parse(summary);
  json["cameras"][3]["params"].erase(0);
  expect_bad_summary(json.dump(), "cameras[3]: 'params' must have 4 numbers");
  json = nlohmann::json::parse(summary);
  json["cameras"].erase(7);
  expect_bad_summary(json.dump(), "is not in");
  json = nlohmann::json::parse(summary);
  json["frames"][0]["name"] = 5;
  expect_bad_summary(json.dump(), "type");
  WriteFile(summary_path, summary);
  fs::remove_all(Path("reference/frames/frame000001"));
  expect(kExitBadInput, {"frame000001"}, {"--input_path", reference});
}

}  // namespace
}  // namespace mfir

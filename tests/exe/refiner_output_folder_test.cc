// Output folders: which are refused, and that an earlier result stays.

#include "tests/support/refiner_runner.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

class OutputFolderTest : public RefinerTest {
 protected:
  // Expects a usage error, and files that stay as they are.
  void ExpectRefused(const CommandOptions& options) const {
    SCOPED_TRACE(testing::PrintToString(options));
    const auto before = Files(".");
    ExpectError(
        kExitUsage, {"--output_path", "apart from the inputs"}, options);
    EXPECT_TRUE(before == Files("."));
  }
};

TEST_F(OutputFolderTest, UnwritableOutput) {
  WriteFile(Path("file"), "keep me");
  ExpectError(
      kExitOutput, {Path("file"), "folder"}, {{"output_path", Path("file")}});
  ExpectError(
      kExitOutput, {Path("file/out")}, {{"output_path", Path("file/out")}});
  EXPECT_EQ(ReadFile(Path("file")), "keep me");
  ExpectError(kExitOutput, {"/proc/out"}, {{"output_path", "/proc/out"}});
}

TEST_F(OutputFolderTest, AmongTheInputs) {
  ExpectRefused({{"output_path", Path("frames")}});
  ExpectRefused({{"output_path", Path("frames/")}});
  ExpectRefused({{"output_path", Path("frames/out")}});
  ExpectRefused({{"output_path", Path("frames/frame000001/sparse")}});
  ExpectRefused({{"output_path", Path("rig")}});
  ExpectRefused({{"output_path", Path("ground_truth")},
                 {"ground_truth_path", Path("ground_truth")}});
  ExpectRefused({{"output_path", Path("rig/../frames/.")}});
}

// The result has a 'frames' and a 'rig' as well.
TEST_F(OutputFolderTest, AroundTheInputs) {
  ExpectRefused({{"output_path", folder_.Path()}});
  fs::rename(Path("frames"), Path("input"));
  const CommandOptions options = {{"output_path", folder_.Path()},
                                  {"input_path", Path("input")}};
  ExpectRefused(options);
  CommandOptions krt = options;
  krt["extrinsics_path"] = Path("KRT");
  ExpectRefused(krt);
  fs::rename(Path("rig"), Path("input_rig"));
  CommandOptions apart = options;
  apart["extrinsics_path"] = Path("input_rig");
  // Its KRT is no input now, but no result either.
  ExpectError(kExitOutput, {"'KRT'", "not a result"}, apart);
  fs::remove(Path("KRT"));
  ExpectRefines(apart);
}

TEST_F(OutputFolderTest, LinksToTheInputs) {
  fs::create_directory_symlink(Path("frames"), Path("link"));
  ExpectRefused({{"output_path", Path("link")}});
  ExpectRefused(
      {{"output_path", Path("frames")}, {"input_path", Path("link")}});
  ExpectRefused({{"output_path", Path("link/new")}});
  // A frame that lies elsewhere.
  fs::rename(Path("frames/frame000001"), Path("elsewhere"));
  fs::create_directory_symlink(Path("elsewhere"), Path("frames/frame000001"));
  ExpectRefused({{"output_path", Path("elsewhere")}});
  // A model in what an earlier run has written.
  ExpectRefines();
  fs::create_directories(Path("frames/again"));
  fs::create_directory_symlink(Path("out/frames/frame000000"),
                               Path("frames/again/sparse"));
  ExpectRefused({});
}

TEST_F(OutputFolderTest, ForeignContentStays) {
  WriteFile(Path("out/KRT"), "mine");
  ExpectError(kExitOutput, {"'KRT'", "not a result"});
  EXPECT_EQ(Files("out").size(), 1u);
  // Other names do not matter.
  fs::remove(Path("out/KRT"));
  WriteFile(Path("out/notes.txt"), "mine");
  ExpectRefines();
  ExpectRefines();
  EXPECT_EQ(ReadFile(Path("out/notes.txt")), "mine");
}

TEST_F(OutputFolderTest, FullDiskLeavesTheEarlierResult) {
  fs::create_directories(Path("disk"));
  if (RunShell("mount -t tmpfs -o size=4m none " + Path("disk")).exit_code !=
      0) {
    GTEST_SKIP() << "needs the right to mount a small disk";
  }
  ExpectRefines({{"output_path", Path("disk/out")}});
  RunShell("head -c 100m /dev/zero >" + Path("disk/full"));
  const auto before = Files("disk/out");
  const CommandResult result = Refine(
      {{"output_path", Path("disk/out")}, {"MultiFrame.loss_scale", "1"}});
  const auto after = Files("disk/out");
  RunShell("umount " + Path("disk"));
  EXPECT_EQ(result.exit_code, kExitOutput) << result.error;
  EXPECT_NE(result.error.find("disk full"), std::string::npos) << result.error;
  EXPECT_TRUE(before == after);
}

TEST_F(OutputFolderTest, EarlierResultSurvivesFailingRuns) {
  ExpectRefines();
  const auto before = Files("out");
  WriteFile(Path("empty_rig/cameras.txt"), "");
  WriteFile(Path("empty_rig/images.txt"), "");
  const std::vector<CommandOptions> failing = {
      {{"input_path", Path("missing")}},
      {{"extrinsics_path", Path("missing")}},
      {{"extrinsics_path", Path("empty_rig")}},
      {{"ground_truth_path", Path("missing")}},
      {{"frame_list_path", Path("missing")}},
      {{"MultiFrame.loss_scale", "-1"}},
      {{"MultiFrame.camera_name_regex", "(cam)"}},
      {{"MultiFrame.nonsense", "1"}},
      {{"project_path", Path("missing")}}};
  for (const CommandOptions& options : failing) {
    EXPECT_NE(Refine(options).exit_code, kExitSuccess)
        << testing::PrintToString(options);
    EXPECT_TRUE(before == Files("out")) << testing::PrintToString(options);
  }
}

// Whatever ends a run: the earlier result stays, and the next run clears what
// it has left.
TEST_F(OutputFolderTest, KilledRunLeavesTheEarlierResult) {
  ExpectRefines();
  const auto before = Files("out");
  for (const char* delay : {"0.02", "0.3"}) {
    RunShell("timeout -s KILL " + std::string(delay) + " " +
             ShellQuoted(MFIR_COLMAP_EXE) +
             " multi_frame_intrinsics_refiner --input_path " + Path("frames") +
             " --extrinsics_path " + Path("rig") + " --output_path " +
             Path("out") + " --MultiFrame.preset paper");
    EXPECT_TRUE(before == Files("out"));
  }
  WriteFile(Path("out/.unfinished/rig/cameras.bin"), "half");
  ExpectRefines();
  EXPECT_FALSE(fs::exists(Path("out/.unfinished")));
}

TEST_F(OutputFolderTest, OneRunAtATime) {
  fs::create_directories(Path("out"));
  const CommandResult result = RunShell(
      "flock " + Path("out") + " " + ShellQuoted(MFIR_COLMAP_EXE) +
      " multi_frame_intrinsics_refiner --input_path " + Path("frames") +
      " --extrinsics_path " + Path("rig") + " --output_path " + Path("out"));
  EXPECT_EQ(result.exit_code, kExitOutput);
  EXPECT_NE(result.error.find("another run"), std::string::npos)
      << result.error;
  ExpectRefines();
}

TEST_F(OutputFolderTest, NotConvergedNeverReplacesAResult) {
  const CommandOptions one_iteration = {{"MultiFrame.max_num_iterations", "1"}};
  ExpectError(kExitSolver, {"max_num_iterations", Path("out")}, one_iteration);
  EXPECT_EQ(Summary()["result"]["status"], "not_converged");
  EXPECT_FALSE(fs::exists(Path("out/not_converged")));
  ExpectRefines({{"output_path", Path("good")}});
  const auto before = Files("good");
  CommandOptions again = one_iteration;
  again["output_path"] = Path("good");
  for (int i = 0; i < 2; ++i) {
    ExpectError(kExitSolver, {Path("good/not_converged")}, again);
    EXPECT_EQ(Summary("good/not_converged")["result"]["status"],
              "not_converged");
    EXPECT_TRUE(IsModelFolder(Path("good/not_converged/rig")));
    for (const auto& [name, content] : before) {
      EXPECT_EQ(ReadFile(Path("good/" + name)), content) << name;
    }
  }
  ExpectRefines({{"output_path", Path("good")}});
  EXPECT_FALSE(fs::exists(Path("good/not_converged")));
}

}  // namespace
}  // namespace mfir

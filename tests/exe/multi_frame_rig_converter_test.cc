// The command multi_frame_rig_converter.

#include "colmap_ext/host/image_file.h"
#include "colmap_ext/rigs/rig_io.h"
#include "tests/support/refiner_runner.h"
#include "tests/support/rig_examples.h"

namespace mfir {
namespace {

class RigConverterTest : public testing::Test {
 protected:
  CommandResult Convert(const std::string& type,
                        const std::string& output,
                        const std::vector<std::string>& more = {}) const {
    std::vector<std::string> arguments = {"multi_frame_rig_converter",
                                          "--input_path",
                                          input_,
                                          "--output_path",
                                          folder_ / output,
                                          "--output_type",
                                          type};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return RunColmap(arguments);
  }

  const TemporaryFolder folder_;
  std::string input_ = RigExamples().front().Write(folder_ / "in");
};

TEST_F(RigConverterTest, EveryFormatIsWrittenAndReadAgain) {
  for (const RigFormat& format : RigFormats()) {
    SCOPED_TRACE(format.name);
    const CommandResult result = Convert(format.name, format.name);
    EXPECT_EQ(result.exit_code, 0) << result.error;
    EXPECT_NE(result.output.find("2 cameras, colmap to " + format.name),
              std::string::npos)
        << result.output;
    EXPECT_EQ(DetectRigFormat(folder_ / format.name).name, format.name);
    // Again: a rig of the same format is replaced.
    EXPECT_EQ(Convert(format.name, format.name).exit_code, 0);
  }
}

TEST_F(RigConverterTest, BadInputsHaveTheirExitCodes) {
  WriteFile(folder_ / "notes.txt", "no rig\n");
  WriteFile(folder_ / "full/notes.txt", "no rig\n");
  const auto expect =
      [](const CommandResult& result, int exit_code, const std::string& part) {
        EXPECT_EQ(result.exit_code, exit_code) << result.error;
        EXPECT_NE(result.error.find(part), std::string::npos) << result.error;
      };
  expect(Convert("bundler", "out"), 1, "'bundler' is unknown: use colmap, ");
  expect(Convert("krt", "in"), 1, "is the input");
  expect(Convert("krt", "notes.txt"), 4, "it is not replaced");
  expect(Convert("colmap", "full"), 4, "it is not replaced");
  expect(Convert("krt", "no/such/folder"), 4, "cannot write");
  EXPECT_EQ(ReadFile(folder_ / "notes.txt"), "no rig\n");
  input_ = folder_ / "none";
  expect(Convert("krt", "out"), 2, "no such file");
  EXPECT_FALSE(std::filesystem::exists(folder_ / "out"));
}

TEST_F(RigConverterTest, SizesComeFromImages) {
  ASSERT_EQ(Convert("krt", "KRT").exit_code, 0);
  input_ = folder_ / "KRT";
  const CommandResult without = Convert("csv", "out.csv");
  EXPECT_EQ(without.exit_code, 2);
  EXPECT_NE(without.error.find("Give --image_path"), std::string::npos)
      << without.error;
  for (const char* name : {"images/a/0.png", "images/b/0.png"}) {
    std::filesystem::create_directories(
        std::filesystem::path(folder_ / name).parent_path());
    ASSERT_TRUE(
        host::MakeBitmap(640, 480, /*as_rgb=*/false).Write(folder_ / name));
  }
  const CommandResult with =
      Convert("csv", "out.csv", {"--image_path", folder_ / "images"});
  EXPECT_EQ(with.exit_code, 0) << with.error;
  EXPECT_NE(ReadFile(folder_ / "out.csv").find("a,640,480,-1.20919957615614"),
            std::string::npos);
}

}  // namespace
}  // namespace mfir

// What unattended runs rely on: limits with their exit code, the schema of
// summary.json, rig files of other formats.

#include <algorithm>
#include <cmath>

#include "colmap_ext/rigs/rig_io.h"
#include "tests/support/refiner_runner.h"

namespace mfir {
namespace {

using Json = nlohmann::json;

bool HasType(const Json& value, const std::string& type) {
  return type == "object"    ? value.is_object()
         : type == "array"   ? value.is_array()
         : type == "string"  ? value.is_string()
         : type == "integer" ? value.is_number_integer()
         : type == "number"  ? value.is_number()
                             : type == "null" && value.is_null();
}

// The part of JSON Schema that docs/summary.schema.json uses.
void ExpectValid(const Json& root,
                 const Json& schema,
                 const Json& value,
                 const std::string& where) {
  if (schema.contains("$ref")) {
    const std::string reference = schema["$ref"];
    ExpectValid(
        root, root.at(Json::json_pointer(reference.substr(1))), value, where);
    return;
  }
  if (schema.contains("type")) {
    const Json types = schema["type"].is_array()
                           ? schema["type"]
                           : Json::array({schema["type"]});
    EXPECT_TRUE(
        std::any_of(types.begin(),
                    types.end(),
                    [&](const Json& type) { return HasType(value, type); }))
        << where << " is " << value.dump();
  }
  if (schema.contains("enum")) {
    EXPECT_NE(std::find(schema["enum"].begin(), schema["enum"].end(), value),
              schema["enum"].end())
        << where << " is " << value.dump();
  }
  if (value.is_object()) {
    for (const Json& key : schema.value("required", Json::array())) {
      EXPECT_TRUE(value.contains(key)) << where << " has no " << key;
    }
    const Json properties = schema.value("properties", Json::object());
    for (const auto& property : properties.items()) {
      if (value.contains(property.key())) {
        ExpectValid(root,
                    property.value(),
                    value[property.key()],
                    where + "." + property.key());
      }
    }
  }
  if (value.is_array() && schema.contains("items")) {
    for (const Json& element : value) {
      ExpectValid(root, schema["items"], element, where + "[]");
    }
  }
}

class RefinerAutomationTest : public RefinerTest {};

// The only log file in a folder, with its name in front.
std::string LogFileIn(const std::string& folder) {
  std::string text;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    if (entry.path().extension() != ".log" || !text.empty()) return "";
    text = entry.path().filename().string() + "\n" +
           ReadFile(entry.path().string());
  }
  return text;
}

TEST_F(RefinerAutomationTest, LogFileHasWhatIsPrinted) {
  const CommandResult to_both = Refine({{"log_path", Path("logs/both")}});
  const std::string both = LogFileIn(Path("logs/both"));
  ASSERT_EQ(to_both.exit_code, kExitSuccess) << to_both.error;
  EXPECT_EQ(both.find("multi_frame_intrinsics_refiner."), 0) << both;
  EXPECT_NE(both.find("\ncolmap multi_frame_intrinsics_refiner --"),
            std::string::npos);
  EXPECT_FALSE(to_both.output.empty());
  EXPECT_NE(both.find(to_both.output), std::string::npos) << both;
  EXPECT_NE(both.find("\nExit code 0\n"), std::string::npos) << both;

  // Errors are for the terminal, too.
  const CommandResult to_file = Refine({{"log_path", Path("logs/file")},
                                        {"log_target", "file"},
                                        {"extrinsics_path", Path("nothing")}});
  const std::string file = LogFileIn(Path("logs/file"));
  EXPECT_EQ(to_file.exit_code, kExitBadInput);
  EXPECT_EQ(to_file.output, "");
  EXPECT_EQ(to_file.error.find("ERROR: "), 0);
  EXPECT_NE(file.find(to_file.error + "Exit code 2\n"), std::string::npos)
      << file;

  ExpectRefines({{"log_path", Path("logs/none")}, {"log_target", "stdout"}});
  EXPECT_FALSE(std::filesystem::exists(Path("logs/none")));
  ExpectError(
      kExitUsage, {"--log_target", "nowhere"}, {{"log_target", "nowhere"}});
  ExpectError(
      kExitOutput, {"--log_path"}, {{"log_path", Path("rig/cameras.txt")}});
}

TEST_F(RefinerAutomationTest, ManyCommandsWriteOneLogFile) {
  const CommandResult result = RunColmap({"multi_frame_automatic_refiner",
                                          "--workspace_path",
                                          Path("w"),
                                          "--image_path",
                                          Path("frames"),
                                          "--extrinsics_path",
                                          Path("rig"),
                                          "--log_target",
                                          "file",
                                          "--log_path",
                                          Path("logs")});
  // There are no images.
  EXPECT_EQ(result.exit_code, kExitBadInput);
  EXPECT_EQ(result.output, "");
  const std::string log = LogFileIn(Path("logs"));
  EXPECT_EQ(log.find("multi_frame_automatic_refiner."), 0) << log;
  EXPECT_NE(log.find("1 of 2"), std::string::npos) << log;
  EXPECT_NE(log.find(result.error + "Exit code 2\n"), std::string::npos) << log;
}

TEST_F(RefinerAutomationTest, SummaryFollowsItsSchema) {
  const Json schema = Json::parse(
      ReadFile(std::string(MFIR_SOURCE_DIR) + "/docs/summary.schema.json"));
  for (const CommandOptions& options :
       std::vector<CommandOptions>{{},
                                   {{"ground_truth_path", Path("ground_truth")},
                                    {"MultiFrame.use_prior_intrinsics", "1"}},
                                   {{"MultiFrame.preset", "paper"}}}) {
    ExpectRefines(options);
    ExpectValid(schema, schema, Summary(), "summary");
  }
}

TEST_F(RefinerAutomationTest, LimitsHaveTheirExitCode) {
  ExpectError(5,
              {"outside of the limits",
               "camera 'cam00': max_rms_px",
               "allowed 0.001",
               Path("out")},
              {{"MultiFrame.max_rms_px", "0.001"}});
  const Json exceeded = Summary()["result"]["limits_exceeded"];
  EXPECT_EQ(exceeded.size(), Summary()["cameras"].size());
  EXPECT_EQ(exceeded[0]["limit"], "max_rms_px");
  EXPECT_EQ(Summary()["result"]["status"], "converged");
  ExpectRefines({{"MultiFrame.max_rms_px", "1000"},
                 {"MultiFrame.max_focal_std_permille", "1000"},
                 {"MultiFrame.max_principal_point_std_px", "1000"},
                 {"MultiFrame.max_focal_drift_permille", "1000"},
                 {"MultiFrame.max_principal_point_drift_px", "1000"}});
  EXPECT_TRUE(Summary()["result"]["limits_exceeded"].empty());
  for (const char* limit : {"max_focal_std_permille",
                            "max_principal_point_std_px",
                            "max_focal_drift_permille",
                            "max_principal_point_drift_px"}) {
    ExpectError(5, {limit}, {{std::string("MultiFrame.") + limit, "1e-9"}});
  }
  ExpectError(
      1, {"--MultiFrame.max_rms_px -1"}, {{"MultiFrame.max_rms_px", "-1"}});
}

TEST_F(RefinerAutomationTest, RigFilesOfOtherFormats) {
  ExpectRefines({{"MultiFrame.output_types",
                  "krt, transforms,metashape,opencv,kalibr,rig_config"}});
  const auto read = [&](const std::string& name) {
    return ReadRig(Path("out/" + name), "auto", CameraNaming(), std::nan(""));
  };
  const Rig rig = read("rig");
  for (const char* name : {"KRT",
                           "transforms.json",
                           "metashape.xml",
                           "opencv",
                           "camchain.yaml",
                           "rig_config.json"}) {
    SCOPED_TRACE(name);
    const Rig other = read(name);
    ASSERT_EQ(other.cameras.size(), rig.cameras.size());
    for (size_t i = 0; i < rig.cameras.size(); ++i) {
      EXPECT_EQ(other.cameras[i].name, rig.cameras[i].name);
      double xy[2][2];
      rig.cameras[i].model->Project(
          rig.cameras[i].params.data(), 0.1, 0.2, xy[0]);
      other.cameras[i].model->Project(
          other.cameras[i].params.data(), 0.1, 0.2, xy[1]);
      EXPECT_NEAR(xy[0][0], xy[1][0], 1e-8);
      EXPECT_NEAR(xy[0][1], xy[1][1], 1e-8);
    }
  }
  // The next result has none of them.
  ExpectRefines();
  EXPECT_FALSE(std::filesystem::exists(Path("out/transforms.json")));
  ExpectError(1,
              {"--MultiFrame.output_types 'bundler' is unknown"},
              {{"MultiFrame.output_types", "krt,bundler"}});
}

// RIG was calibrated at twice the resolution.
TEST_F(RefinerAutomationTest, CalibrationOfAnotherResolution) {
  ExpectRefines({{"MultiFrame.use_prior_intrinsics", "1"},
                 {"output_path", Path("expected")}});
  Rig rig = ReadRig(Path("rig"), "auto", CameraNaming(), std::nan(""));
  for (KnownCamera& camera : rig.cameras) {
    camera.width *= 2;
    camera.height *= 2;
    for (const size_t idx : camera.model->FocalLengthIdxs()) {
      camera.params[idx] *= 2.0;
    }
    for (const size_t idx : camera.model->PrincipalPointIdxs()) {
      camera.params[idx] *= 2.0;
    }
  }
  WriteRig(Path("large"), FindRigFormat("", "colmap"), rig.cameras);
  ExpectError(2,
              {"1280 x 960", "--MultiFrame.scale_intrinsics 1"},
              {{"extrinsics_path", Path("large")}});
  ExpectRefines({{"extrinsics_path", Path("large")},
                 {"MultiFrame.scale_intrinsics", "1"},
                 {"MultiFrame.use_prior_intrinsics", "1"}});
  EXPECT_EQ(Params(), Params("expected"));
  // Rotated.
  for (KnownCamera& camera : rig.cameras) {
    camera.width = 480;
    camera.height = 640;
  }
  WriteRig(Path("portrait"), FindRigFormat("", "colmap"), rig.cameras);
  ExpectError(2,
              {"480 x 640", "EXIF orientation"},
              {{"extrinsics_path", Path("portrait")},
               {"MultiFrame.scale_intrinsics", "1"}});
}

}  // namespace
}  // namespace mfir

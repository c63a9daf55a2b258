#include "tests/fuzz/targets.h"

#include <cstdlib>
#include <functional>
#include <limits>
#include <set>
#include <sstream>
#include <stdexcept>

#include <sqlite3.h>

#include "colmap_ext/controllers/frame_triangulation.h"
#include "colmap_ext/feature/feature_database.h"
#include "colmap_ext/host/log.h"
#include "colmap_ext/io/input_file.h"
#include "colmap_ext/models/model_frames.h"
#include "colmap_ext/models/model_io.h"
#include "colmap_ext/options/option_parser.h"
#include "colmap_ext/report/report_reader.h"
#include "colmap_ext/rigs/rig_io.h"
#include "src/report_page/report_page.h"
#include "src/sensor/frame_naming.h"
#include "src/sensor/image_layout.h"
#include "tests/fuzz/fixtures.h"
#include "tests/support/test_files.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

// The folder of all inputs: making one for each would take most of the time.
const TemporaryFolder& InputFolder() {
  static const TemporaryFolder folder;
  return folder;
}

std::vector<std::string> Split(const std::string& text,
                               const std::string& separator) {
  std::vector<std::string> parts;
  size_t begin = 0;
  for (size_t end; (end = text.find(separator, begin)) != std::string::npos;) {
    parts.push_back(text.substr(begin, end - begin));
    begin = end + separator.size();
  }
  parts.push_back(text.substr(begin));
  return parts;
}

// Writes the files of the input; those without a part are missing. Returns the
// path to read.
std::string WriteInput(const FuzzTarget& target, const std::string& input) {
  const std::vector<std::string> parts = target.files.size() == 1
                                             ? std::vector<std::string>{input}
                                             : Split(input, kNextFile);
  for (size_t i = 0; i < target.files.size(); ++i) {
    const std::string path = InputFolder() / target.files[i];
    if (i < parts.size()) {
      WriteFile(path, parts[i]);
    } else {
      fs::remove(path);
    }
  }
  return target.path.empty() ? InputFolder().Path()
                             : InputFolder() / target.path;
}

[[noreturn]] void Bug(const std::string& what) {
  throw std::logic_error("BUG: " + what);
}

// Runs what may throw our errors only. False if it has.
bool Succeeds(const std::function<void()>& body) {
  // What a command says on its way is for people.
  const host::SilentColmap silence;
  try {
    body();
    return true;
  } catch (const Error& error) {
    if (std::string(error.what()).empty()) Bug("an empty message");
    return false;
  }
}

void RunModel(const FuzzTarget& target, const std::string& input) {
  const std::string path = WriteInput(target, input);
  Succeeds([&path]() {
    host::Reconstruction model;
    if (!IsModelFolder(path)) return;
    FindSparseModel(path);
    ReadModel(path, /*require_points=*/false, &model);
    ReadModelFrames(path, model);
  });
}

void CheckRig(const Rig& rig) {
  for (const KnownCamera& camera : rig.cameras) {
    const Rigid3& pose = camera.cam_from_world;
    if (camera.name.empty()) Bug("a camera without name");
    if (!(std::abs(pose.rotation.norm() - 1.0) < 1e-9)) Bug("no rotation");
    if (!pose.translation.allFinite()) Bug("a pose that is not finite");
    if (camera.model == nullptr) continue;
    if (camera.params.size() != camera.model->NumParams()) Bug("parameters");
    for (const double param : camera.params) {
      if (!std::isfinite(param)) Bug("a parameter that is not finite");
    }
  }
}

// What can be read can be written, and what has been written can be read.
void RunRig(const FuzzTarget& target, const std::string& input) {
  const std::string path = WriteInput(target, input);
  const std::string format = target.name.substr(std::string("rig_").size());
  Rig rig;
  if (!Succeeds([&]() { rig = ReadRig(path, format, CameraNaming(), kNaN); })) {
    return;
  }
  CheckRig(rig);
  static const TemporaryFolder output;
  const std::string written = output / "rig";
  const RigFormat& rig_format = FindRigFormat("", rig.format);
  if (!Succeeds([&]() { WriteRig(written, rig_format, rig.cameras); })) return;
  Rig again;
  try {
    again = ReadRig(written, rig.format, CameraNaming(), kNaN);
  } catch (const Error& error) {
    Bug(std::string("what was written is not read: ") + error.what());
  }
  CheckRig(again);
  if (again.cameras.size() != rig.cameras.size()) Bug("cameras got lost");
  fs::remove_all(written);
}

void RunNameList(const FuzzTarget& target, const std::string& input) {
  const std::string path = WriteInput(target, input);
  Succeeds([&path]() { ReadNameList("--frame_list_path", path); });
}

void RunIni(const FuzzTarget& target, const std::string& input) {
  const std::string path = WriteInput(target, input);
  Succeeds([&path]() {
    std::string text;
    int count = 0;
    double weight = 0.0;
    bool flag = false;
    OptionParser parser;
    parser.Add("input_path", &text, "");
    parser.Add("MultiFrame.count", &count, "");
    parser.Add("MultiFrame.weight", &weight, "");
    parser.Add("MultiFrame.flag", &flag, "");
    std::vector<std::string> arguments = {"command", "--project_path", path};
    std::vector<char*> argv;
    for (std::string& argument : arguments) argv.push_back(argument.data());
    parser.Parse(static_cast<int>(argv.size()), argv.data());
    parser.Write(InputFolder() / "written.ini");
    parser.ToJson().dump(
        -1, ' ', false, nlohmann::ordered_json::error_handler_t::replace);
  });
}

// The first two lines are the regular expressions of cameras and frames, the
// others paths of images.
void RunNames(const FuzzTarget&, const std::string& input) {
  std::vector<std::string> lines = Split(input, "\n");
  lines.resize(std::max<size_t>(lines.size(), 2));
  const std::vector<std::string> paths(lines.begin() + 2, lines.end());
  Succeeds([&]() {
    const CameraNaming naming(lines[0]);
    const std::vector<std::string> names = naming.Names(paths);
    if (names.size() != paths.size()) Bug("names of cameras");
    const std::set<std::string> cameras(names.begin(), names.end());
    for (const std::string& name : FrameNames(paths, cameras, lines[1])) {
      if (name.find('/') != std::string::npos || name == "." || name == "..") {
        Bug("the frame '" + name + "' is no name of a folder");
      }
    }
    NamesOfFrames({paths, {"a/1.png"}});
    FindImageLayout(paths, {names.begin(), names.end()}, naming, lines[1]);
  });
}

void RunFeatureDatabase(const FuzzTarget& target, const std::string& input) {
  const std::string path = WriteInput(target, input);
  Succeeds([&path]() {
    FeatureDatabase database(path);
    database.Extract(FixtureFeatureRequest());
  });
}

void TriangulateDatabase(const std::string& path) {
  const std::string copy = InputFolder() / "copy.db";
  for (const std::string suffix : {"", "-wal", "-shm", "-journal"}) {
    fs::remove(copy + suffix);
  }
  Succeeds([&]() {
    CopyFrameDatabase(path, copy);
    TriangulatorOptions options;
    FrameStatistics statistics;
    FrameTimings timings;
    std::vector<std::string> warnings;
    TriangulateFrame(options,
                     CameraNaming(),
                     FixtureCameras(),
                     {{0, 1}},
                     /*num_threads=*/1,
                     /*progress=*/{},
                     host::OpenDatabase(copy).get(),
                     &statistics,
                     &timings,
                     &warnings);
  });
}

void RunFrameDatabase(const FuzzTarget& target, const std::string& input) {
  TriangulateDatabase(WriteInput(target, input));
}

// Changes a good database by SQL, within its file and in little time.
void ChangeDatabase(const std::string& path, const std::string& sql) {
  sqlite3* database = nullptr;
  if (sqlite3_open(path.c_str(), &database) != SQLITE_OK) std::abort();
  sqlite3_exec(database, "PRAGMA synchronous = OFF", nullptr, nullptr, nullptr);
  const auto authorize =
      [](void*, int action, const char*, const char*, const char*, const char*)
      -> int {
    return action == SQLITE_ATTACH || action == SQLITE_DETACH ||
                   action == SQLITE_PRAGMA || action == SQLITE_RECURSIVE
               ? SQLITE_DENY
               : SQLITE_OK;
  };
  sqlite3_set_authorizer(database, authorize, nullptr);
  sqlite3_limit(database, SQLITE_LIMIT_LENGTH, 1 << 16);
  sqlite3_progress_handler(
      database, 10000, [](void*) { return 1; }, nullptr);
  sqlite3_exec(database, sql.c_str(), nullptr, nullptr, nullptr);
  sqlite3_close(database);
}

void RunFrameDatabaseSql(const FuzzTarget&, const std::string& input) {
  static const std::string good = FixtureFrameDatabase();
  const std::string path = InputFolder() / "changed.db";
  WriteFile(path, good);
  ChangeDatabase(path, input);
  TriangulateDatabase(path);
}

void RunFeatureDatabaseSql(const FuzzTarget&, const std::string& input) {
  static const std::string good = FixtureFeatureDatabase();
  const std::string path = InputFolder() / "changed.db";
  WriteFile(path, good);
  ChangeDatabase(path, input);
  Succeeds([&path]() {
    FeatureDatabase database(path);
    database.Extract(FixtureFeatureRequest());
  });
}

// Beside models of two cameras and one frame that are always the same.
void RunSummary(const FuzzTarget& target, const std::string& input) {
  static const bool has_models = [] {
    WriteFixtureResult(InputFolder().Path());
    return true;
  }();
  (void)has_models;
  const std::string path = WriteInput(target, input);
  Succeeds([&path]() { MakeReportPage(ReadReport(path, "OUT", {path})); });
}

std::vector<FuzzTarget> MakeTargets() {
  std::vector<FuzzTarget> targets = {
      {"model_text",
       RunModel,
       {"cameras.txt", "images.txt", "points3D.txt", "frames.txt"},
       ""},
      {"model_binary",
       RunModel,
       {"cameras.bin", "images.bin", "points3D.bin", "frames.bin"},
       ""},
      {"rig_colmap", RunRig, {"cameras.txt", "images.txt"}, ""},
      {"rig_opencv", RunRig, {"intri.yml", "extri.yml"}, ""},
      {"rig_auto", RunRig, {"rig_file"}, "rig_file"},
      {"name_list", RunNameList, {"list.txt"}, "list.txt"},
      {"ini", RunIni, {"project.ini"}, "project.ini"},
      {"names", RunNames, {}, ""},
      {"feature_database", RunFeatureDatabase, {"features.db"}, "features.db"},
      {"feature_database_sql", RunFeatureDatabaseSql, {}, ""},
      {"frame_database", RunFrameDatabase, {"frame.db"}, "frame.db"},
      {"frame_database_sql", RunFrameDatabaseSql, {}, ""},
      {"summary", RunSummary, {"summary.json", "history.csv"}, ""}};
  for (const RigFormat& format : RigFormats()) {
    if (format.name == "colmap" || format.name == "opencv") continue;
    targets.push_back({"rig_" + format.name, RunRig, {"rig_file"}, "rig_file"});
  }
  return targets;
}

}  // namespace

const std::vector<FuzzTarget>& FuzzTargets() {
  static const std::vector<FuzzTarget> targets = MakeTargets();
  return targets;
}

const FuzzTarget* FindFuzzTarget(const std::string& name) {
  for (const FuzzTarget& target : FuzzTargets()) {
    if (target.name == name) return &target;
  }
  return nullptr;
}

}  // namespace mfir

#include "colmap_ext/frames/frame_database.h"

#include <filesystem>

#include <sqlite3.h>

#include "colmap_ext/host/database.h"
#include "colmap_ext/host/util.h"
#include "colmap_ext/models/camera_models.h"
#include "colmap_ext/models/model_io.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

void WriteFeatures(const std::vector<RigCamera>& cameras,
                   const std::vector<FrameFeatures>& features,
                   host::Database* database) {
  for (const FrameFeatures& image_features : features) {
    const auto id = static_cast<host::image_t>(image_features.camera_idx + 1);
    host::Camera camera =
        MakeHostCamera(id, cameras[image_features.camera_idx]);
    host::SetHasPriorFocalLength(true, &camera);
    host::Image image;
    image.SetImageId(id);
    image.SetCameraId(id);
    image.SetName(image_features.name);
    host::WriteImageWithTrivialFrame(camera, image, database);
    database->WriteKeypoints(id, *image_features.keypoints);
    host::WriteDescriptors(id, *image_features.descriptors, database);
  }
}

// First value of the first row of a query, as text. Throws std::runtime_error
// with SQLite's message.
std::string Query(sqlite3* database, const std::string& sql) {
  sqlite3_stmt* statement = nullptr;
  std::string text;
  int code = sqlite3_prepare_v2(database, sql.c_str(), -1, &statement, nullptr);
  if (code == SQLITE_OK) {
    code = sqlite3_step(statement);
    if (code == SQLITE_ROW) {
      const auto* value = sqlite3_column_text(statement, 0);
      text = value == nullptr ? "" : reinterpret_cast<const char*>(value);
    }
  }
  const std::string message = sqlite3_errmsg(database);
  sqlite3_finalize(statement);
  if (code != SQLITE_ROW && code != SQLITE_DONE) {
    throw std::runtime_error(message);
  }
  return text;
}

// What must be true of all rows of a table. SQLite's conditions on NULL are
// neither true nor false.
struct Requirement {
  std::string table;
  std::string condition;
  std::string damage;  // where it is not
};

// Of rows of the table of cameras that COLMAP can read.
std::string ReadableCameras() {
  std::string condition = "0";
  for (const CameraModel* model : AllCameraModels()) {
    condition +=
        " OR (model = " + std::to_string(CameraModelId(*model)) +
        " AND length(params) = " + std::to_string(8 * model->NumParams()) + ")";
  }
  return "typeof(params) = 'blob' AND (" + condition + ")";
}

// Of a matrix of elements of `size` bytes.
std::string ReadableMatrix(int size) {
  return "typeof(rows) = 'integer' AND typeof(cols) = 'integer' AND rows >= 0 "
         "AND cols >= 0 AND typeof(data) IN ('blob', 'null') AND "
         "coalesce(length(data), 0) = rows * cols * " +
         std::to_string(size);
}

// Of pairs of COLMAP's identifiers of images, from which theirs are made.
std::string ReadablePairs() {
  return "typeof(pair_id) = 'integer' AND pair_id >= 0 AND pair_id / "
         "2147483647 < 2147483647 AND (cols = 2 OR rows = 0) AND " +
         ReadableMatrix(4);
}

std::vector<Requirement> RequirementsOfColmap() {
  const std::string kNoMatrix = " do not have the size that their table says";
  return {{"cameras",
           ReadableCameras(),
           "cameras have an unknown model or not as many parameters as it has"},
          {"images",
           "typeof(name) = 'text' AND image_id >= 0 AND image_id < 2147483647",
           "an image has no name or no valid id"},
          {"images",
           "image_id IN (SELECT image_id FROM keypoints)",
           "an image has no keypoints"},
          {"keypoints",
           "cols IN (2, 4, 6) AND " + ReadableMatrix(4),
           "keypoints" + kNoMatrix},
          {"matches", ReadablePairs(), "matches" + kNoMatrix},
          // There may be none, as of other extractors.
          {"descriptors", ReadableMatrix(1), "descriptors" + kNoMatrix},
          {"two_view_geometries",
           ReadablePairs(),
           "two-view geometries" + kNoMatrix}};
}

// SQLite looks names up in its own way.
bool HasTable(sqlite3* database, const std::string& name) {
  return Query(database,
               "SELECT count(*) FROM pragma_table_info('" + name + "')") != "0";
}

size_t NumColumns(sqlite3* database,
                  const std::string& table,
                  const std::string& quoted_names) {
  return std::stoul(Query(database,
                          "SELECT count(*) FROM pragma_table_info('" + table +
                              "') WHERE name IN (" + quoted_names + ")"));
}

// The matrices of a geometry are empty or whole.
std::string FindDamagedGeometry(sqlite3* database) {
  const std::string kTable = "two_view_geometries";
  Query(database, "SELECT config FROM " + kTable);
  // COLMAP adds them to tables of older versions, but not one alone.
  if (NumColumns(database, kTable, "'F', 'E', 'H'") % 3 != 0 ||
      NumColumns(database, kTable, "'qvec', 'tvec'") % 2 != 0) {
    return "two-view geometries lack a column";
  }
  for (const auto& [column, size] :
       {std::pair("F", 72), {"E", 72}, {"H", 72}, {"qvec", 32}, {"tvec", 24}}) {
    const std::string name = column;
    if (NumColumns(database, kTable, "'" + name + "'") != 0 &&
        Query(database,
              "SELECT count(*) FROM two_view_geometries WHERE coalesce(length("
              "CAST(" +
                  name + " AS BLOB)), 0) NOT IN (0, " + std::to_string(size) +
                  ")") != "0") {
      return "two-view geometries have a damaged " + name;
    }
  }
  return "";
}

// What is wrong with the content, "" if nothing. COLMAP aborts at what it
// cannot read.
std::string FindDamage(sqlite3* database) {
  if (Query(database, "PRAGMA quick_check") != "ok") {
    return "it is damaged";
  }
  Query(database,
        "SELECT camera_id, model, width, height, params, prior_focal_length "
        "FROM cameras");
  Query(database, "SELECT " + host::RequiredImageColumns() + " FROM images");
  Query(database, "PRAGMA foreign_keys = ON");
  for (const char* table : {"cameras",
                            "images",
                            "keypoints",
                            "descriptors",
                            "matches",
                            "two_view_geometries"}) {
    if (!HasTable(database, table)) continue;
    // Compiled, not run: references to columns that are not there.
    const std::string name = table;
    Query(database, "EXPLAIN INSERT INTO " + name + " SELECT * FROM " + name);
    Query(database, "EXPLAIN DELETE FROM " + name);
  }
  if (HasTable(database, "descriptors")) {
    Query(database, "SELECT image_id FROM descriptors");
  }
  for (const Requirement& requirement : RequirementsOfColmap()) {
    const bool is_optional = requirement.table == "descriptors" ||
                             requirement.table == "two_view_geometries";
    if (is_optional && !HasTable(database, requirement.table)) continue;
    if (Query(database,
              "SELECT count(*) FROM " + requirement.table + " WHERE (" +
                  requirement.condition + ") IS NOT TRUE") != "0") {
      return requirement.damage;
    }
  }
  const bool has_geometries = HasTable(database, "two_view_geometries");
  if (has_geometries) {
    const std::string damage = FindDamagedGeometry(database);
    if (!damage.empty()) return damage;
  }
  const bool has_inliers =
      has_geometries &&
      Query(database,
            "SELECT count(*) FROM two_view_geometries WHERE rows > 0") != "0";
  if (!has_inliers &&
      Query(database, "SELECT count(*) FROM matches WHERE rows > 0") == "0") {
    return "it has no matches";
  }
  return "";
}

void FillDatabase(const TriangulatorOptions& options,
                  const std::vector<RigCamera>& cameras,
                  const std::vector<FrameImageFile>& files,
                  const std::vector<std::pair<size_t, size_t>>& pairs,
                  int num_threads,
                  const ProgressFunction& progress,
                  host::Database* database,
                  FrameTimings* timings,
                  std::vector<std::string>* warnings) {
  const auto or_given = [num_threads](int option) {
    return option > 0 ? option : num_threads;
  };
  host::Timer timer;
  timer.Start();
  const std::vector<FrameFeatures> features =
      ExtractFeatures(options,
                      cameras,
                      files,
                      or_given(options.feature_extraction.num_threads),
                      progress,
                      warnings);
  WriteFeatures(cameras, features, database);
  if (features.size() < 2) {
    throw InputError(std::to_string(features.size()) +
                     " readable images; at least 2 are needed");
  }
  timings->extraction = timer.ElapsedSeconds();
  if (options.MatchesAlongEpipolarLines()) return;
  timer.Restart();
  for (const FrameMatches& pair :
       MatchFeatures(options,
                     cameras,
                     features,
                     pairs,
                     or_given(options.feature_matching.num_threads))) {
    database->WriteMatches(static_cast<host::image_t>(pair.camera_idx1 + 1),
                           static_cast<host::image_t>(pair.camera_idx2 + 1),
                           pair.matches);
  }
  timings->matching = timer.ElapsedSeconds();
}

}  // namespace

void MakeFrameDatabase(const TriangulatorOptions& options,
                       const std::vector<RigCamera>& cameras,
                       const std::vector<FrameImageFile>& files,
                       const std::vector<std::pair<size_t, size_t>>& pairs,
                       int num_threads,
                       const std::string& path,
                       const ProgressFunction& progress,
                       FrameTimings* timings,
                       std::vector<std::string>* warnings) {
  const std::shared_ptr<host::Database> database = host::OpenDatabase(path);
  {
    const host::DatabaseTransaction transaction(database.get());
    FillDatabase(options,
                 cameras,
                 files,
                 pairs,
                 num_threads,
                 progress,
                 database.get(),
                 timings,
                 warnings);
  }
  // COLMAP is silent about a transaction that could not be written.
  if (database->NumImages() == 0) {
    throw OutputError(path + ": cannot write the file. Is the disk full?");
  }
}

void CopyFrameDatabase(const std::string& source, const std::string& path) {
  for (const std::string suffix : {"", "-wal"}) {
    std::error_code error;
    if (!suffix.empty() && !fs::exists(source + suffix, error)) continue;
    fs::copy_file(source + suffix, path + suffix, error);
    if (error == std::errc::no_space_on_device) {
      throw OutputError(path + ": cannot write the file. Is the disk full?");
    }
    if (error) {
      throw InputError(source + suffix +
                       ": cannot copy the file: " + error.message());
    }
  }
  sqlite3* database = nullptr;
  std::string damage;
  try {
    if (sqlite3_open_v2(
            path.c_str(), &database, SQLITE_OPEN_READWRITE, nullptr) !=
        SQLITE_OK) {
      throw std::runtime_error("it cannot be opened");
    }
    damage = FindDamage(database);
  } catch (const std::runtime_error& error) {
    damage = error.what();
  }
  sqlite3_close_v2(database);
  if (!damage.empty()) {
    throw InputError(source + " is no usable COLMAP database: " + damage +
                     ". Make it again, or remove it to have it made from the "
                     "images.");
  }
}

}  // namespace mfir

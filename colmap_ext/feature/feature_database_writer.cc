#include <filesystem>
#include <set>

#include "colmap_ext/feature/feature_database.h"
#include "colmap_ext/io/work_folder.h"
#include "src/sensor/camera_naming.h"
#include "src/util/errors.h"
#include "src/util/parse_number.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

// Integers where the name is one, as the paper's programs expect.
void BindName(const std::string& name, int index, SqliteStatement* statement) {
  int64_t number;
  if (ParseNumber(name, &number) && std::to_string(number) == name) {
    sqlite3_bind_int64(statement->Get(), index, number);
  } else {
    sqlite3_bind_text(
        statement->Get(), index, name.c_str(), -1, SQLITE_TRANSIENT);
  }
}

class WritingFeatureSource : public DenseFeatureSource {
 public:
  WritingFeatureSource(std::unique_ptr<DenseFeatureSource> source,
                       const std::string& path)
      : source_(std::move(source)),
        path_(path),
        work_folder_(WorkFolder::Beside(path)),
        temporary_path_((work_folder_.Path() / "features.db").string()) {
    CheckMayReplace();
    Try([this]() { Create(); });
  }

  ~WritingFeatureSource() override {
    insert_.reset();
    file_.reset();
  }

  DenseFeaturePatches Extract(const DenseFeatureRequest& request) override {
    DenseFeaturePatches patches = source_->Extract(request);
    // Images may be asked for twice. Two frames of the same name in the file
    // are an error.
    if (written_.insert({request.frame_name, request.camera_name}).second) {
      Try([&]() { Write(request, patches); });
    }
    return patches;
  }

  void Finish() override {
    source_->Finish();
    Try([this]() {
      insert_.reset();
      file_->Execute("COMMIT");
      file_.reset();
      fs::rename(temporary_path_, path_);
    });
  }

 private:
  template <typename Function>
  void Try(const Function& function) const {
    std::string problem;
    try {
      function();
      return;
    } catch (const SqliteError& error) {
      problem = error.what();
    } catch (const fs::filesystem_error& error) {
      problem = error.code().message();
    }
    throw OutputError("--MultiFrame.write_dense_features " + path_ +
                      ": cannot write the file (" + problem +
                      "). Is the folder there, writable, and not full?");
  }

  // Only an earlier file of the same kind is replaced.
  void CheckMayReplace() const {
    std::error_code error;
    if (!fs::exists(path_, error)) return;
    try {
      SqliteFile file(path_, SQLITE_OPEN_READONLY);
      SqliteStatement(file.Get(), "SELECT dense_feature FROM dense_features");
    } catch (const SqliteError&) {
      throw OutputError("--MultiFrame.write_dense_features " + path_ +
                        ": the file exists and is no database of dense "
                        "features. Give another name.");
    }
  }

  void Create() {
    file_ = std::make_unique<SqliteFile>(
        temporary_path_, SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE);
    // A failure leaves nothing that would need the journal.
    file_->Execute("PRAGMA journal_mode = OFF");
    file_->Execute("PRAGMA synchronous = OFF");
    file_->Execute("BEGIN");
    // No types for names: SQLite would change text like "1e5" to a number.
    file_->Execute(
        "CREATE TABLE dense_features(frame_name, camera_name, keypoint_id "
        "INTEGER, corner_x INTEGER, corner_y INTEGER, dense_feature BLOB, "
        "PRIMARY KEY (frame_name, camera_name, keypoint_id))");
    file_->Execute(
        "CREATE TABLE dense_feature_info(patch_size INTEGER, num_channels "
        "INTEGER, pixel_size REAL)");
    insert_ = std::make_unique<SqliteStatement>(
        file_->Get(), "INSERT INTO dense_features VALUES (?, ?, ?, ?, ?, ?)");
  }

  void WriteInfo(const DenseFeaturePatches& patches) {
    SqliteStatement insert(file_->Get(),
                           "INSERT INTO dense_feature_info VALUES (?, ?, ?)");
    sqlite3_bind_int(insert.Get(), 1, patches.patch_size);
    sqlite3_bind_int(insert.Get(), 2, patches.num_channels);
    sqlite3_bind_double(insert.Get(), 3, patches.pixel_size);
    insert.Step();
    has_info_ = true;
  }

  void Write(const DenseFeatureRequest& request,
             const DenseFeaturePatches& patches) {
    const size_t size = patches.PatchNumElements();
    for (size_t i = 0; i < patches.valid.size(); ++i) {
      if (!patches.valid[i]) continue;
      if (!has_info_) WriteInfo(patches);
      insert_->Reset();
      BindName(CanonicalFrameName(request.frame_name), 1, insert_.get());
      BindName(CanonicalCameraName(request.camera_name), 2, insert_.get());
      sqlite3_bind_int64(insert_->Get(), 3, request.keypoint_ids[i]);
      sqlite3_bind_int(insert_->Get(), 4, patches.corners[i].x());
      sqlite3_bind_int(insert_->Get(), 5, patches.corners[i].y());
      sqlite3_bind_blob64(insert_->Get(),
                          6,
                          &patches.data[i * size],
                          size * sizeof(uint16_t),
                          SQLITE_STATIC);
      insert_->Step();
    }
  }

  const std::unique_ptr<DenseFeatureSource> source_;
  const std::string path_;
  const WorkFolder work_folder_;
  const std::string temporary_path_;
  std::unique_ptr<SqliteFile> file_;
  std::unique_ptr<SqliteStatement> insert_;
  bool has_info_ = false;
  // Names of frames and cameras.
  std::set<std::pair<std::string, std::string>> written_;
};

}  // namespace

std::unique_ptr<DenseFeatureSource> MakeWritingFeatureSource(
    std::unique_ptr<DenseFeatureSource> source, const std::string& path) {
  return std::make_unique<WritingFeatureSource>(std::move(source), path);
}

}  // namespace mfir

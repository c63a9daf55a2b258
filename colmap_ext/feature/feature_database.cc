#include "colmap_ext/feature/feature_database.h"

#include <cstring>
#include <filesystem>
#include <limits>
#include <unordered_map>

#include "src/sensor/camera_naming.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

// Of a file without the table dense_feature_info: the paper's.
constexpr int kDefaultPatchSize = 16;
constexpr int kDefaultNumChannels = 128;

SqliteFile OpenForReading(const std::string& path) {
  std::error_code error;
  if (!std::filesystem::is_regular_file(path, error)) {
    throw InputError("--MultiFrame.dense_feature_path " + path +
                     ": there is no such file.");
  }
  try {
    return SqliteFile(path, SQLITE_OPEN_READONLY);
  } catch (const SqliteError& sqlite_error) {
    throw InputError(path + ": cannot read the file (" + sqlite_error.what() +
                     ").");
  }
}

bool HasTable(const SqliteFile& file, const std::string& name) {
  SqliteStatement query(
      file.Get(),
      "SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = '" + name +
          "'");
  return query.Step();
}

}  // namespace

std::string CanonicalFrameName(const std::string& name) {
  constexpr char kWord[] = "frame";
  constexpr size_t kWordLength = sizeof(kWord) - 1;
  if (name.size() > kWordLength && name.compare(0, kWordLength, kWord) == 0 &&
      name.find_first_not_of("0123456789", kWordLength) == std::string::npos) {
    return CanonicalCameraName(name.substr(kWordLength));
  }
  return CanonicalCameraName(name);
}

FeatureDatabase::FeatureDatabase(const std::string& path)
    : path_(path), file_(OpenForReading(path)) {
  try {
    if (!HasTable(file_, "dense_features")) {
      Fail("it has no table dense_features");
    }
    ReadPatchSize();
    ReadNames();
  } catch (const SqliteError& error) {
    Fail(error.what());
  }
}

void FeatureDatabase::Fail(const std::string& problem) const {
  throw InputError(path_ + " is no usable database of dense features: " +
                   problem + ". Write it anew (write_dense_features).");
}

void FeatureDatabase::ReadPatchSize() {
  format_.patch_size = kDefaultPatchSize;
  format_.num_channels = kDefaultNumChannels;
  if (!HasTable(file_, "dense_feature_info")) return;
  SqliteStatement query(
      file_.Get(),
      "SELECT patch_size, num_channels, pixel_size FROM dense_feature_info");
  if (!query.Step()) Fail("the table dense_feature_info is empty");
  format_.patch_size = sqlite3_column_int(query.Get(), 0);
  format_.num_channels = sqlite3_column_int(query.Get(), 1);
  format_.pixel_size = sqlite3_column_double(query.Get(), 2);
  constexpr int kMaxSize = 1 << 12;
  if (format_.patch_size < 1 || format_.patch_size > kMaxSize ||
      format_.num_channels < 1 || format_.num_channels > kMaxSize ||
      !(format_.pixel_size > 0.0 && format_.pixel_size < kMaxSize)) {
    Fail("the values in the table dense_feature_info are impossible");
  }
  if (query.Step()) Fail("the table dense_feature_info has several rows");
}

void FeatureDatabase::ReadNames() {
  SqliteStatement query(
      file_.Get(),
      "SELECT DISTINCT frame_name, camera_name FROM dense_features");
  const auto value = [&query](int column) {
    return Value(sqlite3_value_dup(sqlite3_column_value(query.Get(), column)),
                 &sqlite3_value_free);
  };
  while (query.Step()) {
    // Before Text, which may convert the value in place.
    std::pair<Value, Value> stored(value(0), value(1));
    const Names names(CanonicalFrameName(query.Text(0)),
                      CanonicalCameraName(query.Text(1)));
    if (!stored_names_.emplace(names, std::move(stored)).second) {
      Fail("frame '" + names.first + "', camera '" + names.second +
           "' is in it under two names that are the same number");
    }
  }
  if (stored_names_.empty()) Fail("the table dense_features is empty");
}

bool FeatureDatabase::HasImage(const std::string& frame_name,
                               const std::string& camera_name) const {
  return stored_names_.count({CanonicalFrameName(frame_name),
                              CanonicalCameraName(camera_name)}) > 0;
}

DenseFeaturePatches FeatureDatabase::Extract(
    const DenseFeatureRequest& request) {
  const auto stored =
      stored_names_.find({CanonicalFrameName(request.frame_name),
                          CanonicalCameraName(request.camera_name)});
  if (stored == stored_names_.end()) {
    return NoPatches(request);
  }
  std::unordered_map<int64_t, size_t> index_of_keypoint;
  for (size_t i = 0; i < request.keypoint_ids.size(); ++i) {
    index_of_keypoint.emplace(request.keypoint_ids[i], i);
  }
  DenseFeaturePatches patches = format_;
  patches.corners.resize(request.keypoints.size(), Eigen::Vector2i::Zero());
  patches.valid.resize(request.keypoints.size(), false);
  patches.data.resize(request.keypoints.size() * patches.PatchNumElements(), 0);
  try {
    SqliteStatement row(
        file_.Get(),
        "SELECT keypoint_id, corner_x, corner_y, dense_feature FROM "
        "dense_features WHERE frame_name = ?1 AND camera_name = ?2");
    sqlite3_bind_value(row.Get(), 1, stored->second.first.get());
    sqlite3_bind_value(row.Get(), 2, stored->second.second.get());
    while (row.Step()) {
      const auto index =
          index_of_keypoint.find(sqlite3_column_int64(row.Get(), 0));
      if (index != index_of_keypoint.end()) {
        ReadRow(request, index->second, &row, &patches);
      }
    }
  } catch (const SqliteError& error) {
    Fail(error.what());
  }
  InvalidateNonFinite(&patches);
  return patches;
}

void FeatureDatabase::ReadRow(const DenseFeatureRequest& request,
                              size_t i,
                              SqliteStatement* row,
                              DenseFeaturePatches* patches) const {
  const std::string where = "frame '" + request.frame_name + "', camera '" +
                            request.camera_name + "', keypoint " +
                            std::to_string(request.keypoint_ids[i]) + ": ";
  if (patches->valid[i]) Fail(where + "two rows");
  const size_t size = patches->PatchNumElements();
  const size_t num_bytes = sqlite3_column_bytes(row->Get(), 3);
  if (sqlite3_column_type(row->Get(), 3) != SQLITE_BLOB ||
      num_bytes != size * sizeof(uint16_t)) {
    Fail(where + "the feature has " + std::to_string(num_bytes) +
         " bytes, but " + std::to_string(patches->patch_size) + " x " +
         std::to_string(patches->patch_size) + " x " +
         std::to_string(patches->num_channels) + " half-precision numbers " +
         "have " + std::to_string(size * sizeof(uint16_t)) +
         " (another size must be in the table dense_feature_info)");
  }
  for (const int axis : {0, 1}) {
    const int64_t corner = sqlite3_column_int64(row->Get(), 1 + axis);
    // A whole number of 64 bits, which would overflow.
    const auto position = static_cast<double>(corner);
    const double begin = (position - 1.0) * patches->pixel_size;
    const double end =
        (position + patches->patch_size + 1.0) * patches->pixel_size;
    if (sqlite3_column_type(row->Get(), 1 + axis) != SQLITE_INTEGER ||
        !(request.keypoints[i][axis] >= begin &&
          request.keypoints[i][axis] <= end) ||
        std::abs(position) > std::numeric_limits<int>::max() / 2) {
      Fail(where + "the patch with the corner (" + row->Text(1) + ", " +
           row->Text(2) + ") does not contain the keypoint at (" +
           std::to_string(request.keypoints[i].x()) + ", " +
           std::to_string(request.keypoints[i].y()) +
           "): the features are those of another model");
    }
    patches->corners[i][axis] = static_cast<int>(corner);
  }
  std::memcpy(
      &patches->data[i * size], sqlite3_column_blob(row->Get(), 3), num_bytes);
  patches->valid[i] = true;
}

}  // namespace mfir

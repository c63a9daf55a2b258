// Dense features in an SQLite file, as "Multi-Cali Anything" stores them:
//
//   CREATE TABLE dense_features(
//       frame_name, camera_name, keypoint_id INTEGER, corner_x INTEGER,
//       corner_y INTEGER, dense_feature BLOB,
//       PRIMARY KEY (frame_name, camera_name, keypoint_id))
//
// A keypoint_id is the index of the 2D point in its image. The blob holds
// half-precision numbers in the order row, column, channel: 16 x 16 x 128 of
// them, unless a second table says otherwise with its single row:
//
//   CREATE TABLE dense_feature_info(
//       patch_size INTEGER, num_channels INTEGER, pixel_size REAL)
//
// Names that are numbers compare as numbers, also when a frame's number follows
// the word "frame": the frame 100 is found for the folder frame000100.

#pragma once

#include <map>
#include <memory>
#include <string>
#include <utility>

#include "colmap_ext/io/sqlite_file.h"
#include "src/dense/dense_features.h"

namespace mfir {

// Reads features from such a file. Keypoints without a row have none.
class FeatureDatabase : public DenseFeatureSource {
 public:
  // Throws InputError: not such a file, no rows, unknown size of the patches,
  // two names that are the same number.
  explicit FeatureDatabase(const std::string& path);

  bool HasImage(const std::string& frame_name,
                const std::string& camera_name) const;

  // Throws InputError for a row whose values do not fit.
  DenseFeaturePatches Extract(const DenseFeatureRequest& request) override;

  bool RepeatsCheaply() const override { return true; }

 private:
  using Value = std::unique_ptr<sqlite3_value, void (*)(sqlite3_value*)>;
  using Names = std::pair<std::string, std::string>;  // frame, camera

  void ReadPatchSize();
  void ReadNames();
  void ReadRow(const DenseFeatureRequest& request,
               size_t i,
               SqliteStatement* row,
               DenseFeaturePatches* patches) const;
  [[noreturn]] void Fail(const std::string& problem) const;

  const std::string path_;
  SqliteFile file_;
  DenseFeaturePatches format_;  // without any patch
  // From comparable names to those that are stored.
  std::map<Names, std::pair<Value, Value>> stored_names_;
};

// The form of a frame's name in which names compare: without leading zeros if
// it is a number, and without the word "frame" before one.
std::string CanonicalFrameName(const std::string& name);

// Passes the features of `source` on and writes them to a file at `path`. The
// file appears, or replaces an earlier one, when Finish is called; without that
// nothing remains. Throws OutputError when it cannot be written, or when there
// is a file that is no such database.
std::unique_ptr<DenseFeatureSource> MakeWritingFeatureSource(
    std::unique_ptr<DenseFeatureSource> source, const std::string& path);

}  // namespace mfir

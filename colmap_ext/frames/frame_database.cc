#include "colmap_ext/frames/frame_database.h"

#include <algorithm>
#include <filesystem>
#include <memory>
#include <set>

#include <sqlite3.h>

#include "colmap_ext/io/camera_models.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;
using colmap::internal::ImageData;

colmap::Camera MakeCamera(const RigCamera& source, size_t camera_idx) {
  colmap::Camera camera;
  camera.SetCameraId(static_cast<colmap::camera_t>(camera_idx + 1));
  camera.SetModelId(CameraModelId(*source.model));
  camera.SetWidth(source.width);
  camera.SetHeight(source.height);
  camera.SetParams(source.params);
  camera.SetPriorFocalLength(true);
  return camera;
}

// Without this, keypoints beyond the mask would be dropped.
void CheckMaskSize(const std::string& mask_path,
                   const colmap::Bitmap& mask,
                   const std::string& image_path,
                   const colmap::Bitmap& image) {
  if (mask.Width() == image.Width() && mask.Height() == image.Height()) return;
  throw InputError(mask_path + " has " + std::to_string(mask.Width()) + " x " +
                   std::to_string(mask.Height()) + " pixels, but the image " +
                   image_path + " has " + std::to_string(image.Width()) +
                   " x " + std::to_string(image.Height()) +
                   ". Give masks of the size of the images.");
}

ImageData ReadImage(const FrameImageFile& file, const RigCamera& camera) {
  ImageData data;
  data.camera = MakeCamera(camera, file.camera_idx);
  data.image.SetImageId(static_cast<colmap::image_t>(file.camera_idx + 1));
  data.image.SetCameraId(data.camera.CameraId());
  data.image.SetName(file.name);
  if (!data.bitmap.Read(file.path, /*as_rgb=*/false)) {
    return data;
  }
  if (static_cast<size_t>(data.bitmap.Width()) != camera.width ||
      static_cast<size_t>(data.bitmap.Height()) != camera.height) {
    throw InputError(file.path + " has " + std::to_string(data.bitmap.Width()) +
                     " x " + std::to_string(data.bitmap.Height()) +
                     " pixels, but the intrinsics of camera '" + camera.name +
                     "' are for " + std::to_string(camera.width) + " x " +
                     std::to_string(camera.height) +
                     ". Give the images of that resolution, or intrinsics of "
                     "this one.");
  }
  if (!file.mask_path.empty()) {
    if (!data.mask.Read(file.mask_path, /*as_rgb=*/false)) {
      throw InputError(file.mask_path +
                       ": cannot read the mask. Replace or remove it.");
    }
    CheckMaskSize(file.mask_path, data.mask, file.path, data.bitmap);
  }
  data.status = colmap::ImageReader::Status::SUCCESS;
  return data;
}

// COLMAP's extraction threads around queues of its own.
class FeatureExtraction {
 public:
  FeatureExtraction(const TriangulatorOptions& options, int num_threads)
      : input_queue_(1),
        resized_queue_(1),
        camera_mask_path_(options.camera_mask_path) {
    if (!options.camera_mask_path.empty()) {
      camera_mask_ = std::make_shared<colmap::Bitmap>();
      if (!camera_mask_->Read(options.camera_mask_path, /*as_rgb=*/false)) {
        throw InputError("--ImageReader.camera_mask_path " +
                         options.camera_mask_path + ": cannot read the mask.");
      }
    }
    resizer_ = std::make_unique<colmap::internal::ImageResizerThread>(
        options.sift_extraction.max_image_size, &input_queue_, &resized_queue_);
    for (int i = 0; i < num_threads; ++i) {
      extractors_.push_back(
          std::make_unique<colmap::internal::SiftFeatureExtractorThread>(
              options.sift_extraction,
              camera_mask_,
              &resized_queue_,
              &output_queue_));
    }
    resizer_->Start();
    for (const auto& extractor : extractors_) extractor->Start();
  }

  ~FeatureExtraction() {
    input_queue_.Stop();
    resized_queue_.Stop();
    resizer_->Wait();
    for (const auto& extractor : extractors_) extractor->Wait();
  }

  // Throws InputError if the mask for all images has another size.
  void Push(ImageData data) {
    if (camera_mask_ != nullptr) {
      CheckMaskSize("--ImageReader.camera_mask_path " + camera_mask_path_,
                    *camera_mask_,
                    data.image.Name(),
                    data.bitmap);
    }
    input_queue_.Push(std::move(data));
  }
  ImageData Pop() { return std::move(output_queue_.Pop().Data()); }

 private:
  colmap::JobQueue<ImageData> input_queue_;
  colmap::JobQueue<ImageData> resized_queue_;
  colmap::JobQueue<ImageData> output_queue_;
  const std::string camera_mask_path_;
  std::shared_ptr<colmap::Bitmap> camera_mask_;  // null: there is none
  std::unique_ptr<colmap::Thread> resizer_;
  std::vector<std::unique_ptr<colmap::Thread>> extractors_;
};

// Extracts and writes the features. Returns the cameras with features.
std::set<size_t> ExtractFeatures(const TriangulatorOptions& options,
                                 const std::vector<RigCamera>& cameras,
                                 const std::vector<FrameImageFile>& files,
                                 int num_threads,
                                 const colmap::Database& database,
                                 std::vector<std::string>* warnings) {
  FeatureExtraction extraction(options, num_threads);
  size_t num_images = 0;
  for (const FrameImageFile& file : files) {
    ImageData data = ReadImage(file, cameras[file.camera_idx]);
    if (data.status == colmap::ImageReader::Status::SUCCESS) {
      extraction.Push(std::move(data));
      ++num_images;
    } else {
      warnings->push_back(file.path +
                          ": cannot read the image; it is left out");
    }
  }
  std::vector<ImageData> images;
  for (size_t i = 0; i < num_images; ++i) {
    images.push_back(extraction.Pop());
    images.back().bitmap.Deallocate();
  }
  // The same database for any number of threads.
  std::sort(
      images.begin(), images.end(), [](const ImageData& a, const ImageData& b) {
        return a.image.ImageId() < b.image.ImageId();
      });
  std::set<size_t> camera_idxs;
  for (const ImageData& data : images) {
    database.WriteCamera(data.camera, /*use_camera_id=*/true);
    database.WriteImage(data.image, /*use_image_id=*/true);
    database.WriteKeypoints(data.image.ImageId(), data.keypoints);
    database.WriteDescriptors(data.image.ImageId(), data.descriptors);
    camera_idxs.insert(data.image.ImageId() - 1);
  }
  if (camera_idxs.size() < 2) {
    throw InputError(std::to_string(camera_idxs.size()) +
                     " readable images; at least 2 are needed");
  }
  return camera_idxs;
}

// Matches pairs with COLMAP's matching threads, and writes the matches.
void MatchFeatures(const TriangulatorOptions& options,
                   const std::vector<std::pair<size_t, size_t>>& pairs,
                   const std::set<size_t>& camera_idxs,
                   int num_threads,
                   const colmap::Database& database) {
  using colmap::internal::FeatureMatcherData;
  colmap::FeatureMatcherCache cache(camera_idxs.size(), &database);
  cache.Setup();
  colmap::JobQueue<FeatureMatcherData> input_queue;
  colmap::JobQueue<FeatureMatcherData> output_queue;
  std::vector<std::unique_ptr<colmap::FeatureMatcherThread>> matchers;
  const bool use_gpu = options.sift_matching.use_gpu;
  for (int i = 0; i < (use_gpu ? 1 : num_threads); ++i) {
    if (use_gpu) {
      matchers.push_back(std::make_unique<colmap::SiftGPUFeatureMatcher>(
          options.sift_matching, &cache, &input_queue, &output_queue));
    } else {
      matchers.push_back(std::make_unique<colmap::SiftCPUFeatureMatcher>(
          options.sift_matching, &cache, &input_queue, &output_queue));
    }
    matchers.back()->Start();
  }
  size_t num_pairs = 0;
  for (const auto& [idx1, idx2] : pairs) {
    if (camera_idxs.count(idx1) == 0 || camera_idxs.count(idx2) == 0) continue;
    FeatureMatcherData data;
    data.image_id1 = static_cast<colmap::image_t>(idx1 + 1);
    data.image_id2 = static_cast<colmap::image_t>(idx2 + 1);
    input_queue.Push(std::move(data));
    ++num_pairs;
  }
  std::vector<FeatureMatcherData> results;
  for (size_t i = 0; i < num_pairs; ++i) {
    results.push_back(std::move(output_queue.Pop().Data()));
  }
  for (const auto& matcher : matchers) matcher->Stop();
  input_queue.Stop();
  for (const auto& matcher : matchers) matcher->Wait();

  std::sort(results.begin(),
            results.end(),
            [](const FeatureMatcherData& a, const FeatureMatcherData& b) {
              return std::make_pair(a.image_id1, a.image_id2) <
                     std::make_pair(b.image_id1, b.image_id2);
            });
  for (const FeatureMatcherData& data : results) {
    database.WriteMatches(data.image_id1, data.image_id2, data.matches);
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

// Condition for rows of the table of cameras that COLMAP can read.
std::string ReadableCameras() {
  std::string condition = "0";
  for (const CameraModel* model : AllCameraModels()) {
    condition +=
        " OR (model = " + std::to_string(CameraModelId(*model)) +
        " AND length(params) = " + std::to_string(8 * model->NumParams()) + ")";
  }
  return condition;
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
  if (Query(database,
            "SELECT count(*) FROM cameras WHERE NOT (" + ReadableCameras() +
                ")") != "0") {
    return "cameras have an unknown model or not as many parameters as it has";
  }
  Query(database,
        "SELECT image_id, name, camera_id, prior_qw, prior_qx, prior_qy, "
        "prior_qz, prior_tx, prior_ty, prior_tz FROM images");
  const std::string kRowsTimesCols = " WHERE length(data) != rows * cols * ";
  if (Query(database,
            "SELECT count(*) FROM keypoints" + kRowsTimesCols +
                "4 OR cols NOT IN (2, 4, 6)") != "0") {
    return "keypoints do not have the size that their table says";
  }
  if (Query(database,
            "SELECT count(*) FROM images WHERE image_id NOT IN (SELECT "
            "image_id FROM keypoints)") != "0") {
    return "an image has no keypoints";
  }
  if (Query(database,
            "SELECT count(*) FROM matches" + kRowsTimesCols +
                "4 OR (cols != 2 AND rows > 0)") != "0") {
    return "matches do not have the size that their table says";
  }
  const auto has_table = [database](const std::string& name) {
    return Query(database,
                 "SELECT count(*) FROM sqlite_master WHERE type = 'table' AND "
                 "name = '" +
                     name + "'") != "0";
  };
  // There may be none, as of other extractors.
  if (has_table("descriptors") &&
      Query(database,
            "SELECT count(*) FROM descriptors" + kRowsTimesCols +
                "1 OR rows < 0 OR (data IS NULL AND rows * cols > 0)") != "0") {
    return "descriptors do not have the size that their table says";
  }
  const bool has_geometries = has_table("two_view_geometries");
  if (has_geometries &&
      Query(database,
            "SELECT count(*) FROM two_view_geometries" + kRowsTimesCols +
                "4 OR (cols != 2 AND rows > 0)") != "0") {
    return "two-view geometries do not have the size that their table says";
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

}  // namespace

void MakeFrameDatabase(const TriangulatorOptions& options,
                       const std::vector<RigCamera>& cameras,
                       const std::vector<FrameImageFile>& files,
                       const std::vector<std::pair<size_t, size_t>>& pairs,
                       int num_threads,
                       const std::string& path,
                       FrameTimings* timings,
                       std::vector<std::string>* warnings) {
  const auto or_given = [num_threads](int option) {
    return option > 0 ? option : num_threads;
  };
  colmap::Database database(path);
  const colmap::DatabaseTransaction transaction(&database);
  colmap::Timer timer;
  timer.Start();
  const std::set<size_t> camera_idxs =
      ExtractFeatures(options,
                      cameras,
                      files,
                      or_given(options.sift_extraction.num_threads),
                      database,
                      warnings);
  timings->extraction = timer.ElapsedSeconds();
  timer.Restart();
  MatchFeatures(options,
                pairs,
                camera_idxs,
                or_given(options.sift_matching.num_threads),
                database);
  timings->matching = timer.ElapsedSeconds();
}

void CopyFrameDatabase(const std::string& source, const std::string& path) {
  for (const std::string suffix : {"", "-wal"}) {
    std::error_code error;
    if (!suffix.empty() && !fs::exists(source + suffix, error)) continue;
    fs::copy_file(source + suffix, path + suffix, error);
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

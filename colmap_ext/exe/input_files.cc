#include "colmap_ext/exe/input_files.h"

#include <algorithm>
#include <filesystem>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "colmap_ext/io/file_hash.h"
#include "src/parallel/parallel_for.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

// The file, or the files of calibrations and models in the folder, sorted.
std::vector<std::string> FilesOf(const std::string& path) {
  static const std::vector<std::string> kExtensions = {
      ".bin", ".txt", ".yml", ".yaml", ".json", ".xml", ".csv"};
  std::error_code error;
  std::vector<std::string> files;
  if (fs::is_regular_file(path, error)) return {path};
  for (fs::directory_iterator it(path, error), end; !error && it != end;
       it.increment(error)) {
    const std::string extension = it->path().extension().string();
    std::error_code ignored;
    if (it->is_regular_file(ignored) &&
        std::find(kExtensions.begin(), kExtensions.end(), extension) !=
            kExtensions.end()) {
      files.push_back(it->path().string());
    }
  }
  std::sort(files.begin(), files.end());
  return files;
}

void AddHashed(const std::string& path, Json* list) {
  for (const std::string& file : FilesOf(path)) {
    try {
      const FileHash hash = HashFile(file);
      list->push_back(
          {{"path", file}, {"bytes", hash.bytes}, {"sha256", hash.sha256}});
    } catch (const InputError&) {
      // It was there when the run began; the result is not lost for that.
    }
  }
}

void AddLarge(const std::string& path, Json* list) {
  std::error_code error;
  const uintmax_t bytes = fs::file_size(path, error);
  if (path.empty() || error) return;
  list->push_back({{"path", path}, {"bytes", bytes}, {"sha256", nullptr}});
}

// Of the models of this rank's frames, side by side.
std::vector<std::string> DescribeFrames(const Capture& capture) {
  // One model may have all frames.
  std::set<std::string> models;
  std::vector<const FrameModel*> frames;
  for (const FrameModel* frame : capture.UsedFrames()) {
    if (models.insert(frame->model_path).second) frames.push_back(frame);
  }
  std::vector<std::string> lists(frames.size());
  ParallelFor(frames.size(), -1, [&](size_t i) {
    Json list = Json::array();
    AddHashed(frames[i]->model_path, &list);
    AddLarge(frames[i]->database_path, &list);
    lists[i] = list.dump(-1, ' ', false, Json::error_handler_t::replace);
  });
  return lists;
}

// Adds the lists of all ranks, each once.
Json AddOfFrames(const Communicator& ranks,
                 const std::vector<std::string>& lists,
                 Json all) {
  std::set<std::string> added;
  for (const std::string& list : Concatenate(ranks, lists)) {
    if (!added.insert(list).second) continue;
    for (const Json& file : Json::parse(list)) all.push_back(file);
  }
  return all;
}

}  // namespace

Json DescribeFiles(const RefinerOptions& options, const Capture& capture) {
  Json list = Json::array();
  for (const std::string& path : {options.extrinsics_path,
                                  options.ground_truth_path,
                                  options.frame_list_path,
                                  options.constant_camera_list_path,
                                  options.multi_frame.features.onnx.path}) {
    AddHashed(path, &list);
  }
  AddLarge(options.multi_frame.features.database_path, &list);
  return AddOfFrames(*capture.ranks, DescribeFrames(capture), std::move(list));
}

}  // namespace mfir

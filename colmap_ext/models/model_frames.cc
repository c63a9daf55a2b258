#include "colmap_ext/models/model_frames.h"

#include <cstdint>
#include <filesystem>
#include <map>
#include <set>

#include "colmap_ext/io/binary_file.h"
#include "colmap_ext/io/input_file.h"
#include "colmap_ext/io/text_file.h"
#include "colmap_ext/models/model_io.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

using ImageIdsOfFrames = std::map<uint32_t, std::vector<uint64_t>>;

// COLMAP's identifier of cameras among sensors.
constexpr int32_t kCameraSensor = 0;

ImageIdsOfFrames ReadBinaryFrames(const std::string& path) {
  constexpr size_t kSensorSize = 4 + 4 + 8;
  BinaryFile file(path, ReadInputFile(path));
  ImageIdsOfFrames frames;
  const uint64_t num = file.ReadCount(4 + 4 + 7 * 8 + 4);
  for (uint64_t i = 0; i < num; ++i) {
    file.SetEntry("frame", i, num);
    const uint32_t frame_id = file.Read<uint32_t>();
    file.Skip(1, 4 + 7 * 8);  // rig and its pose
    const uint32_t num_data = file.Read<uint32_t>();
    if (frames.count(frame_id) > 0) {
      file.Fail("frame id " + std::to_string(frame_id) + " occurs twice");
    }
    file.Require(num_data, kSensorSize);
    std::vector<uint64_t>& image_ids = frames[frame_id];
    for (uint32_t k = 0; k < num_data; ++k) {
      const int32_t sensor = file.Read<int32_t>();
      file.Skip(1, 4);  // sensor id
      const uint64_t image_id = file.Read<uint64_t>();
      if (sensor == kCameraSensor) image_ids.push_back(image_id);
    }
  }
  file.RequireEnd();
  return frames;
}

ImageIdsOfFrames ReadTextFrames(const std::string& path) {
  TextFile file(path, ReadTextFile(path), TextFile::Spacing::kAny);
  ImageIdsOfFrames frames;
  while (file.NextContentLine()) {
    const uint32_t frame_id = file.Number<uint32_t>("FRAME_ID");
    file.Number<uint32_t>("RIG_ID");
    for (const char* field : {"QW", "QX", "QY", "QZ", "TX", "TY", "TZ"}) {
      file.FiniteNumber(field);
    }
    const uint32_t num_data = file.Number<uint32_t>("NUM_DATA_IDS");
    if (frames.count(frame_id) > 0) {
      file.Fail("FRAME_ID " + std::to_string(frame_id) +
                " occurs for the second time");
    }
    std::vector<uint64_t>& image_ids = frames[frame_id];
    for (uint32_t k = 0; k < num_data; ++k) {
      const std::string sensor(file.Token("SENSOR_TYPE"));
      file.Number<uint32_t>("SENSOR_ID");
      const uint64_t image_id = file.Number<uint64_t>("DATA_ID");
      if (sensor == "CAMERA") image_ids.push_back(image_id);
    }
    file.RequireLineEnd("the NUM_DATA_IDS entries of DATA_IDS");
  }
  return frames;
}

}  // namespace

std::vector<std::vector<host::image_t>> ReadModelFrames(
    const std::string& path, const host::Reconstruction& reconstruction) {
  const bool is_binary = IsBinaryModel(path);
  const fs::path file =
      fs::path(path) / (is_binary ? "frames.bin" : "frames.txt");
  std::error_code error;
  if (!fs::is_regular_file(file, error)) return {};
  const auto fail = [&file](uint64_t image_id, const std::string& what) {
    throw InputError(file.string() + ": image " + std::to_string(image_id) +
                     " is of " + what + ". Export the model again.");
  };
  std::vector<std::vector<host::image_t>> result;
  std::set<uint64_t> all;
  for (const auto& [frame_id, image_ids] :
       is_binary ? ReadBinaryFrames(file.string())
                 : ReadTextFrames(file.string())) {
    std::vector<host::image_t> known;
    for (const uint64_t image_id : image_ids) {
      if (!all.insert(image_id).second) fail(image_id, "two frames");
      // Frames may have images that are not registered.
      const auto id = static_cast<host::image_t>(image_id);
      if (id == image_id && reconstruction.ExistsImage(id)) known.push_back(id);
    }
    if (!known.empty()) result.push_back(known);
  }
  for (const auto& [image_id, image] : reconstruction.Images()) {
    if (all.count(image_id) == 0) fail(image_id, "no frame");
  }
  return result;
}

}  // namespace mfir

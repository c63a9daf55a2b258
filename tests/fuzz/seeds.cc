#include "tests/fuzz/seeds.h"

#include "colmap_ext/host/reconstruction.h"
#include "colmap_ext/rigs/rig_io.h"
#include "tests/fuzz/fixtures.h"
#include "tests/support/rig_examples.h"

namespace mfir {
namespace {

std::string Joined(const std::vector<std::string>& parts) {
  std::string text;
  for (size_t i = 0; i < parts.size(); ++i) {
    text += (i > 0 ? kNextFile : "") + parts[i];
  }
  return text;
}

// Two images, one point, a frame: what COLMAP 4 writes, too.
std::vector<std::string> TextModel() {
  return {RigExamples().front().files[0].second,
          "1 0.5 0.5 -0.5 0.5 2 3 -1 1 a.png\n422.0 60.05 1\n"
          "2 1 0 0 0 0 0 0 2 b.png\n1420 340 1 3 4 -1\n",
          "# points\n1 11 1 5 0 0 0 0.5 1 0 2 0\n",
          "1 1 1 0 0 0 0 0 0 2 CAMERA 1 1 CAMERA 2 2\n"};
}

template <typename T>
std::string Bytes(const T& value) {
  return {reinterpret_cast<const char*>(&value), sizeof(T)};
}

std::string BinaryModel() {
  const TemporaryFolder folder;
  const std::vector<std::string> text = TextModel();
  for (size_t i = 0; i < 3; ++i) {
    WriteFile(folder / FuzzTargets().front().files[i], text[i]);
  }
  host::Reconstruction model;
  host::ReadReconstruction(folder.Path(), /*is_binary=*/false, &model);
  model.WriteBinary(folder.Path());
  std::string frames = Bytes(uint64_t(1)) + Bytes(uint32_t(1)) +
                       std::string(4 + 7 * 8, '\0') + Bytes(uint32_t(2));
  for (const uint32_t id : {1, 2}) {
    frames += Bytes(int32_t(0)) + Bytes(id) + Bytes(uint64_t(id));
  }
  return Joined({ReadFile(folder / "cameras.bin"),
                 ReadFile(folder / "images.bin"),
                 ReadFile(folder / "points3D.bin"),
                 frames});
}

std::vector<std::string> RigSeeds(const std::string& format) {
  std::vector<std::string> seeds;
  for (const RigExample& example : RigExamples()) {
    const bool is_file = example.files.size() == 1;
    if (example.format != format && !(format == "auto" && is_file)) continue;
    std::vector<std::string> files;
    for (const auto& name_and_content : example.files) {
      files.push_back(name_and_content.second);
    }
    seeds.push_back(Joined(files));
  }
  return seeds;
}

}  // namespace

std::vector<std::string> FuzzSeeds(const FuzzTarget& target) {
  const std::string& name = target.name;
  if (name == "model_text") return {Joined(TextModel())};
  if (name == "model_binary") return {BinaryModel()};
  if (name.rfind("rig_", 0) == 0) return RigSeeds(name.substr(4));
  if (name == "name_list") return {"# frames\nframe 1\n\nframe2\r\n"};
  if (name == "ini") {
    return {
        "# options\ninput_path=a b\nlog_level=2\n[MultiFrame]\ncount=3\n"
        "weight=2.5e-3\nflag=true\n[Mapper]\nx=\"#1\"\n"};
  }
  if (name == "names") {
    return {"\n\ncam07/000123.jpg\ncam08/000123.jpg\n",
            "\n\n000123/cam07.jpg\n000123/cam08.jpg\ncamera1_frame2.png\n",
            "camera(\\d+)\n_f(.*)\\.png\ncamera1_f2.png\ncamera2_f2.png\n",
            "\n\ncam07_12.jpg\ncam08_12.jpg\na/b/../c.png\n"};
  }
  if (name == "feature_database") return {FixtureFeatureDatabase()};
  if (name == "feature_database_sql") {
    return {"UPDATE dense_features SET corner_x = 1e30",
            "UPDATE dense_feature_info SET patch_size = 4096",
            "INSERT INTO dense_features VALUES('f', 1, 3, 18, 28, x'00')"};
  }
  if (name == "frame_database") return {FixtureFrameDatabase()};
  if (name == "frame_database_sql") {
    return {"UPDATE matches SET data = zeroblob(96)",
            "UPDATE keypoints SET rows = 2, data = zeroblob(48)",
            "UPDATE images SET name = '../x' WHERE image_id = 1",
            "UPDATE cameras SET width = -1, params = NULL",
            "DELETE FROM descriptors; UPDATE matches SET pair_id = 7"};
  }
  if (name == "summary") return {FixtureSummary()};
  return {};
}

}  // namespace mfir

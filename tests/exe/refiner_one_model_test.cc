// One model that holds many frames, as input and as output.

#include <algorithm>
#include <filesystem>
#include <functional>

#include "colmap_ext/host/reconstruction.h"
#include "colmap_ext/host/rig_model.h"
#include "tests/support/frames_file.h"
#include "tests/support/refiner_runner.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

using NewName = std::function<std::string(const std::string& frame,
                                          const std::string& image)>;

class RefinerOneModelTest : public RefinerReferenceTest {
 protected:
  // Writes all frames, each in its own coordinates and with its own
  // intrinsics, as the model model/.
  void MergeFrames(const NewName& new_name) {
    host::Reconstruction merged;
    frame_image_ids_.clear();
    for (const std::string frame : kFrames) {
      const host::Reconstruction model = Read(ModelPath(frame));
      std::vector<host::image_t> ids = model.RegImageIds();
      std::sort(ids.begin(), ids.end());
      std::map<host::image_t, host::image_t> new_ids;
      std::vector<uint32_t> frame_ids;
      for (const host::image_t id : ids) {
        const host::Image& image = model.Image(id);
        const host::Camera& camera = model.Camera(image.CameraId());
        const auto new_id = static_cast<host::image_t>(merged.NumImages() + 1);
        host::AddCameraWithTrivialRig(host::MakeCamera(new_id,
                                                       host::ModelId(camera),
                                                       host::Width(camera),
                                                       host::Height(camera),
                                                       host::Params(camera)),
                                      &merged);
        host::Image copy = host::CopyOfImage(image);
        copy.SetImageId(new_id);
        copy.SetCameraId(new_id);
        copy.SetName(new_name(frame, image.Name()));
        host::AddImageWithTrivialFrame(
            copy, host::CamFromWorld(image), &merged);
        new_ids[id] = new_id;
        frame_ids.push_back(new_id);
      }
      host::AddPoints3D(new_ids, model, &merged);
      frame_image_ids_.push_back(frame_ids);
    }
    WriteBinary(merged, Path("model"));
  }

  void ExpectSameAsReference(CommandOptions options = {}) {
    options["input_path"] = Path("model");
    ExpectRefines(options);
    // COLMAP 4 composes poses of rigs and of cameras in them.
    EXPECT_LT(MaxRelativeDifference(Params(), reference_), 1e-9)
        << testing::PrintToString(options);
  }

  std::vector<std::string> FrameNames() const {
    std::vector<std::string> names;
    const nlohmann::json summary = Summary();
    for (const nlohmann::json& frame : summary["frames"]) {
      names.push_back(frame["name"]);
    }
    return names;
  }

  std::vector<std::vector<uint32_t>> frame_image_ids_;
};

const std::vector<std::string> kNames = {
    "frame000000", "frame000001", "frame000002"};

TEST_F(RefinerOneModelTest, FoldersOfFrames) {
  MergeFrames([](const std::string& frame, const std::string& image) {
    return frame + "/" + image;
  });
  ExpectSameAsReference();
  EXPECT_EQ(FrameNames(), kNames);
  EXPECT_TRUE(fs::exists(Path("out/frames/frame000001/points3D.bin")));
}

TEST_F(RefinerOneModelTest, FoldersOfCameras) {
  MergeFrames([](const std::string& frame, const std::string& image) {
    return fs::path(image).stem().string() + "/" + frame + ".png";
  });
  ExpectSameAsReference();
  EXPECT_EQ(FrameNames(), kNames);
}

TEST_F(RefinerOneModelTest, Regex) {
  MergeFrames([](const std::string& frame, const std::string& image) {
    return frame + "_" + image;
  });
  ExpectSameAsReference({{"MultiFrame.frame_name_regex", "^(frame\\d+)_"},
                         {"MultiFrame.camera_name_regex", "(cam\\d+)"}});
  EXPECT_EQ(FrameNames(), kNames);
  ExpectError(kExitBadInput,
              {"frame_name_regex matches no image", "frame000000_"},
              {{"input_path", Path("model")},
               {"MultiFrame.frame_name_regex", "^shot(\\d+)"}});
  ExpectError(kExitUsage,
              {"frame_name_regex", "2 capture groups"},
              {{"input_path", Path("model")},
               {"MultiFrame.frame_name_regex", "(a)(b)"}});
  // All images are then of one frame.
  ExpectError(kExitBadInput,
              {"belong to the same camera", "frame_name_regex"},
              {{"input_path", Path("model")},
               {"MultiFrame.camera_name_regex", "(cam\\d+)"}});
}

TEST_F(RefinerOneModelTest, FramesOfColmap4) {
  // Names that say nothing of the frame.
  MergeFrames([n = 0](const std::string&, const std::string& image) mutable {
    return fs::path(image).stem().string() + "_" + std::to_string(n++) + ".png";
  });
  WriteFile(Path("model/frames.bin"), FramesFile(frame_image_ids_));
  // Which tracks are held out depends on the names of the frames.
  ExpectRefines(
      {{"MultiFrame.held_out_share", "0"}, {"output_path", Path("reference")}});
  reference_ = Params("reference");
  ExpectSameAsReference({{"MultiFrame.held_out_share", "0"},
                         {"MultiFrame.camera_name_regex", "^(cam\\d+)"}});
  EXPECT_EQ(FrameNames(),
            std::vector<std::string>({"frame1", "frame2", "frame3"}));
  const std::string bytes = ReadFile(Path("model/frames.bin"));
  WriteFile(Path("model/frames.bin"), bytes.substr(0, bytes.size() / 2));
  ExpectError(kExitBadInput,
              {"frames.bin: frame 2 of 3"},
              {{"input_path", Path("model")},
               {"MultiFrame.camera_name_regex", "^(cam\\d+)"}});
}

TEST_F(RefinerOneModelTest, ListOfFrames) {
  MergeFrames([](const std::string& frame, const std::string& image) {
    return frame + "/" + image;
  });
  WriteFile(Path("list"), "frame000002\nframe000000\n");
  ExpectRefines(
      {{"frame_list_path", Path("list")}, {"output_path", Path("reference")}});
  reference_ = Params("reference");
  ExpectSameAsReference({{"frame_list_path", Path("list")}});
  WriteFile(Path("list"), "frame000002\nframe000007\n");
  ExpectError(
      kExitBadInput,
      {"list:2: there is no frame 'frame000007'"},
      {{"input_path", Path("model")}, {"frame_list_path", Path("list")}});
}

TEST_F(RefinerOneModelTest, OutputModelIsTheResult) {
  const host::Reconstruction model = Read(Path("reference/model"));
  const host::Reconstruction rig = Read(Path("reference/rig"));
  EXPECT_EQ(model.NumCameras(), rig.NumCameras());
  size_t num_points = 0;
  size_t num_images = 0;
  for (const std::string frame : kFrames) {
    const host::Reconstruction part = Read(Path("reference/frames/" + frame));
    num_points += part.NumPoints3D();
    for (const auto& [id, image] : part.Images()) {
      const host::Image* found =
          model.FindImageWithName(frame + "/" + image.Name());
      ASSERT_NE(found, nullptr) << image.Name();
      EXPECT_EQ(found->NumPoints3D(), image.NumPoints3D());
      const Rigid3 pose = host::CamFromWorld(*found);
      const Rigid3 known = host::CamFromWorld(image);
      // COLMAP 4 multiplies the poses of rig and camera.
      EXPECT_LT((pose.rotation.coeffs() - known.rotation.coeffs()).norm(),
                1e-14);
      EXPECT_LT((pose.translation - known.translation).norm(),
                1e-13 * known.translation.norm());
      EXPECT_EQ(host::Params(model.Camera(found->CameraId())),
                host::Params(part.Camera(image.CameraId())));
      ++num_images;
    }
  }
  EXPECT_EQ(model.NumImages(), num_images);
  EXPECT_EQ(model.NumPoints3D(), num_points);
  EXPECT_EQ(fs::exists(Path("reference/model/rigs.bin")), host::kHasRigs);
}

TEST_F(RefinerOneModelTest, OutputModelIsAnInput) {
  ExpectRefines({{"input_path", Path("reference/model")}});
  EXPECT_EQ(FrameNames(), kNames);
  EXPECT_LT(MaxRelativeDifference(Params(), reference_), 1e-6);
}

TEST_F(RefinerOneModelTest, CommandsOfColmapTakeTheOutputModel) {
  const std::string model = Path("reference/model");
  fs::create_directory(Path("text"));
  for (const std::vector<std::string>& arguments :
       std::vector<std::vector<std::string>>{
           {"model_analyzer", "--path", model},
           {"model_converter",
            "--input_path",
            model,
            "--output_path",
            Path("text"),
            "--output_type",
            "TXT"},
           {"bundle_adjuster",
            "--input_path",
            model,
            "--output_path",
            Path("text")}}) {
    const CommandResult result = RunColmap(arguments);
    EXPECT_EQ(result.exit_code, 0) << arguments[0] << result.error;
  }
  ExpectRefines({{"input_path", Path("text")}});
}

TEST_F(RefinerOneModelTest, NoOutputModelWhereFramesHaveOwnIntrinsics) {
  ExpectRefines({{"MultiFrame.preset", "paper"},
                 {"MultiFrame.max_prior_weight", "0"},
                 {"MultiFrame.focal_variance_weight", "0"},
                 {"MultiFrame.principal_point_variance_weight", "0"},
                 {"MultiFrame.extra_params_variance_weight", "0"},
                 {"output_path", Path("reference")}});
  EXPECT_TRUE(fs::exists(Path("reference/rig")));
  EXPECT_FALSE(fs::exists(Path("reference/model")));
}

}  // namespace
}  // namespace mfir

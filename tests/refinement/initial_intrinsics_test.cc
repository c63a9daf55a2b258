#include "src/refinement/initial_intrinsics.h"

#include <algorithm>
#include <vector>

#include <gtest/gtest.h>

#include "tests/support/test_scenes.h"

namespace mfir {
namespace {

MultiFrameOptions InitialOptions(double loss_scale) {
  MultiFrameOptions options;
  options.ApplyPreset("accurate");
  options.loss_scale = loss_scale;
  options.num_threads = 2;
  return options;
}

TEST(InitializeIntrinsics, TakesTheMedianOfTheFrames) {
  TestSceneOptions scene_options;
  scene_options.num_frames = 3;
  SceneEstimate scene = MakeTestScene(scene_options).start;
  const SceneEstimate before = scene;
  scene = InitializeIntrinsics(InitialOptions(0.0), scene);
  for (size_t i = 0; i < scene.estimate.cameras.size(); ++i) {
    for (size_t j = 0; j < 4; ++j) {
      EXPECT_EQ(scene.estimate.cameras[i].params[j],
                Median3(before.estimate.frames[0].images[i].params[j],
                        before.estimate.frames[1].images[i].params[j],
                        before.estimate.frames[2].images[i].params[j]));
      EXPECT_EQ(scene.estimate.frames[1].images[i].params[j],
                before.estimate.frames[1].images[i].params[j]);
    }
  }
}

TEST(InitializeIntrinsics, EvenNumberOfFramesAndMissingImages) {
  TestSceneOptions scene_options;
  scene_options.num_frames = 3;
  SceneEstimate scene = MakeTestScene(scene_options).start;
  scene.scene.frames[2].images.pop_back();
  scene.estimate.frames[2].images.pop_back();
  const size_t last = scene.estimate.cameras.size() - 1;
  scene = InitializeIntrinsics(InitialOptions(0.0), scene);
  EXPECT_DOUBLE_EQ(scene.estimate.cameras[last].params[0],
                   0.5 * (scene.estimate.frames[0].images[last].params[0] +
                          scene.estimate.frames[1].images[last].params[0]));
}

TEST(InitializeIntrinsics, HeldParametersAreEqualInAllFrames) {
  SceneEstimate scene = MakeTestScene({}).start;
  MultiFrameOptions options = InitialOptions(0.0);
  options.refine_principal_point = false;
  scene = InitializeIntrinsics(options, scene);
  for (const FrameEstimate& frame : scene.estimate.frames) {
    for (size_t i = 0; i < frame.images.size(); ++i) {
      const ImageEstimate& image = frame.images[i];
      const std::vector<double>& global = scene.estimate.cameras[i].params;
      EXPECT_NE(image.params[0], global[0]);
      EXPECT_EQ(image.params[2], global[2]);
      EXPECT_EQ(image.params[3], global[3]);
    }
  }
}

TEST(InitializeIntrinsics, ImplausibleImagesDoNotCount) {
  TestSceneOptions scene_options;
  scene_options.num_frames = 3;
  SceneEstimate scene = MakeTestScene(scene_options).start;
  const SceneEstimate before = scene;
  const double width = static_cast<double>(scene.estimate.cameras[0].width);
  const double height = static_cast<double>(scene.estimate.cameras[0].height);
  ASSERT_GT(width, 0.0);
  // One of three frames, and all frames of another camera.
  scene.estimate.frames[1].images[0].params[0] *= 100.0;
  for (FrameEstimate& frame : scene.estimate.frames) {
    frame.images[1].params[2] = -5.0;
  }
  scene = InitializeIntrinsics(InitialOptions(0.0), scene);
  for (size_t j = 0; j < 4; ++j) {
    EXPECT_DOUBLE_EQ(scene.estimate.cameras[0].params[j],
                     0.5 * (before.estimate.frames[0].images[0].params[j] +
                            before.estimate.frames[2].images[0].params[j]));
  }
  EXPECT_EQ(scene.estimate.cameras[1].params[2], 0.5 * width);
  EXPECT_EQ(scene.estimate.cameras[1].params[3], 0.5 * height);
  std::vector<double> others;
  for (size_t i = 0; i < scene.estimate.cameras.size(); ++i) {
    if (i != 1) others.push_back(scene.estimate.cameras[i].params[0]);
  }
  std::sort(others.begin(), others.end());
  EXPECT_EQ(scene.estimate.cameras[1].params[0], others[others.size() / 2]);
  EXPECT_EQ(scene.scene.cameras[1].params, scene.estimate.cameras[1].params);
}

// Structure from motion can end with distortion that is out of this world. A
// camera that started from it lost its focal length (convergence.sh,
// robovision12/frames_sfm with SIMPLE_RADIAL, seeds 15, 27, 34, 37, 67, 72).
TEST(InitializeIntrinsics, ImplausibleDistortionDoesNotCount) {
  TestSceneOptions scene_options;
  scene_options.model = "SIMPLE_RADIAL";
  scene_options.num_frames = 3;
  SceneEstimate scene = MakeTestScene(scene_options).start;
  const SceneEstimate before = scene;
  scene.estimate.frames[1].images[0].params[3] = 6e5;  // one of three frames
  for (FrameEstimate& frame : scene.estimate.frames) {
    frame.images[1].params[3] = -6e5;
  }
  scene = InitializeIntrinsics(InitialOptions(0.0), scene);
  EXPECT_DOUBLE_EQ(scene.estimate.cameras[0].params[3],
                   0.5 * (before.estimate.frames[0].images[0].params[3] +
                          before.estimate.frames[2].images[0].params[3]));
  std::vector<double> others;
  for (size_t i = 0; i < scene.estimate.cameras.size(); ++i) {
    if (i != 1) others.push_back(scene.estimate.cameras[i].params[3]);
  }
  std::sort(others.begin(), others.end());
  EXPECT_EQ(scene.estimate.cameras[1].params[3], others[others.size() / 2]);
}

TEST(InitializeIntrinsics, TypicalLensesArePlausible) {
  for (const CameraModel* model : AllCameraModels()) {
    TestSceneOptions scene_options;
    scene_options.model = model->Name();
    SceneEstimate scene = MakeTestScene(scene_options).start;
    const std::vector<double> params =
        scene.estimate.frames[0].images[1].params;
    for (FrameEstimate& frame : scene.estimate.frames) {
      frame.images[1].params = params;
    }
    scene = InitializeIntrinsics(InitialOptions(0.0), scene);
    EXPECT_EQ(scene.estimate.cameras[1].params, params) << model->Name();
  }
}

}  // namespace
}  // namespace mfir

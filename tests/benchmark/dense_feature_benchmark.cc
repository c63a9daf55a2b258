// Time of the extraction of dense features, without the refinement:
//
//   ninja -C build dense_feature_benchmark
//   build/bin/dense_feature_benchmark --input_path FRAMES --image_path IMAGES
//       --MultiFrame.dense_features sift [--MultiFrame.OPTION VALUE ...]
//
// prints the number of images and patches, and the seconds of CPU time in user
// mode per 10^6 feature pixels of all patches and per 10^6 pixels of the
// images.

#include <sys/resource.h>

#include <filesystem>
#include <iostream>

#include "colmap_ext/exe/command.h"
#include "colmap_ext/feature/dense_feature_sources.h"
#include "colmap_ext/frames/frames.h"
#include "colmap_ext/host/log.h"
#include "colmap_ext/models/model_io.h"
#include "src/sensor/camera_naming.h"

namespace mfir {
namespace {

// Images of one frame with the keypoints that have a 3D point.
void AddRequests(const std::string& frames_path,
                 const std::string& frame_name,
                 std::vector<DenseFeatureRequest>* requests) {
  host::Reconstruction model;
  ReadModel(FindSparseModel(
                (std::filesystem::path(frames_path) / frame_name).string()),
            true,
            &model);
  for (const auto& id_and_image : model.Images()) {
    const host::Image& image = id_and_image.second;
    const host::Camera& camera = model.Camera(image.CameraId());
    DenseFeatureRequest request;
    request.frame_name = frame_name;
    request.camera_name = CameraNaming().Names({image.Name()})[0];
    request.image_name = image.Name();
    request.width = static_cast<int>(host::Width(camera));
    request.height = static_cast<int>(host::Height(camera));
    for (host::point2D_t i = 0; i < image.NumPoints2D(); ++i) {
      if (!image.Point2D(i).HasPoint3D()) continue;
      request.keypoints.push_back(host::Xy(image.Point2D(i)));
      request.keypoint_ids.push_back(i);
    }
    requests->push_back(request);
  }
}

double UserSeconds() {
  rusage usage;
  getrusage(RUSAGE_SELF, &usage);
  return usage.ru_utime.tv_sec + 1e-6 * usage.ru_utime.tv_usec;
}

void Measure(int argc, char** argv) {
  std::string frames_path;
  std::string image_path;
  std::string frame_list_path;
  MultiFrameOptions options;
  OptionParser parser;
  parser.AddRequired("input_path", &frames_path, "Folder of frames");
  parser.Add("image_path", &image_path, "Images");
  parser.Add("frame_list_path", &frame_list_path, "Frames to use");
  parser.Add("MultiFrame.num_threads", &options.num_threads, "-1: all");
  AddDenseFeatureOptions(&options, &parser);
  parser.Parse(argc, argv);
  options.Check();

  std::vector<DenseFeatureRequest> requests;
  for (const std::string& name :
       ListFrames("input_path", frames_path, frame_list_path)) {
    AddRequests(frames_path, name, &requests);
  }
  const auto source = MakeDenseFeatureSource(
      options, image_path, requests, [](const std::string& line) {
        std::cout << line << std::endl;
      });
  const double start = UserSeconds();
  double image_pixels = 0.0;
  double patch_pixels = 0.0;
  size_t num_patches = 0;
  for (const DenseFeatureRequest& request : requests) {
    const DenseFeaturePatches patches = source->Extract(request);
    num_patches += std::count(patches.valid.begin(), patches.valid.end(), true);
    image_pixels += 1.0 * request.width * request.height;
    patch_pixels += 1.0 * request.keypoints.size() * patches.patch_size *
                    patches.patch_size;
  }
  source->Finish();
  const double seconds = UserSeconds() - start;
  rusage usage;
  getrusage(RUSAGE_SELF, &usage);
  std::cout << requests.size() << " images, " << num_patches << " patches, "
            << seconds << " user CPU s: " << 1e6 * seconds / patch_pixels
            << " per 10^6 feature pixels, " << 1e6 * seconds / image_pixels
            << " per 10^6 image pixels; peak " << usage.ru_maxrss / 1024
            << " MiB" << std::endl;
}

}  // namespace
}  // namespace mfir

int main(int argc, char** argv) {
  mfir::host::InitializeLog(argv);
  return mfir::RunCommand([argc, argv]() { mfir::Measure(argc, argv); });
}

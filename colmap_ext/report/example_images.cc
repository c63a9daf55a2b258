#include "colmap_ext/report/example_images.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <filesystem>

#include "colmap_ext/feature/image_folder.h"
#include "colmap_ext/host/image_file.h"
#include "src/report/html.h"
#include "src/report/residuals.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr int kMaxImageSize = 900;  // px
constexpr size_t kMaxExamplePoints = 400;

std::string Base64(const std::vector<uint8_t>& bytes) {
  static const char kDigits[] =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  for (size_t i = 0; i < bytes.size(); i += 3) {
    uint32_t bits = 0;
    for (size_t j = 0; j < 3; ++j) {
      bits = bits << 8 | (i + j < bytes.size() ? bytes[i + j] : 0u);
    }
    for (size_t j = 0; j < 4; ++j) {
      text += i + j <= bytes.size() ? kDigits[bits >> (18 - 6 * j) & 63] : '=';
    }
  }
  return text;
}

std::vector<ExamplePoint> Points(const host::Reconstruction& frame,
                                 const host::Image& image,
                                 const std::vector<double>& params_before,
                                 size_t camera_idx,
                                 const Report& report) {
  const CameraModel& model = *report.cameras[camera_idx].model;
  const std::vector<double>& params =
      host::Params(frame.Camera(image.CameraId()));
  const Rigid3 pose = host::CamFromWorld(image);
  std::vector<ExamplePoint> points;
  for (const host::Point2D& point2D : image.Points2D()) {
    if (!point2D.HasPoint3D()) continue;
    const Eigen::Vector3d& xyz =
        host::Xyz(frame.Point3D(host::Point3DId(point2D)));
    const Eigen::Vector2d keypoint = host::Xy(point2D);
    const Eigen::Vector2d after = ProjectPoint(model, params, pose, xyz);
    if (!((after - keypoint).norm() <= report.max_inlier_px)) continue;
    points.push_back(
        {keypoint, ProjectPoint(model, params_before, pose, xyz), after});
  }
  const size_t step = std::max<size_t>(1, points.size() / kMaxExamplePoints);
  std::vector<ExamplePoint> some;
  for (size_t i = 0; i < points.size(); i += step) some.push_back(points[i]);
  return some;
}

double Rms(const Report& report, size_t camera_idx) {
  return NumberAt(report.summary,
                  "/cameras/" + std::to_string(camera_idx) + "/rms_px_after");
}

// Its file, "" if there is none.
std::string FindFile(const ImageFolder& folder,
                     const std::string& frame_name,
                     const host::Image& image,
                     const Report& report) {
  DenseFeatureRequest request;
  request.frame_name = frame_name;
  request.camera_name = report.cameras[image.CameraId() - 1].name;
  request.image_name = image.Name();
  return folder.Find(request);
}

}  // namespace

void AddExamples(const std::string& frame_name,
                 const host::Reconstruction& frame,
                 Report* report) {
  const std::string image_path = TextAt(report->summary, "/inputs/image_path");
  if (image_path.empty()) {
    report->examples_remark = "No images were given (--image_path).";
    return;
  }
  report->examples_remark = "The images of frame '" + frame_name +
                            "' are no longer in " + image_path + ".";
  std::vector<const host::Image*> images;
  const ImageFolder folder(image_path);
  for (const auto& id_and_image : frame.Images()) {
    const host::Image& image = id_and_image.second;
    if (std::isfinite(Rms(*report, image.CameraId() - 1)) &&
        !FindFile(folder, frame_name, image, *report).empty()) {
      images.push_back(&image);
    }
  }
  if (images.empty()) return;
  std::sort(
      images.begin(),
      images.end(),
      [&](const host::Image* a, const host::Image* b) {
        return std::make_pair(-Rms(*report, a->CameraId() - 1), a->Name()) <
               std::make_pair(-Rms(*report, b->CameraId() - 1), b->Name());
      });
  std::vector<size_t> chosen = {0, images.size() / 2, images.size() - 1};
  chosen.erase(std::unique(chosen.begin(), chosen.end()), chosen.end());
  for (const size_t i : chosen) {
    const host::Image& image = *images[i];
    const size_t camera_idx = image.CameraId() - 1;
    const ReportCamera& camera = report->cameras[camera_idx];
    host::Bitmap bitmap;
    if (!bitmap.Read(FindFile(folder, frame_name, image, *report)) ||
        static_cast<size_t>(bitmap.Width()) != camera.width ||
        static_cast<size_t>(bitmap.Height()) != camera.height) {
      continue;
    }
    host::Thumbnail(kMaxImageSize, &bitmap);
    const auto before = report->summary["cameras"][camera_idx]
                            .at("params_initial")
                            .get<std::vector<double>>();
    report->examples.push_back(
        {camera_idx,
         frame_name,
         image.Name(),
         Base64(host::EncodeJpeg(bitmap)),
         Points(frame, image, before, camera_idx, *report)});
  }
}

}  // namespace mfir

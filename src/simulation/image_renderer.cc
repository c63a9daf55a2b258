#include "src/simulation/image_renderer.h"

#include <algorithm>
#include <cmath>

namespace mfir {
namespace {

// Samples per pixel and axis.
constexpr size_t kSupersampling = 2;
constexpr float kBackground = 0.16f;

using FloatImage = std::vector<float>;

// What is seen at a corner of four pixels.
struct Corner {
  Eigen::Vector3d ray;     // unit vector in the world
  double distance = -1.0;  // to the surface; negative: background
};

// (width + 1) * (height + 1), row-major.
std::vector<Corner> TraceCorners(const SyntheticSurface& surface,
                                 const RigCamera& camera) {
  const Eigen::Vector3d origin = camera.cam_from_world.Center();
  const Eigen::Matrix3d world_from_cam =
      camera.cam_from_world.rotation.conjugate().toRotationMatrix();
  std::vector<Corner> corners;
  corners.reserve((camera.width + 1) * (camera.height + 1));
  for (size_t y = 0; y <= camera.height; ++y) {
    for (size_t x = 0; x <= camera.width; ++x) {
      Eigen::Vector2d uv;
      camera.model->Unproject(camera.params.data(), x, y, uv.data());
      Corner corner;
      corner.ray = (world_from_cam * uv.homogeneous()).normalized();
      corner.distance = surface.Intersect(origin, corner.ray).value_or(-1.0);
      corners.push_back(corner);
    }
  }
  return corners;
}

// Brightness in [0, 1] at the point (dx, dy) of a pixel; `top` and `bottom`
// point to its left corners. Rays are interpolated: within a pixel every lens
// is linear to far below a thousandth of a pixel.
float SamplePixel(const SyntheticSurface& surface,
                  const Eigen::Vector3d& origin,
                  const Corner* top,
                  const Corner* bottom,
                  double dx,
                  double dy) {
  const double weights[] = {
      (1.0 - dx) * (1.0 - dy), dx * (1.0 - dy), (1.0 - dx) * dy, dx * dy};
  const Corner* corners[] = {top, top + 1, bottom, bottom + 1};
  Eigen::Vector3d ray = Eigen::Vector3d::Zero();
  double distance = 0.0;
  double min_distance = corners[0]->distance;
  double max_distance = corners[0]->distance;
  for (int i = 0; i < 4; ++i) {
    ray += weights[i] * corners[i]->ray;
    distance += weights[i] * corners[i]->distance;
    min_distance = std::min(min_distance, corners[i]->distance);
    max_distance = std::max(max_distance, corners[i]->distance);
  }
  ray.normalize();
  if (max_distance < 0.0) {
    return kBackground;
  }
  // One smooth piece of surface unless its depth varies by several pixels'
  // size.
  const double pixel_size =
      (corners[0]->ray - corners[3]->ray).norm() * max_distance;
  if (min_distance > 0.0 && max_distance - min_distance < 5.0 * pixel_size) {
    distance = surface.RefineIntersection(origin, ray, distance);
  } else if (const auto hit = surface.Intersect(origin, ray)) {
    distance = *hit;
  } else {
    return kBackground;
  }
  const Eigen::Vector3d direction = (origin + distance * ray).normalized();
  return static_cast<float>(surface.Brightness(direction) +
                            surface.Reflection(direction, ray));
}

// Brightness in [0, 1] at the centres of all kSupersampling^2 parts of all
// pixels.
FloatImage SampleSurface(const SyntheticSurface& surface,
                         const RigCamera& camera) {
  const std::vector<Corner> corners = TraceCorners(surface, camera);
  const Eigen::Vector3d origin = camera.cam_from_world.Center();
  const size_t width = kSupersampling * camera.width;
  const size_t height = kSupersampling * camera.height;
  FloatImage samples;
  samples.reserve(width * height);
  for (size_t y = 0; y < height; ++y) {
    for (size_t x = 0; x < width; ++x) {
      const Corner* top = &corners[(y / kSupersampling) * (camera.width + 1) +
                                   x / kSupersampling];
      samples.push_back(
          SamplePixel(surface,
                      origin,
                      top,
                      top + camera.width + 1,
                      (x % kSupersampling + 0.5) / kSupersampling,
                      (y % kSupersampling + 0.5) / kSupersampling));
    }
  }
  return samples;
}

// Convolution of each row with a Gaussian, written to the columns of `output`;
// two calls blur in both directions.
void BlurRowsTransposed(const FloatImage& input,
                        size_t width,
                        size_t height,
                        const std::vector<float>& kernel,
                        FloatImage* output) {
  const int radius = static_cast<int>(kernel.size() / 2);
  for (size_t y = 0; y < height; ++y) {
    for (int x = 0; x < static_cast<int>(width); ++x) {
      float sum = 0.0f;
      for (int i = -radius; i <= radius; ++i) {
        const int xi = std::clamp(x + i, 0, static_cast<int>(width) - 1);
        sum += kernel[i + radius] * input[y * width + xi];
      }
      (*output)[x * height + y] = sum;
    }
  }
}

void Blur(double sigma, size_t width, size_t height, FloatImage* image) {
  const int radius = static_cast<int>(std::ceil(3.0 * sigma));
  std::vector<float> kernel;
  float sum = 0.0f;
  for (int i = -radius; i <= radius; ++i) {
    kernel.push_back(
        static_cast<float>(std::exp(-0.5 * i * i / sigma / sigma)));
    sum += kernel.back();
  }
  for (float& weight : kernel) {
    weight /= sum;
  }
  FloatImage transposed(image->size());
  BlurRowsTransposed(*image, width, height, kernel, &transposed);
  BlurRowsTransposed(transposed, height, width, kernel, image);
}

}  // namespace

GreyImage RenderImage(const SyntheticSurface& surface,
                      const RigCamera& camera,
                      double blur_px,
                      double noise_grey,
                      Random* random) {
  FloatImage samples = SampleSurface(surface, camera);
  const size_t sample_width = kSupersampling * camera.width;
  if (blur_px > 0.0) {
    Blur(kSupersampling * blur_px,
         sample_width,
         kSupersampling * camera.height,
         &samples);
  }

  GreyImage image{camera.width, camera.height, {}};
  image.pixels.reserve(image.width * image.height);
  for (size_t y = 0; y < image.height; ++y) {
    for (size_t x = 0; x < image.width; ++x) {
      double sum = 0.0;
      for (size_t dy = 0; dy < kSupersampling; ++dy) {
        for (size_t dx = 0; dx < kSupersampling; ++dx) {
          sum += samples[(kSupersampling * y + dy) * sample_width +
                         kSupersampling * x + dx];
        }
      }
      double grey = 255.0 * sum / (kSupersampling * kSupersampling);
      if (noise_grey > 0.0) {
        grey += random->Normal(0.0, noise_grey);
      }
      image.pixels.push_back(
          static_cast<uint8_t>(std::clamp(grey + 0.5, 0.0, 255.0)));
    }
  }
  return image;
}

}  // namespace mfir

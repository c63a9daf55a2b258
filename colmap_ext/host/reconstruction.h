// COLMAP's reconstructions: images with poses, points and tracks. In COLMAP 4
// an image has its pose through a frame of a rig; here every image has a frame
// of its own ("trivial"), as it has in 3.8 without the name.

#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include <Eigen/Core>

#include "colmap_ext/host/camera.h"
#include "src/geometry/rigid3.h"

#if MFIR_COLMAP_MAJOR >= 4
#include "colmap/scene/reconstruction.h"
#else
#include "base/reconstruction.h"
#endif

namespace mfir::host {

using colmap::Image;
using colmap::image_t;
using colmap::Point2D;
using colmap::point2D_t;
using colmap::Point3D;
using colmap::point3D_t;
using colmap::Reconstruction;
using colmap::Track;
using colmap::TrackElement;

// The stored doubles unchanged.
Rigid3 CamFromWorld(const Image& image);

// Stores the doubles unchanged (no normalization). The image must be in a
// reconstruction.
void SetCamFromWorld(const Rigid3& cam_from_world, Image* image);

// The nearest quaternion that normalization leaves as it is. COLMAP 3.8
// normalizes whenever it reads or writes one, which can change the last bits
// each time; this one comes out of every later read bit for bit.
Eigen::Quaterniond StableQuaternion(const Eigen::Quaterniond& q);

// Adds a camera, with a rig of its own.
void AddCameraWithTrivialRig(const Camera& camera,
                             Reconstruction* reconstruction);

// Adds a registered image, with a frame of its own. Its camera has been added.
void AddImageWithTrivialFrame(const Image& image,
                              const Rigid3& cam_from_world,
                              Reconstruction* reconstruction);

// Its observations leave their tracks.
void DeRegisterImage(image_t image_id, Reconstruction* reconstruction);

// Gives each of the images, which are registered, a camera of its own: the id
// in `camera_ids` and a copy of the present one's values. All other images and
// cameras are removed; the other images are not registered.
void SplitCameras(const std::vector<std::pair<image_t, camera_t>>& camera_ids,
                  Reconstruction* reconstruction);

const Eigen::Vector2d& Xy(const Point2D& point2D);
void SetXy(const Eigen::Vector2d& xy, Point2D* point2D);
point3D_t Point3DId(const Point2D& point2D);

const Eigen::Vector3d& Xyz(const Point3D& point3D);
Eigen::Vector3d& Xyz(Point3D* point3D);
// Mean reprojection error, pixels.
double Error(const Point3D& point3D);
void SetError(double error, Point3D* point3D);
const Track& TrackOf(const Point3D& point3D);
// Red, green, blue.
using Color = Eigen::Matrix<uint8_t, 3, 1>;
Color ColorOf(const Point3D& point3D);

// Applies new_from_old to all poses and points.
void TransformReconstruction(const Similarity3& new_from_old,
                             Reconstruction* reconstruction);

// Reads cameras, images and points3D (.bin or .txt) in `folder`; rigs and
// frames of COLMAP 4 are left aside. Quaternions are normalized.
void ReadReconstruction(const std::string& folder,
                        bool is_binary,
                        Reconstruction* reconstruction);

// An image that no reconstruction owns, with its keypoints but no points.
Image CopyOfImage(const Image& image);

// Adds copies of the points of `from` that images of `image_ids` (registered,
// by their ids in `to`) see, and of the tracks what is in them; the points get
// new ids in the order of the old ones.
void AddPoints3D(const std::map<image_t, image_t>& image_ids,
                 const Reconstruction& from,
                 Reconstruction* to);

// The reconstruction of some of the registered images: they and their cameras
// keep their ids.
Reconstruction ExtractImages(const std::vector<image_t>& image_ids,
                             const Reconstruction& reconstruction);

}  // namespace mfir::host

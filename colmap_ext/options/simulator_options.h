// What a simulated capture is made of.

#pragma once

#include <string>

namespace mfir {

// "Sigma" is the standard deviation of a normal distribution. Errors at the
// image corner are relative to half of the image diagonal.
struct SimulatorOptions {
  // Camera array: on a dome around the object.
  int num_cameras = 16;
  double distance = 1.0;         // metres from the centre
  double azimuth = 110.0;        // degrees to both sides of the face
  double min_elevation = -35.0;  // degrees
  double max_elevation = 50.0;   // degrees
  std::string unit = "m";        // of the world: "m" or "mm"

  // True intrinsics.
  std::string camera_model = "PINHOLE";
  int image_width = 800;
  int image_height = 600;
  double focal_length = 0.0;  // pixels; 0: such that the object fills the image
  double focal_length_sigma = 0.01;    // relative, between cameras
  double principal_point_sigma = 5.0;  // pixels, between cameras
  double distortion = 0.02;            // largest one, at the image corner

  // Scene and tracks.
  int num_frames = 4;
  int num_points = 1500;  // per frame
  int min_views = 3;      // per point
  int max_views = 10;
  double max_view_angle = 62.0;  // degrees between normal and line of sight
  double missing_share = 0.0;    // of the images

  // Keypoints.
  double noise = 0.5;           // sigma per axis, pixels
  double outlier_share = 0.05;  // of the observations
  double min_outlier = 4.0;     // displacement of an outlier, pixels
  double max_outlier = 30.0;
  double unmatched_share = 0.2;  // further keypoints without a point

  // Errors of the intrinsics in the frames' models and in RIG.
  double initial_focal_length_sigma = 0.01;    // relative
  double initial_principal_point_sigma = 5.0;  // pixels
  double initial_distortion_sigma = 0.002;     // at the image corner

  // Errors of the known extrinsics in RIG.
  double rig_rotation_sigma = 0.0;  // degrees per axis
  double rig_center_sigma = 0.0;    // millimetres per axis

  // Images.
  bool render_images = true;
  double blur = 0.4;         // sigma, pixels
  double image_noise = 2.0;  // sigma, grey levels
  double gloss = 0.0;        // reflections of lamps, share of white

  int seed = 0;

  // How to run; these do not change any result.
  int num_threads = -1;
  bool overwrite = false;
  bool quiet = false;

  // Throws UsageError for values out of range.
  void Check() const;
};

// Calls visit(name, &value, help) for all options that decide on the result.
template <typename Options, typename Visitor>
void VisitSimulatorOptions(Options* o, const Visitor& visit) {
  visit("num_cameras", &o->num_cameras, "cameras on the dome");
  visit("distance", &o->distance, "camera distance from the centre, metres");
  visit("azimuth", &o->azimuth, "half width of the dome, degrees");
  visit("min_elevation", &o->min_elevation, "lowest camera, degrees");
  visit("max_elevation", &o->max_elevation, "highest camera, degrees");
  visit("unit", &o->unit, "of world coordinates: m or mm");
  visit("camera_model", &o->camera_model, "any camera model of COLMAP");
  visit("image_width", &o->image_width, "pixels");
  visit("image_height", &o->image_height, "pixels");
  visit("focal_length", &o->focal_length, "pixels; 0: object fills the image");
  visit("focal_length_sigma",
        &o->focal_length_sigma,
        "relative spread between cameras");
  visit("principal_point_sigma",
        &o->principal_point_sigma,
        "spread between cameras, pixels");
  visit("distortion",
        &o->distortion,
        "largest distortion at the image corner / half image diagonal");
  visit("num_frames", &o->num_frames, "instants");
  visit("num_points", &o->num_points, "3D points per frame");
  visit("min_views", &o->min_views, "fewest images of a point");
  visit("max_views", &o->max_views, "most images of a point");
  visit("max_view_angle",
        &o->max_view_angle,
        "largest angle between surface normal and line of sight, degrees");
  visit("missing_share", &o->missing_share, "share of images that are missing");
  visit("noise", &o->noise, "sigma of keypoints per axis, pixels");
  visit("outlier_share", &o->outlier_share, "share of wrong observations");
  visit("min_outlier", &o->min_outlier, "smallest error of one, pixels");
  visit("max_outlier", &o->max_outlier, "largest error of one, pixels");
  visit("unmatched_share",
        &o->unmatched_share,
        "keypoints without 3D point / observations");
  visit("initial_focal_length_sigma",
        &o->initial_focal_length_sigma,
        "relative focal length error per frame and camera");
  visit("initial_principal_point_sigma",
        &o->initial_principal_point_sigma,
        "principal point error per frame and camera, pixels");
  visit("initial_distortion_sigma",
        &o->initial_distortion_sigma,
        "distortion error at the image corner / half image diagonal");
  visit("rig_rotation_sigma",
        &o->rig_rotation_sigma,
        "error of the known rotations per axis, degrees");
  visit("rig_center_sigma",
        &o->rig_center_sigma,
        "error of the known camera centres per axis, millimetres");
  visit("render_images", &o->render_images, "0: write no images");
  visit("blur", &o->blur, "sigma of the optical blur, pixels");
  visit("image_noise", &o->image_noise, "sigma, grey levels");
  visit("gloss",
        &o->gloss,
        "brightness of lamps that the surface reflects, share of white");
  visit("seed", &o->seed, "the same seed gives the same bytes");
}

}  // namespace mfir

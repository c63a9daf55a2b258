// Options of the command multi_frame_triangulator.

#pragma once

#include <limits>
#include <string>

#include "colmap_ext/host/feature.h"
#include "colmap_ext/host/triangulation.h"
#include "colmap_ext/options/option_parser.h"
#include "src/scene/view_overlap.h"

namespace mfir {

struct TriangulatorOptions {
  std::string image_path;
  std::string extrinsics_path;
  std::string extrinsics_format = "auto";
  double extrinsics_pixel_offset = std::numeric_limits<double>::quiet_NaN();
  std::string intrinsics_path;  // empty: the intrinsics of extrinsics_path
  std::string intrinsics_format = "auto";
  double intrinsics_pixel_offset = std::numeric_limits<double>::quiet_NaN();
  std::string output_path;
  std::string mask_path;
  std::string frame_list_path;
  std::string camera_name_regex;
  std::string frame_name_regex;
  std::string video_offset_list_path;
  bool scale_intrinsics = false;
  int max_num_frames = 0;  // 0: all

  // [MultiFrameTriangulator]
  ViewOverlapOptions view_overlap;
  // Focal length / larger image side of all cameras, which then are of
  // camera_model without distortion; 0: the given intrinsics.
  double focal_length_factor = 0.0;
  // "built_in": our SIFT where it can do what [SiftExtraction] asks for, else
  // COLMAP's; "colmap": COLMAP's.
  std::string feature_extractor = "built_in";
  // Cap of the tolerance of epipolar errors / larger image side.
  double max_epipolar_error = 0.02;
  // On the images, with the given intrinsics (track_refinement.h).
  bool refine_keypoints = false;
  bool complete_tracks = false;
  int num_threads = -1;
  bool overwrite = false;
  bool quiet = false;

  // Sections of COLMAP. What belongs to its RANSAC, its bundle adjustment and
  // its choice of images is not used here.
  std::string camera_model = "PINHOLE";  // [ImageReader]
  std::string camera_mask_path;
  host::FeatureTypes feature_types;
  host::FeatureExtractionOptions feature_extraction;
  host::FeatureMatchingOptions feature_matching;
  int min_num_inliers = 5;  // of a pair of images
  int min_num_matches = 5;  // [Mapper]
  bool ignore_watermarks = false;
  host::TriangulatorOptions triangulation;
  double filter_max_reproj_error = 0.0;
  double filter_min_tri_angle = 1.5;

  // Sets our defaults of COLMAP's options: two-view tracks count, thresholds
  // in pixels and angle follow from the epipolar tolerance (0).
  TriangulatorOptions();

  // Whether features are matched along the known epipolar lines, by our own
  // code; else by COLMAP's matcher and then compared with the known geometry.
  bool MatchesAlongEpipolarLines() const;

  // Throws UsageError.
  void Check() const;
};

void AddTriangulatorOptions(TriangulatorOptions* options, OptionParser* parser);

// Once they are parsed: the kind of features and matches, and what of it runs
// on a GPU here. Throws UsageError.
void ChooseFeatures(const OptionParser& parser, TriangulatorOptions* options);

// The part that decides on the tracks which matches give. Programs that make
// tracks from the databases of frames take these.
void AddTrackOptions(TriangulatorOptions* options, OptionParser* parser);

}  // namespace mfir

// All options of the refiner ([MultiFrame] in a project ini file).

#pragma once

#include <string>

#include "src/dense/dense_feature_options.h"

namespace mfir {

struct MultiFrameOptions {
  // Defaults of the others: "accurate" (our best) or "paper" (the settings of
  // "Multi-Cali Anything"). See ApplyPreset.
  std::string preset = "accurate";

  // lambda_0: weight of the reprojection term.
  double reprojection_weight = 1.0;
  // lambda_1, lambda_2: initial weights of the extrinsics prior (eq. 3).
  double rotation_prior_weight = 0.01;
  double translation_prior_weight = 0.01;
  // lambda_3: weight of the dense features (eq. 5). With loss_scale 0 a factor
  // on the weight that follows from the noise of features and keypoints. Inert
  // without features.
  double featuremetric_weight = 0.01;
  // lambda_4, lambda_5: initial weights that tie a frame's intrinsics to the
  // global ones (eq. 9). Both zero: frames stay independent, which is the
  // paper's single-frame mode.
  double focal_variance_weight = 0.02;
  double principal_point_variance_weight = 0.02;
  // The same for distortion, its differences scaled to pixels (beyond the
  // paper).
  double extra_params_variance_weight = 0.02;

  // Schedule: prior and variance weights grow by this factor after each solve,
  // until a prior weight exceeds max_prior_weight. A max_prior_weight below the
  // initial weights skips the schedule: only the last solve, with the
  // extrinsics fixed, remains.
  double weight_growth = 2.0;
  double max_prior_weight = 1e6;
  // 0: one solve at the initial weights and no last solve: intrinsics are what
  // the soft prior gives (rows 2 and 5 of the paper's ablation).
  bool progressive = true;

  // Cauchy scale in pixels; 0: robust likelihood estimated from the residuals.
  double loss_scale = 0.25;

  // Iterations of one solve.
  int max_num_iterations = 100;

  bool refine_focal_length = true;
  bool refine_principal_point = true;
  bool refine_extra_params = true;

  // Start from the intrinsics of RIG instead of those of the frames.
  bool use_prior_intrinsics = false;

  // How often the tracks of frames that have a database are made anew, with the
  // intrinsics so far.
  int retriangulation_rounds = 0;

  // Align keypoints, and look for tracks in further cameras, on the images
  // (track_refinement.h). Not with a schedule. -1: where there are images, but
  // not with "paper".
  int refine_keypoints = -1;
  int complete_tracks = -1;

  // How many frames are used, see ChooseFrames; 0: all.
  int max_num_frames = 0;

  // What becomes of tracks that are in place in several frames: "merge", "keep"
  // or "drop", see FindStaticPoints.
  std::string static_points = "keep";

  // Share of the tracks that take no part, to check the result.
  double held_out_share = 0.0;

  // The known extrinsics are exact (0), or get corrections shared by all frames
  // under a prior with this standard deviation per axis: rotation in degrees,
  // camera centre in units of RIG.
  double extrinsics_rotation_std_deg = 0.0;
  double extrinsics_translation_std = 0.0;

  // Prior around the intrinsics of RIG (with use_prior_intrinsics), standard
  // deviations in pixels; 0: none.
  double prior_focal_std = 0.0;
  double prior_principal_point_std = 0.0;

  // Combinations of intrinsics about which the data say less than this (1/px^2)
  // stay at their start. -1: that they determine worse than the start plausibly
  // is; 0: none. See FixedExtrinsicsOptions.
  double min_information = -1.0;

  // COLMAP camera model that all cameras are converted to; empty: as they are.
  std::string camera_model;

  // Physical camera of an image name, see CameraNaming.
  std::string camera_name_regex;

  // Frame of an image name, where one model holds many: see FrameNames.
  std::string frame_name_regex;

  // "none", "sift", "onnx" or "database"; empty: "sift" with images, else
  // "none".
  std::string dense_features;
  DenseFeatureOptions features;

  // COLMAP's meaning of -1: choose automatically.
  int use_gpu = -1;
  int gpu_index = -1;
  int num_threads = -1;

  // No progress output.
  bool quiet = false;
  // Whether report.html is written.
  bool report = true;

  // Sets all options that the preset defines. Throws UsageError for an unknown
  // name.
  void ApplyPreset(const std::string& name);

  // Throws UsageError that names the first option out of range.
  void Check() const;

  // Whether every frame keeps intrinsics of its own.
  bool SingleFrameMode() const {
    return focal_variance_weight == 0.0 &&
           principal_point_variance_weight == 0.0;
  }

  // Whether static_points can be other than "keep".
  bool CanChangeStaticPoints() const {
    return NumScheduleSolves() == 0 && !SingleFrameMode();
  }

  bool SoftExtrinsics() const {
    return extrinsics_rotation_std_deg > 0.0 ||
           extrinsics_translation_std > 0.0;
  }

  // Number of solves of the schedule, before the last one.
  int NumScheduleSolves() const;

  int EffectiveNumThreads() const;
};

}  // namespace mfir

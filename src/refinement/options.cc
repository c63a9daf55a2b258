#include "src/refinement/options.h"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "src/parallel/parallel_for.h"
#include "src/util/errors.h"
#include "src/util/option_checks.h"

namespace mfir {

void MultiFrameOptions::ApplyPreset(const std::string& name) {
  CheckOneOf("preset", name, {"accurate", "paper"});
  const MultiFrameOptions paper;
  preset = name;
  if (name == "paper") {
    max_prior_weight = paper.max_prior_weight;
    loss_scale = paper.loss_scale;
    featuremetric_weight = paper.featuremetric_weight;
    retriangulation_rounds = 0;
    held_out_share = 0.0;
    min_information = 0.0;
    max_num_iterations = paper.max_num_iterations;
  } else {
    // The last solve converges from the alignment directly; the schedule
    // changes nothing but the time.
    max_prior_weight = 0.0;
    loss_scale = 0.0;
    // A factor on what follows from the noise of features and keypoints. Below
    // 1, since the features of a track err together: they are compared with the
    // same reference, and neighbouring views see the same change of appearance.
    featuremetric_weight = 0.3;
    retriangulation_rounds = 2;
    held_out_share = 0.05;
    min_information = paper.min_information;
    // Few need more than 50. Where the frames' own models are far off and the
    // lens model is rich, the way along the weak modes is long (up to 650).
    max_num_iterations = 2000;
  }
}

void MultiFrameOptions::Check() const {
  CheckOneOf("preset", preset, {"accurate", "paper"});
  CheckAtLeast("reprojection_weight", reprojection_weight, 1e-12);
  CheckAtLeast("rotation_prior_weight", rotation_prior_weight, 0.0);
  CheckAtLeast("translation_prior_weight", translation_prior_weight, 0.0);
  CheckAtLeast("featuremetric_weight", featuremetric_weight, 0.0);
  CheckAtLeast("focal_variance_weight", focal_variance_weight, 0.0);
  CheckAtLeast(
      "principal_point_variance_weight", principal_point_variance_weight, 0.0);
  CheckAtLeast(
      "extra_params_variance_weight", extra_params_variance_weight, 0.0);
  CheckAtLeast("weight_growth", weight_growth, 1.01);
  CheckAtLeast("max_prior_weight", max_prior_weight, 0.0);
  CheckAtLeast("loss_scale", loss_scale, 0.0);
  CheckAtLeast("max_num_iterations", max_num_iterations, 1);
  CheckAtLeast("retriangulation_rounds", retriangulation_rounds, 0);
  CheckAtLeast("max_num_frames", max_num_frames, 0);
  for (const auto& [name, value] :
       {std::make_pair("refine_keypoints", refine_keypoints),
        std::make_pair("complete_tracks", complete_tracks)}) {
    CheckAtLeast(name, value, -1);
    if (value > 1) {
      throw UsageError("--MultiFrame." + std::string(name) +
                       " must be -1 (auto), 0 or 1.");
    }
    if (value == 1 && NumScheduleSolves() > 0) {
      throw UsageError(
          "The solves of a schedule keep their tracks: with "
          "--MultiFrame.max_prior_weight or progressive 0, "
          "--MultiFrame." +
          std::string(name) + " must be 0 or -1.");
    }
  }
  CheckOneOf("static_points", static_points, {"merge", "keep", "drop"});
  CheckAtLeast("held_out_share", held_out_share, 0.0);
  CheckAtLeast("extrinsics_rotation_std_deg", extrinsics_rotation_std_deg, 0.0);
  CheckAtLeast("extrinsics_translation_std", extrinsics_translation_std, 0.0);
  CheckAtLeast("prior_focal_std", prior_focal_std, 0.0);
  CheckAtLeast("prior_principal_point_std", prior_principal_point_std, 0.0);
  if (min_information != -1.0) {
    CheckAtLeast("min_information", min_information, 0.0);
  }
  if (held_out_share > 0.5) {
    throw UsageError("--MultiFrame.held_out_share must be at most 0.5.");
  }
  if (held_out_share > 0.0 && NumScheduleSolves() > 0) {
    throw UsageError(
        "The solves of a schedule take all tracks: with "
        "--MultiFrame.max_prior_weight or progressive 0, "
        "--MultiFrame.held_out_share must be 0.");
  }
  if (retriangulation_rounds > 0 && NumScheduleSolves() > 0) {
    throw UsageError(
        "The solves of a schedule keep their tracks: with "
        "--MultiFrame.max_prior_weight or progressive 0, "
        "--MultiFrame.retriangulation_rounds must be 0.");
  }
  if (static_points != "keep" && !CanChangeStaticPoints()) {
    throw UsageError(
        "With a schedule (--MultiFrame.max_prior_weight or progressive 0) all "
        "tracks take part, and frames with intrinsics of their own "
        "(--MultiFrame.focal_variance_weight and "
        "principal_point_variance_weight 0) have no points in common: "
        "--MultiFrame.static_points must be keep.");
  }
  if ((prior_focal_std > 0.0 || prior_principal_point_std > 0.0) &&
      !use_prior_intrinsics) {
    throw UsageError(
        "--MultiFrame.prior_focal_std and prior_principal_point_std are priors "
        "around the intrinsics of RIG: set --MultiFrame.use_prior_intrinsics "
        "1.");
  }
  CheckOneOf("dense_features",
             dense_features,
             {"", "none", "sift", "onnx", "database"});
  features.Check(dense_features);
  CheckAtLeast("use_gpu", use_gpu, -1);
  CheckAtLeast("gpu_index", gpu_index, -1);
  CheckAtLeast("num_threads", num_threads, -1);
  if (use_gpu > 1) {
    throw UsageError("--MultiFrame.use_gpu must be -1 (auto), 0 or 1.");
  }
  if (num_threads == 0 || num_threads > 1024) {
    throw UsageError(
        "--MultiFrame.num_threads must be -1 (all), or 1 to 1024.");
  }
  if (!refine_focal_length && !refine_principal_point && !refine_extra_params) {
    throw UsageError(
        "Nothing to refine: --MultiFrame.refine_focal_length, "
        "refine_principal_point and refine_extra_params are all 0.");
  }
}

int MultiFrameOptions::NumScheduleSolves() const {
  if (!progressive) {
    return 1;
  }
  const double weight = rotation_prior_weight > 0.0 ? rotation_prior_weight
                                                    : translation_prior_weight;
  if (weight > max_prior_weight) {
    return 0;
  }
  if (weight == 0.0) {
    return max_prior_weight > 0.0 ? 1 : 0;  // Nothing to grow.
  }
  // Rounding must not lose the last one.
  return 1 + static_cast<int>(std::floor(std::log(max_prior_weight / weight) /
                                             std::log(weight_growth) +
                                         1e-9));
}

int MultiFrameOptions::EffectiveNumThreads() const {
  return num_threads > 0 ? num_threads : NumThreadsOfMachine();
}

}  // namespace mfir

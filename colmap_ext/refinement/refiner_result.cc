#include "colmap_ext/refinement/refiner_result.h"

#include <algorithm>
#include <cmath>
#include <iostream>
#include <utility>

#include "colmap_ext/host/util.h"
#include "src/geometry/alignment.h"
#include "src/scene/residual_statistics.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

// The extrinsics in the coordinates of RIG: the known ones, or corrected.
std::vector<KnownCamera> RefinedCameras(const MultiFrameOptions& options,
                                        const Similarity3& rig_from_normalized,
                                        const Capture& capture,
                                        const Estimate& estimate) {
  std::vector<KnownCamera> cameras = capture.cameras;
  for (size_t i = 0; i < cameras.size(); ++i) {
    const RigCamera& camera = estimate.cameras[i];
    cameras[i].model = camera.model;
    cameras[i].width = camera.width;
    cameras[i].height = camera.height;
    cameras[i].params = camera.params;
    if (options.SoftExtrinsics()) {
      cameras[i].matrix.reset();
      cameras[i].cam_from_world =
          TransformPose(rig_from_normalized, camera.cam_from_world);
      cameras[i].cam_from_world.rotation =
          host::StableQuaternion(cameras[i].cam_from_world.rotation);
    }
  }
  return cameras;
}

// Changes of the cameras that could change, since their start and since the
// intrinsics of RIG, where these are of the same model.
void MeasureDrifts(const Capture& capture,
                   const Scene& scene,
                   const RefinedTracks& refined,
                   RefinerResult* result) {
  const std::vector<RigCamera>& cameras = refined.estimate.cameras;
  DriftReference start(scene.cameras.size());
  DriftReference rig(scene.cameras.size());
  for (size_t i = 0; i < scene.cameras.size(); ++i) {
    const RigCamera& camera = scene.cameras[i];
    if (camera.constant_intrinsics || !refined.took_part[i]) continue;
    start[i] = camera.params;
    if (capture.cameras[i].model == camera.model) {
      rig[i] = capture.cameras[i].params;
    }
  }
  const std::vector<size_t> num_observations = NumObservationsByCamera(scene);
  result->drifts = FindDrifts(cameras, num_observations, start);
  result->drifts_from_rig = FindDrifts(cameras, num_observations, rig);
}

void WarnOfContradictions(const Contradictions& contradictions) {
  for (const auto& name_and_reason : contradictions) {
    std::cerr << "WARNING: camera '" << name_and_reason.first
              << "' contradicts its extrinsics in RIG: "
              << name_and_reason.second
              << ". Was it moved, or has it another camera's name? Correct "
                 "RIG, or leave the camera out of it."
              << std::endl;
  }
}

void WarnOfDrift(const std::string& name,
                 const std::string& since,
                 const CameraDrift& drift) {
  std::cerr << "WARNING: camera '" << name << "' has changed unusually since "
            << since << ": "
            << host::StringPrintf(
                   "focal length %.2f permille (the other cameras %.2f), "
                   "principal point (%.2f, %.2f) px (the others %.2f), %.1f "
                   "robust standard deviations",
                   drift.focal_permille,
                   drift.others_focal_permille,
                   drift.principal_point.x(),
                   drift.principal_point.y(),
                   drift.others_principal_point,
                   std::max(drift.focal_stds, drift.principal_point_stds))
            << ". A camera that was bumped looks like this. If so, correct its "
               "pose in RIG, or leave the camera out of it."
            << std::endl;
}

void WarnOfBumpedCameras(const RefinerResult& result) {
  for (size_t i = 0; i < result.cameras.size(); ++i) {
    const std::string& name = result.cameras[i].name;
    const PoseDisagreement& pose = result.pose_disagreements[i];
    if (pose.is_moved) {
      std::cerr << "WARNING: camera '" << name << "' has moved: "
                << host::StringPrintf(
                       "in the frames it is turned by %.2f degrees against "
                       "RIG (the other cameras by %.3f)",
                       pose.angle_deg,
                       pose.others_deg)
                << ". Correct its pose in RIG, or leave the camera out of it."
                << std::endl;
    }
    if (result.drifts[i] && result.drifts[i]->is_unusual) {
      WarnOfDrift(name, "its start", *result.drifts[i]);
    } else if (result.drifts_from_rig[i] &&
               result.drifts_from_rig[i]->is_unusual) {
      WarnOfDrift(name, "RIG", *result.drifts_from_rig[i]);
    }
  }
}

// Rms of the same observations before and after.
void MeasureRms(const Scene& scene,
                const std::vector<double>& residuals_before,
                const std::vector<double>& residuals_after,
                RefinerResult* result) {
  const double max_squared =
      MaxInlierSquaredResidual(residuals_after, *scene.ranks);
  result->max_inlier_px = std::sqrt(max_squared);
  std::vector<bool> inliers;
  for (const double squared : residuals_after) {
    inliers.push_back(squared <= max_squared);
  }
  result->rms_px_before = RmsByCamera(scene, residuals_before, inliers);
  result->rms_px_after = RmsByCamera(scene, residuals_after, inliers);
}

}  // namespace

RefinerResult CheckResult(const MultiFrameOptions& options,
                          const Start& start,
                          const Tracks& tracks,
                          const SelectedTracks& selected,
                          RefinedTracks refined) {
  RefinerResult result;
  const Scene& scene = tracks.scene;
  const Estimate& estimate = refined.estimate;
  result.rig_from_normalized = Inverse(tracks.capture.new_from_rig);
  result.soft_extrinsics = options.SoftExtrinsics();
  result.single_frame_mode = options.SingleFrameMode();
  const std::vector<double> residuals_before = SquaredResiduals(
      scene,
      tracks.are_new ? WithInitialIntrinsics(scene, estimate) : start.estimate,
      result.single_frame_mode);
  const std::vector<double> residuals_after =
      SquaredResiduals(scene, estimate, result.single_frame_mode);
  MeasureRms(scene, residuals_before, residuals_after, &result);
  std::vector<double> stds_px = RobustStdByCamera(scene, residuals_after);
  for (size_t i = 0; i < stds_px.size(); ++i) {
    // Nothing was fitted to what it has seen.
    if (!refined.took_part[i]) stds_px[i] = std::nan("");
  }
  const std::vector<ExtrinsicsContradiction> contradictions =
      FindExtrinsicsContradictions(start.stds_px, stds_px, start.own_stds_px);
  result.contradictions = tracks.contradictions;
  result.contradictions.merge(DescribeContradictions(scene, contradictions));
  result.spoilt = CountSpoiltCameras(
      scene, estimate, contradictions, stds_px, start.own_stds_px);
  // Intrinsics of a soft solve need not fit the known extrinsics.
  const bool contradicts =
      result.spoilt.Most() && (!contradictions.empty() || options.progressive);
  result.status = contradicts                    ? "contradicting_extrinsics"
                  : refined.refinement.converged ? "converged"
                                                 : "not_converged";
  result.pose_disagreements =
      FindPoseDisagreements(start.scene, start.estimate);
  MeasureDrifts(tracks.capture, scene, refined, &result);
  result.cameras = RefinedCameras(
      options, result.rig_from_normalized, tracks.capture, estimate);
  result.static_points = selected.static_points;
  result.refined = std::move(refined);
  return result;
}

void WarnOfCameras(const RefinerResult& result) {
  WarnOfContradictions(result.contradictions);
  WarnOfBumpedCameras(result);
}

std::string DescribeResult(const RefinerResult& result) {
  const RefinedTracks& refined = result.refined;
  const std::string held_out_rms =
      std::isfinite(refined.held_out_rms_px)
          ? host::StringPrintf("%.3f px held out, ", refined.held_out_rms_px)
          : "";
  return host::StringPrintf(
      "%s: rms %.3f px before, %.3f px after, %snoise %.3f px, outliers %.1f "
      "%%",
      result.status.c_str(),
      result.rms_px_before.back(),
      result.rms_px_after.back(),
      held_out_rms.c_str(),
      refined.refinement.noise_std_px,
      100.0 * refined.refinement.outlier_share);
}

void ThrowUnlessConverged(const RefinerResult& result,
                          int max_num_iterations,
                          const std::string& path) {
  if (result.status == "converged") return;
  std::string names;
  for (const auto& name_and_reason : result.contradictions) {
    names += (names.empty() ? "'" : ", '") + name_and_reason.first + "'";
  }
  const std::string where =
      "the result is in " + path + ", with status " + result.status + ". ";
  if (result.status == "contradicting_extrinsics" && names.empty()) {
    throw SolverError(
        "The frames contradict the extrinsics in RIG: the residuals or focal "
        "lengths of " +
        std::to_string(result.spoilt.num_spoilt) + " of " +
        std::to_string(result.spoilt.num_others) + " cameras are absurd; " +
        where +
        "Is it the RIG of this array, with the right name at every camera?");
  }
  if (result.status == "contradicting_extrinsics") {
    throw SolverError(
        "Cameras that contradict their extrinsics in RIG (" + names +
        ") have spoilt " + std::to_string(result.spoilt.num_spoilt) +
        " of the " + std::to_string(result.spoilt.num_others) +
        " others: their residuals or focal lengths are absurd; " + where +
        "Correct these cameras in RIG, or remove them "
        "from it, and run again.");
  }
  if (result.refined.refinement.stalled) {
    throw SolverError(
        "The last solve stopped where no step lowers its cost, short of a "
        "minimum; " +
        where +
        "A camera whose intrinsics start far off, or whose lens model is too "
        "rich for its points, does this: look at the WARNINGs and flags, take "
        "a simpler --MultiFrame.camera_model or the intrinsics of RIG "
        "(--MultiFrame.use_prior_intrinsics 1).");
  }
  throw SolverError(
      "The last solve did not converge within " +
      std::to_string(max_num_iterations) + " iterations; " + where +
      (names.empty()
           ? "Raise --MultiFrame.max_num_iterations."
           : "Correct the cameras that contradict their "
             "extrinsics in RIG (" +
                 names + "), or remove them from it, and run again."));
}

}  // namespace mfir

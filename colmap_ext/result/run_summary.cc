#include "colmap_ext/result/run_summary.h"

#include <sys/resource.h>

#include <algorithm>
#include <ctime>
#include <optional>

#include "colmap_ext/host/util.h"
#include "colmap_ext/models/camera_models.h"
#include "colmap_ext/result/version.h"
#include "src/scene/residual_statistics.h"
#include "src/util/cpu_time.h"

namespace mfir {
namespace {

using Json = nlohmann::ordered_json;

constexpr double kMaxFocalStd = 0.05;  // relative

Json NumberOrNull(double value) {
  return std::isfinite(value) ? Json(value) : Json(nullptr);
}

// What soft extrinsics have changed: rotation vector (degrees, after the given
// rotation) and shift of the camera centre (units of RIG).
Json MakeCorrection(const KnownCamera& given, const KnownCamera& corrected) {
  const Eigen::AngleAxisd rotation((corrected.cam_from_world.rotation *
                                    given.cam_from_world.rotation.conjugate())
                                       .normalized());
  const Eigen::Vector3d degrees =
      rotation.angle() * 180.0 / M_PI * rotation.axis();
  const Eigen::Vector3d shift =
      corrected.cam_from_world.Center() - given.cam_from_world.Center();
  return {{"rotation_deg", {degrees.x(), degrees.y(), degrees.z()}},
          {"center", {shift.x(), shift.y(), shift.z()}}};
}

// Correlation coefficients of a camera's parameters; null where one is held.
Json MakeCorrelations(const Eigen::MatrixXd& covariance) {
  Json rows = Json::array();
  for (Eigen::Index i = 0; i < covariance.rows(); ++i) {
    Json row = Json::array();
    for (Eigen::Index j = 0; j < covariance.cols(); ++j) {
      row.push_back(NumberOrNull(
          covariance(i, j) / std::sqrt(covariance(i, i) * covariance(j, j))));
    }
    rows.push_back(row);
  }
  return rows;
}

// Standard deviations of what all cameras share, the weak modes of a dome.
Json MakeModes(const RefinerResult& result) {
  const Eigen::MatrixXd& covariance = result.refined.refinement.covariance;
  Eigen::MatrixXd modes = Eigen::MatrixXd::Zero(covariance.rows(), 3);
  const double num_cameras = static_cast<double>(result.cameras.size());
  Eigen::Index begin = 0;
  for (const KnownCamera& camera : result.cameras) {
    const std::vector<size_t>& focal_idxs = camera.model->FocalLengthIdxs();
    for (const size_t idx : focal_idxs) {
      modes(begin + static_cast<Eigen::Index>(idx), 0) =
          1000.0 / (camera.params[idx] * num_cameras *
                    static_cast<double>(focal_idxs.size()));
    }
    for (Eigen::Index axis = 0; axis < 2; ++axis) {
      const size_t idx = camera.model->PrincipalPointIdxs()[axis];
      modes(begin + static_cast<Eigen::Index>(idx), 1 + axis) =
          1.0 / num_cameras;
    }
    begin += static_cast<Eigen::Index>(camera.params.size());
  }
  const Eigen::Vector3d stds =
      (modes.transpose() * covariance * modes).diagonal().cwiseSqrt();
  return {{"common_focal_scale_std_permille", NumberOrNull(stds(0))},
          {"common_principal_point_shift_x_std_px", NumberOrNull(stds(1))},
          {"common_principal_point_shift_y_std_px", NumberOrNull(stds(2))}};
}

size_t PeakRss() {
  rusage usage;
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<size_t>(usage.ru_maxrss) * 1024;
}

// By frame of this rank.
std::vector<std::string> DescribeFrames(const Tracks& tracks) {
  std::vector<std::string> frames;
  size_t frame_idx = 0;
  for (const FrameModel& model : tracks.capture.frames) {
    const bool used = model.skip_reason.empty();
    const Frame* frame = used ? &tracks.scene.frames[frame_idx++] : nullptr;
    const Json json = {
        {"name", model.name},
        {"status", used ? "used" : "skipped"},
        {"reason", model.skip_reason},
        {"num_images", used ? frame->images.size() : 0},
        {"num_points", used ? frame->NumPoints() : 0},
        {"num_observations", used ? frame->observations.size() : 0},
        {"alignment_rms", used ? Json(model.alignment_rms) : Json(nullptr)}};
    frames.push_back(json.dump(-1, ' ', false, Json::error_handler_t::replace));
  }
  return frames;
}

bool IsUnusual(const std::optional<CameraDrift>& drift) {
  return drift && drift->is_unusual;
}

Json DriftToJson(const std::optional<CameraDrift>& drift) {
  if (!drift) return nullptr;
  return {{"focal_permille", drift->focal_permille},
          {"others_focal_permille", drift->others_focal_permille},
          {"focal_stds", drift->focal_stds},
          {"principal_point_px",
           {drift->principal_point.x(), drift->principal_point.y()}},
          {"others_principal_point_px", drift->others_principal_point},
          {"principal_point_stds", drift->principal_point_stds}};
}

// Share of a camera's observations whose keypoints were refined.
Json RefinedShare(const std::optional<KeypointStatistics>& keypoints,
                  size_t camera_idx) {
  if (!keypoints) return nullptr;
  const size_t num_after = keypoints->num_after_by_camera[camera_idx];
  if (num_after == 0) return nullptr;
  return static_cast<double>(keypoints->num_refined_by_camera[camera_idx]) /
         static_cast<double>(num_after);
}

// Intrinsics of RIG; null without.
Json IntrinsicsOfRig(const KnownCamera& camera) {
  if (camera.model == nullptr) return nullptr;
  return {{"model", camera.model->Name()}, {"params", camera.params}};
}

// Noise of the keypoints; empty in single-frame mode.
Json MakeNoiseMixture(const std::vector<NoiseComponent>& components) {
  Json json = Json::array();
  for (const NoiseComponent& component : components) {
    json.push_back({{"std_px", component.std_px}, {"share", component.share}});
  }
  return json;
}

// As "2026-11-30T08:15:00Z".
std::string UtcNow() {
  const std::time_t now = std::time(nullptr);
  std::tm utc;
  gmtime_r(&now, &utc);
  char text[32];
  std::strftime(text, sizeof(text), "%Y-%m-%dT%H:%M:%SZ", &utc);
  return text;
}

Json MakeCameras(const Tracks& tracks,
                 const RefinerResult& result,
                 const Totals& totals) {
  const Scene& scene = tracks.scene;
  Json cameras = Json::array();
  Eigen::Index param_begin = 0;
  for (size_t i = 0; i < scene.cameras.size(); ++i) {
    const RigCamera& camera = result.refined.estimate.cameras[i];
    Json params_std = Json::array();
    const Eigen::Index num_params =
        static_cast<Eigen::Index>(camera.params.size());
    const Json correlations =
        MakeCorrelations(result.refined.refinement.covariance.block(
            param_begin, param_begin, num_params, num_params));
    bool determined = !result.refined.refinement.held_cameras[i];
    for (size_t j = 0; j < camera.params.size(); ++j) {
      const Eigen::Index k = param_begin + static_cast<Eigen::Index>(j);
      const double variance = result.refined.took_part[i]
                                  ? result.refined.refinement.covariance(k, k)
                                  : std::nan("");
      params_std.push_back(NumberOrNull(std::sqrt(variance)));
      determined = determined && std::isfinite(variance);
      for (const size_t idx : camera.model->FocalLengthIdxs()) {
        if (j == idx) {
          determined = determined &&
                       std::sqrt(variance) < kMaxFocalStd * camera.params[idx];
        }
      }
    }
    param_begin += num_params;
    Json flags = Json::array();
    if (!result.refined.took_part[i]) flags.push_back("no_observations");
    if (result.refined.took_part[i] && !determined) {
      flags.push_back("weakly_determined");
    }
    if (result.contradictions.count(camera.name) > 0) {
      flags.push_back("contradicts_extrinsics");
    }
    const bool unusual_drift =
        IsUnusual(result.drifts[i]) || IsUnusual(result.drifts_from_rig[i]);
    if (unusual_drift) flags.push_back("unusual_drift");
    const PoseDisagreement& pose = result.pose_disagreements[i];
    if (pose.is_moved) flags.push_back("moved");
    if (result.refined.refinement.held_cameras[i])
      flags.push_back("held_at_start");
    if (camera.constant_intrinsics) flags.push_back("constant");
    if (totals.num_frames[i] == 1) flags.push_back("single_frame");
    cameras.push_back(
        {{"name", camera.name},
         {"model", camera.model->Name()},
         {"width", camera.width},
         {"height", camera.height},
         {"params", camera.params},
         {"params_initial", scene.cameras[i].params},
         {"rig", IntrinsicsOfRig(tracks.capture.cameras[i])},
         {"params_std", params_std},
         {"correlations", correlations},
         {"drift",
          {{"from_start", DriftToJson(result.drifts[i])},
           {"from_rig", DriftToJson(result.drifts_from_rig[i])}}},
         {"moved_deg", pose.is_moved ? Json(pose.angle_deg) : Json(nullptr)},
         {"num_frames", totals.num_frames[i]},
         {"num_observations", totals.num_observations[i]},
         {"refined_share", RefinedShare(tracks.keypoints, i)},
         {"rms_px_before", NumberOrNull(result.rms_px_before[i])},
         {"rms_px_after", NumberOrNull(result.rms_px_after[i])},
         {"flags", flags}});
    if (result.soft_extrinsics) {
      cameras.back()["extrinsics_correction"] =
          MakeCorrection(tracks.capture.cameras[i], result.cameras[i]);
    }
  }
  return cameras;
}

Json MakeStages(const std::vector<Stage>& stages) {
  const auto to_object =
      [](const std::vector<std::pair<std::string, double>>& values) {
        Json object = Json::object();
        for (const auto& value : values) {
          object[value.first] = NumberOrNull(value.second);
        }
        return object;
      };
  Json json = Json::array();
  for (const Stage& stage : stages) {
    json.push_back({{"index", stage.index},
                    {"name", stage.name},
                    {"weights", to_object(stage.weights)},
                    {"iterations", stage.num_iterations},
                    {"time_s", stage.time_s},
                    {"cost", to_object(stage.costs)},
                    {"rms_px", NumberOrNull(stage.rms_px)},
                    {"termination", stage.termination}});
  }
  return json;
}

// Up to here: what is left to do is a second of writing at most.
Json MakeCpuTime() {
  const CpuTime time = ProcessCpuTime();
  return {{"total", time.total_s}, {"serial", time.serial_s}};
}

}  // namespace

Totals AddUp(const Tracks& tracks) {
  const Scene& scene = tracks.scene;
  Totals totals;
  totals.num_frames.assign(scene.cameras.size(), 0);
  for (const Frame& frame : scene.frames) {
    std::vector<bool> seen(frame.images.size(), false);
    for (const Observation& observation : frame.observations) {
      seen[observation.image_idx] = true;
    }
    for (size_t i = 0; i < frame.images.size(); ++i) {
      totals.num_frames[frame.images[i].camera_idx] += seen[i];
    }
  }
  const Communicator& ranks = *scene.ranks;
  totals.num_frames = Sum(ranks, totals.num_frames);
  totals.num_observations = NumObservationsByCamera(scene);
  totals.peak_rss_bytes = Concatenate(ranks, std::vector<size_t>{PeakRss()});
  for (const std::string& frame : Concatenate(ranks, DescribeFrames(tracks))) {
    totals.frames.push_back(Json::parse(frame));
  }
  return totals;
}

// The refined intrinsics with the extrinsics as they were given.
std::vector<KnownCamera> GivenCameras(const Capture& capture,
                                      const RefinerResult& result) {
  std::vector<KnownCamera> cameras = result.cameras;
  for (size_t i = 0; i < cameras.size(); ++i) {
    cameras[i].cam_from_world = capture.cameras[i].cam_from_world;
  }
  return cameras;
}

nlohmann::ordered_json MakeSummary(const OptionParser& options,
                                   const Tracks& tracks,
                                   const RefinerResult& result,
                                   const RunReport& report,
                                   const Totals& totals) {
  const RefinementResult& refinement = result.refined.refinement;
  Json timings = Json::object();
  for (const auto& name_and_time : report.timings_s) {
    timings[name_and_time.first] = name_and_time.second;
  }
  Json summary = {
      {"schema_version", 1},
      {"tool",
       {{"version", Version()},
        {"colmap_version", host::VersionInfo()},
        {"git", GitCommit()}}},
      {"created", UtcNow()},
      {"options", options.ToJson()},
      {"inputs", report.inputs},
      {"frames", totals.frames},
      {"cameras", MakeCameras(tracks, result, totals)},
      {"stages", MakeStages(report.stages)},
      {"result",
       {{"status", result.status},
        {"rms_px_before", NumberOrNull(result.rms_px_before.back())},
        {"rms_px_after", NumberOrNull(result.rms_px_after.back())},
        {"held_out_rms_px", NumberOrNull(result.refined.held_out_rms_px)},
        {"static_points",
         {{"num_points", result.static_points.num_points},
          {"num_tracks", result.static_points.num_tracks},
          {"observation_share", result.static_points.observation_share}}},
        {"extrinsics", result.soft_extrinsics ? "corrected" : "given"},
        {"last_step_stds", refinement.last_step_stds},
        {"last_focal_change", refinement.last_focal_change},
        {"noise_std_px", refinement.noise_std_px},
        {"feature_noise_std_px",
         refinement.feature_noise_std_px > 0.0
             ? Json(refinement.feature_noise_std_px)
             : Json(nullptr)},
        {"outlier_share", refinement.outlier_share},
        {"max_inlier_px", NumberOrNull(result.max_inlier_px)},
        {"noise_mixture", MakeNoiseMixture(refinement.noise_components)},
        {"modes", MakeModes(result)}}},
      {"timings_s", timings},
      {"cpu_s", MakeCpuTime()},
      {"peak_rss_bytes",
       *std::max_element(totals.peak_rss_bytes.begin(),
                         totals.peak_rss_bytes.end())}};
  if (totals.peak_rss_bytes.size() > 1) {
    summary["peak_rss_bytes_of_processes"] = totals.peak_rss_bytes;
  }
  summary["result"]["limits_exceeded"] =
      ViolationsToJson(FindViolations(report.limits, summary["cameras"]));
  if (!report.evaluation.is_null()) {
    summary["evaluation"] = report.evaluation;
  }
  return summary;
}

}  // namespace mfir

#include "colmap_ext/refinement/result_writer.h"

#include <sys/resource.h>

#include <algorithm>
#include <cmath>
#include <ctime>
#include <filesystem>
#include <fstream>

#include "colmap_ext/host/reconstruction.h"
#include "colmap_ext/host/util.h"
#include "colmap_ext/io/camera_models.h"
#include "colmap_ext/io/model_io.h"
#include "colmap_ext/refinement/capture_model.h"
#include "colmap_ext/report/report_reader.h"
#include "colmap_ext/rigs/rig_io.h"
#include "src/report_page/report_page.h"
#include "src/util/cpu_time.h"
#include "src/util/errors.h"
#include "src/util/parallel_for.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr double kMaxFocalStd = 0.05;  // relative
constexpr char kReportName[] = "report.html";

Json NumberOrNull(double value) {
  return std::isfinite(value) ? Json(value) : Json(nullptr);
}

bool AllFinite(const std::vector<double>& values) {
  return std::all_of(values.begin(), values.end(), [](double value) {
    return std::isfinite(value);
  });
}

bool IsFinite(const Rigid3& pose) {
  return pose.rotation.coeffs().allFinite() && pose.translation.allFinite();
}

void WriteTextFile(const fs::path& path, const std::string& text) {
  std::ofstream file(path);
  file << text;
  file.close();
  if (!file) {
    throw OutputError(path.string() +
                      ": cannot write the file. Is the disk full?");
  }
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

host::Reconstruction MakeRigModel(const std::vector<KnownCamera>& cameras) {
  host::Reconstruction reconstruction;
  for (size_t i = 0; i < cameras.size(); ++i) {
    const auto id = static_cast<host::camera_t>(i + 1);
    const KnownCamera& known = cameras[i];
    AddPosedImage(id,
                  known.image_name,
                  id,
                  {known.name,
                   known.cam_from_world,
                   known.model,
                   known.width,
                   known.height,
                   known.params},
                  &reconstruction);
  }
  return reconstruction;
}

// One row per solve; columns are the terms of all of them.
std::string MakeHistory(const std::vector<Stage>& stages) {
  std::vector<std::string> names;
  for (const Stage& stage : stages) {
    for (const auto& name_and_weight : stage.weights) {
      if (std::find(names.begin(), names.end(), name_and_weight.first) ==
          names.end()) {
        names.push_back(name_and_weight.first);
      }
    }
  }
  std::ostringstream csv;
  csv.precision(17);
  csv << "index,name,iterations,time_s,rms_px,termination";
  for (const std::string& name : names) {
    csv << "," << name << "_weight," << name << "_cost";
  }
  csv << "\n";
  for (const Stage& stage : stages) {
    csv << stage.index << "," << stage.name << "," << stage.num_iterations
        << "," << stage.time_s << "," << stage.rms_px << ","
        << stage.termination;
    for (const std::string& name : names) {
      for (const auto* values : {&stage.weights, &stage.costs}) {
        csv << ",";
        for (const auto& name_and_value : *values) {
          if (name_and_value.first == name) csv << name_and_value.second;
        }
      }
    }
    csv << "\n";
  }
  return csv.str();
}

// What all ranks know together.
struct Totals {
  Json frames = Json::array();
  // By camera.
  std::vector<size_t> num_frames;
  std::vector<size_t> num_observations;
  std::vector<size_t> peak_rss_bytes;  // by rank
};

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

Totals AddUp(const Tracks& tracks) {
  const Scene& scene = tracks.scene;
  Totals totals;
  totals.num_frames.assign(scene.cameras.size(), 0);
  totals.num_observations.assign(scene.cameras.size(), 0);
  for (const Frame& frame : scene.frames) {
    std::vector<bool> seen(frame.images.size(), false);
    for (const Observation& observation : frame.observations) {
      seen[observation.image_idx] = true;
      ++totals.num_observations[frame.images[observation.image_idx].camera_idx];
    }
    for (size_t i = 0; i < frame.images.size(); ++i) {
      totals.num_frames[frame.images[i].camera_idx] += seen[i];
    }
  }
  const Communicator& ranks = *scene.ranks;
  totals.num_frames = Sum(ranks, totals.num_frames);
  totals.num_observations = Sum(ranks, totals.num_observations);
  totals.peak_rss_bytes = Concatenate(ranks, std::vector<size_t>{PeakRss()});
  for (const std::string& frame : Concatenate(ranks, DescribeFrames(tracks))) {
    totals.frames.push_back(Json::parse(frame));
  }
  return totals;
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

Json MakeSummary(const OptionParser& options,
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
       {{"version", MFIR_VERSION},
        {"colmap_version", host::VersionInfo()},
        {"git", MFIR_GIT_COMMIT}}},
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

// Models of frames are made and written some at a time, side by side, and then
// joined in their order. Over ranks there is no joint model.
void WriteFrames(const Tracks& tracks,
                 const RefinerResult& result,
                 const RunReport& report,
                 const fs::path& path,
                 CaptureModel* joint) {
  const std::vector<const FrameModel*> models = tracks.capture.UsedFrames();
  const auto num_at_once = static_cast<size_t>(2 * report.num_threads);
  for (size_t first = 0; first < models.size(); first += num_at_once) {
    const size_t num = std::min(num_at_once, models.size() - first);
    std::vector<host::Reconstruction> refined(num);
    ParallelFor(num, report.num_threads, [&](size_t i) {
      const FrameModel& model = *models[first + i];
      refined[i] = RefinedReconstruction(result.rig_from_normalized,
                                         model,
                                         tracks.scene,
                                         result.refined.estimate,
                                         first + i,
                                         result.cameras,
                                         result.single_frame_mode);
      WriteModel((path / "frames" / model.name).string(), false, refined[i]);
    });
    for (size_t i = 0; joint != nullptr && i < num; ++i) {
      joint->AddFrame(*models[first + i], refined[i]);
    }
  }
}

}  // namespace

void CheckFinite(const Scene& scene, const RefinerResult& result) {
  const auto require = [](bool is_finite, const std::string& what) {
    if (!is_finite) {
      throw SolverError("The solver failed: " + what +
                        " not finite. Nothing is written. Are the start "
                        "intrinsics of that camera or frame plausible?");
    }
  };
  for (const KnownCamera& camera : result.cameras) {
    const std::string what = " of camera '" + camera.name + "' is";
    require(AllFinite(camera.params), "an intrinsic parameter" + what);
    require(IsFinite(camera.cam_from_world), "the pose" + what);
  }
  require(std::isfinite(result.rms_px_after.back()), "the rms after is");
  for (size_t f = 0; f < scene.frames.size(); ++f) {
    const std::string what = " of frame '" + scene.frames[f].name + "' is";
    const FrameEstimate& frame = result.refined.estimate.frames[f];
    for (const ImageEstimate& image : frame.images) {
      require(!result.single_frame_mode || AllFinite(image.params),
              "an intrinsic parameter" + what);
    }
    for (const Eigen::Vector3d& xyz : frame.points) {
      require(xyz.allFinite(), "a point" + what);
    }
  }
}

const std::vector<std::string>& ResultNames() {
  static const std::vector<std::string> names = [] {
    std::vector<std::string> names = {
        "rig_given", "rig", "frames", "model", "KRT"};
    for (const RigFormat& format : RigFormats()) {
      if (std::find(names.begin(), names.end(), format.result_name) ==
          names.end()) {
        names.push_back(format.result_name);
      }
    }
    names.insert(names.end(),
                 {"history.csv", "project.ini", kReportName, "summary.json"});
    return names;
  }();
  return names;
}

WrittenResult WriteResult(const OptionParser& options,
                          const Tracks& tracks,
                          const RefinerResult& result,
                          const RunReport& report,
                          OutputFolder* output) {
  CheckFinite(tracks.scene, result);
  const Communicator& ranks = *tracks.scene.ranks;
  WrittenResult written;
  const fs::path& path = output->TemporaryPath();
  try {
    const bool has_joint = ranks.IsAlone() && !result.single_frame_mode;
    CaptureModel joint(result.cameras, report.image_path);
    WriteFrames(tracks, result, report, path, has_joint ? &joint : nullptr);
    // Of all ranks; then they have written their frames.
    const Totals totals = AddUp(tracks);
    if (!ranks.IsFirst()) return written;
    WriteModel((path / "rig").string(), true, MakeRigModel(result.cameras));
    if (result.soft_extrinsics) {
      WriteModel((path / "rig_given").string(),
                 true,
                 MakeRigModel(GivenCameras(tracks.capture, result)));
    }
    if (has_joint) {
      WriteModel((path / "model").string(), false, joint.Model());
    } else {
      written.remarks.push_back(
          result.single_frame_mode
              ? "No model of all frames: each has intrinsics of its own."
              : "No model of all frames: they are on several processes.");
    }
    for (const std::string& name :
         WriteKRT((path / "KRT").string(), result.cameras)) {
      written.remarks.push_back("KRT cannot hold the distortion of camera '" +
                                name + "'; it has zeros there.");
    }
    for (const std::string& type : report.output_types) {
      const RigFormat& format =
          FindRigFormat("--MultiFrame.output_types", type);
      // Always written, above.
      if (format.result_name == "rig" || format.result_name == "KRT") continue;
      const RigRemarks remarks = WriteRig(
          (path / format.result_name).string(), format, result.cameras);
      written.remarks.insert(
          written.remarks.end(), remarks.begin(), remarks.end());
    }
    options.Write((path / "project.ini").string());
    WriteTextFile(path / "history.csv", MakeHistory(report.stages));
    const Json summary = MakeSummary(options, tracks, result, report, totals);
    written.violations = FindViolations(report.limits, summary["cameras"]);
    WriteTextFile(
        path / "summary.json",
        summary.dump(2, ' ', false, Json::error_handler_t::replace) + "\n");
    if (report.write_page) {
      WriteTextFile(path / kReportName,
                    MakeReportPage(ReadReport(
                        path.string(), output->Path().string(), {})));
    }
    written.path = output->Publish(result.status == "converged").string();
  } catch (const fs::filesystem_error& error) {
    throw OutputError(std::string("--output_path: ") + error.what() + ".");
  }
  return written;
}

}  // namespace mfir

#include "colmap_ext/result/result_writer.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>

#include "colmap_ext/host/reconstruction.h"
#include "colmap_ext/models/camera_models.h"
#include "colmap_ext/models/model_io.h"
#include "colmap_ext/report/report_reader.h"
#include "colmap_ext/result/capture_model.h"
#include "colmap_ext/rigs/rig_io.h"
#include "src/parallel/parallel_for.h"
#include "src/report_page/report_page.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr char kReportName[] = "report.html";

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

// Models of frames are made and written some at a time, side by side, and then
// joined in their order. Over ranks there is no joint model.
void WriteFrames(const Tracks& tracks,
                 const RefinerResult& result,
                 const RunReport& report,
                 const fs::path& path,
                 CaptureModel* joint) {
  const std::vector<const FrameModel*> models = tracks.capture.UsedFrames();
  ParallelInOrder(
      0,
      models.size(),
      report.num_threads,
      [&](size_t f) {
        const FrameModel& model = *models[f];
        host::Reconstruction refined =
            RefinedReconstruction(result.rig_from_normalized,
                                  model,
                                  tracks.scene,
                                  result.refined.estimate,
                                  f,
                                  result.cameras,
                                  result.single_frame_mode);
        WriteModel((path / "frames" / model.name).string(), false, refined);
        return refined;
      },
      [&](size_t f, const host::Reconstruction& refined) {
        if (joint != nullptr) joint->AddFrame(*models[f], refined);
      });
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

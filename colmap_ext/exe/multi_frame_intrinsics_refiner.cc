// The command multi_frame_intrinsics_refiner.

#include <algorithm>
#include <iostream>
#include <utility>

#include "colmap_ext/exe/command.h"
#include "colmap_ext/exe/refiner_inputs.h"
#include "colmap_ext/exe/refiner_options.h"
#include "colmap_ext/host/util.h"
#include "colmap_ext/refinement/refiner_progress.h"
#include "colmap_ext/refinement/refiner_result.h"
#include "colmap_ext/refinement/refiner_solves.h"
#include "colmap_ext/refinement/result_writer.h"

namespace mfir {
namespace {

void LogStaticPoints(const MultiFrameOptions& options,
                     const Scene& scene,
                     const SelectedTracks& selected,
                     const Progress& progress) {
  if (scene.frames.size() < 2) return;
  progress.Log(host::StringPrintf(
      "Static points: %zu, %.1f %% of the observations (static_points %s)",
      selected.static_points.num_points,
      100.0 * selected.static_points.observation_share,
      options.static_points.c_str()));
  if (options.static_points != "drop") return;
  for (size_t f = 0; f < scene.frames.size(); ++f) {
    const std::vector<TrackRole>& roles = selected.selection.roles[f];
    if (std::all_of(roles.begin(), roles.end(), [](TrackRole role) {
          return role == TrackRole::kDropped;
        })) {
      progress.Log("Frame '" + scene.frames[f].name +
                   "' has static points only and takes no part");
    }
  }
}

OutputFolder MakeOutput(const RefinerOptions& options) {
  return OutputFolder(options.output_path,
                      ResultNames(),
                      options.input_path,
                      {options.extrinsics_path,
                       options.image_path,
                       options.ground_truth_path,
                       options.frame_list_path,
                       options.constant_camera_list_path});
}

RunReport MakeReport(const RefinerOptions& options,
                     const RefinerInputs& inputs,
                     const Tracks& tracks,
                     const RefinerResult& result,
                     Progress* progress) {
  RunReport report;
  report.inputs = DescribeInputs(options, inputs.rig, tracks.capture);
  report.evaluation =
      EvaluateCameras(inputs.true_cameras,
                      result.refined.estimate.cameras,
                      options.multi_frame.quiet ? nullptr : &std::cout);
  report.write_page = options.multi_frame.report;
  report.image_path = options.image_path;
  report.stages = progress->Stages();
  report.timings_s = progress->Timings();
  report.output_types = options.OutputTypes();
  report.limits = options.limits;
  return report;
}

void Refine(const RefinerOptions& options, const OptionParser& parser) {
  const MultiFrameOptions& multi_frame = options.multi_frame;
  Progress progress(multi_frame);
  OutputFolder output = MakeOutput(options);

  RefinerInputs inputs = ReadInputs(options, output, &progress);
  const Start start = MakeStart(options, inputs);
  Tracks new_tracks = RetriangulateInRounds(multi_frame,
                                            options.tracks,
                                            output.TemporaryPath(),
                                            start,
                                            std::move(inputs.capture),
                                            &progress);
  const Tracks tracks = RefineKeypoints(
      multi_frame, options.image_path, start, std::move(new_tracks), &progress);
  const SelectedTracks selected = SelectTracks(multi_frame, tracks.scene);
  LogStaticPoints(multi_frame, tracks.scene, selected, progress);
  RefinedTracks refined = RefineTracks(
      multi_frame, options.image_path, tracks, selected.selection, &progress);
  const RefinerResult result =
      CheckResult(multi_frame, start, tracks, selected, std::move(refined));
  WarnOfCameras(result);
  progress.Log(DescribeResult(result));

  progress.Heading("Writing result");
  const WrittenResult written =
      WriteResult(parser,
                  tracks,
                  result,
                  MakeReport(options, inputs, tracks, result, &progress),
                  &output);
  for (const std::string& remark : written.remarks) progress.Log(remark);
  progress.Log("Written to " + written.path);
  ThrowUnlessConverged(result, multi_frame.max_num_iterations, written.path);
  ThrowIfOutsideLimits(written.violations, written.path);
}

}  // namespace

int RunMultiFrameIntrinsicsRefiner(int argc, char** argv) {
  return RunCommand([argc, argv]() {
    RefinerOptions options;
    OptionParser parser;
    ParseRefinerOptions(argc, argv, &options, &parser);
    Refine(options, parser);
  });
}

}  // namespace mfir

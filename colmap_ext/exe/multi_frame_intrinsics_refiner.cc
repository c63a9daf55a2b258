// The command multi_frame_intrinsics_refiner.

#include <algorithm>
#include <iostream>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "colmap_ext/exe/command.h"
#include "colmap_ext/exe/refiner_inputs.h"
#include "colmap_ext/exe/refiner_options.h"
#include "colmap_ext/host/util.h"
#include "colmap_ext/refinement/refiner_progress.h"
#include "colmap_ext/refinement/refiner_result.h"
#include "colmap_ext/refinement/refiner_solves.h"
#include "colmap_ext/result/result_writer.h"
#include "src/parallel/parallel_for.h"
#include "src/util/errors.h"

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

// The first rank makes it.
std::unique_ptr<OutputFolder> MakeOutput(const RefinerOptions& options,
                                         const Communicator& ranks) {
  if (!ranks.IsFirst()) {
    return std::make_unique<OutputFolder>(options.output_path, ResultNames());
  }
  return std::make_unique<OutputFolder>(
      options.output_path,
      ResultNames(),
      options.input_path,
      std::vector<std::string>{options.extrinsics_path,
                               options.image_path,
                               options.ground_truth_path,
                               options.frame_list_path,
                               options.constant_camera_list_path});
}

// What would need the frames of other ranks.
void CheckForRanks(const RefinerOptions& options, const Communicator& ranks) {
  if (ranks.IsAlone()) return;
  const MultiFrameOptions& multi_frame = options.multi_frame;
  const auto require = [](bool is_met, const std::string& what) {
    if (!is_met) {
      throw UsageError("Several processes cannot do this together: " + what +
                       " Change it, or run one process.");
    }
  };
  require(
      multi_frame.NumScheduleSolves() == 0 && !multi_frame.SingleFrameMode(),
      "solves with a schedule or of single frames (preset paper).");
  require(multi_frame.static_points != "merge",
          "--MultiFrame.static_points merge.");
  require(multi_frame.dense_features == "none",
          "--MultiFrame.dense_features " + multi_frame.dense_features +
              " (the default with --image_path; none leaves them out).");
  require(!options.scale_intrinsics, "--MultiFrame.scale_intrinsics 1.");
}

RunReport MakeReport(const RefinerOptions& options,
                     const RefinerInputs& inputs,
                     const Tracks& tracks,
                     const RefinerResult& result,
                     Progress* progress) {
  const bool is_first = tracks.scene.ranks->IsFirst();
  RunReport report;
  report.inputs = DescribeInputs(options, inputs.rig, tracks.capture);
  report.evaluation = EvaluateCameras(
      inputs.true_cameras,
      result.refined.estimate.cameras,
      options.multi_frame.quiet || !is_first ? nullptr : &std::cout);
  report.write_page = options.multi_frame.report;
  report.image_path = options.image_path;
  report.stages = progress->Stages();
  report.timings_s = progress->Timings();
  report.output_types = options.OutputTypes();
  report.num_threads = options.multi_frame.EffectiveNumThreads();
  report.limits = options.limits;
  return report;
}

void Refine(const RefinerOptions& options,
            const OptionParser& parser,
            const Communicator& ranks) {
  CheckForRanks(options, ranks);
  const MultiFrameOptions& multi_frame = options.multi_frame;
  Progress progress(multi_frame);
  const std::unique_ptr<OutputFolder> output = MakeOutput(options, ranks);

  RefinerInputs inputs = ReadInputs(options, ranks, *output, &progress);
  const Start start = MakeStart(options, inputs);
  Tracks new_tracks = RetriangulateInRounds(multi_frame,
                                            options.tracks,
                                            output->TemporaryPath(),
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
  if (ranks.IsFirst()) WarnOfCameras(result);
  progress.Log(DescribeResult(result));

  progress.Heading("Writing result");
  const WrittenResult written =
      WriteResult(parser,
                  tracks,
                  result,
                  MakeReport(options, inputs, tracks, result, &progress),
                  output.get());
  for (const std::string& remark : written.remarks) progress.Log(remark);
  progress.Log("Written to " + written.path);
  ThrowUnlessConverged(result, multi_frame.max_num_iterations, written.path);
  ThrowIfOutsideLimits(written.violations, written.path);
}

}  // namespace

int RunMultiFrameIntrinsicsRefiner(int argc, char** argv) {
  return RunCommandOverRanks([argc, argv](const Communicator& ranks) {
    RefinerOptions options;
    OptionParser parser;
    ParseRefinerOptions(argc, argv, &options, &parser);
    options.multi_frame.quiet = options.multi_frame.quiet || !ranks.IsFirst();
    LimitThreads(options.multi_frame.num_threads);
    Refine(options, parser, ranks);
  });
}

}  // namespace mfir

#include "colmap_ext/exe/refiner_options.h"

#include <filesystem>
#include <sstream>

#include "colmap_ext/feature/dense_feature_sources.h"
#include "colmap_ext/frames/capture_videos.h"
#include "colmap_ext/host/util.h"
#include "colmap_ext/rigs/rig_io.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

void AddPaths(RefinerOptions* options, OptionParser* parser) {
  parser->AddRequired("input_path",
                      &options->input_path,
                      "Folder with one sub-folder per frame, or a COLMAP model "
                      "that holds many frames");
  parser->AddRequired("extrinsics_path",
                      &options->extrinsics_path,
                      "Known extrinsics, in any format of a rig");
  parser->AddRequired(
      "output_path", &options->output_path, "Folder for the result");
  parser->Add("image_path",
              &options->image_path,
              "Images, by frame, by camera or in one folder");
  parser->Add("frame_list_path",
              &options->frame_list_path,
              "File with the frames to use, one name per line");
  parser->Add("constant_camera_list_path",
              &options->constant_camera_list_path,
              "File with cameras whose intrinsics stay at their start, one "
              "name per line");
  parser->Add("extrinsics_format",
              &options->extrinsics_format,
              "auto, " + RigFormatNames());
  parser->Add("extrinsics_pixel_offset",
              &options->extrinsics_pixel_offset,
              "Added to principal points of the extrinsics file; nan: that of "
              "the format");
  parser->Add("ground_truth_path",
              &options->ground_truth_path,
              "Cameras with true intrinsics, for the evaluation only");
  parser->Add("ground_truth_format",
              &options->ground_truth_format,
              "auto, " + RigFormatNames());
}

void AddMultiFrameOptions(MultiFrameOptions* options, OptionParser* parser) {
  const auto add = [&](const char* name, auto* value, const char* help) {
    parser->Add(std::string("MultiFrame.") + name, value, help);
  };
  parser->BeginGroup("Preset");
  add("preset", &options->preset, "accurate or paper: defaults of the others");
  parser->BeginGroup("Weights of the terms and their schedule");
  add("reprojection_weight", &options->reprojection_weight, "lambda0");
  add("rotation_prior_weight",
      &options->rotation_prior_weight,
      "lambda1, initial");
  add("translation_prior_weight",
      &options->translation_prior_weight,
      "lambda2, initial");
  add("featuremetric_weight",
      &options->featuremetric_weight,
      "lambda3; 0: no dense features");
  add("focal_variance_weight",
      &options->focal_variance_weight,
      "lambda4, initial; 0 for this and the next: frames stay independent");
  add("principal_point_variance_weight",
      &options->principal_point_variance_weight,
      "lambda5, initial");
  add("extra_params_variance_weight",
      &options->extra_params_variance_weight,
      "The same for distortion, initial");
  add("weight_growth",
      &options->weight_growth,
      "Factor on prior and variance weights after each solve");
  add("max_prior_weight",
      &options->max_prior_weight,
      "Last prior weight of the schedule; below the initial ones: no schedule");
  add("progressive",
      &options->progressive,
      "0: a single solve at the initial weights");
  parser->BeginGroup("Loss and solver");
  add("loss_scale",
      &options->loss_scale,
      "Cauchy scale (px); 0: loss estimated from the residuals");
  add("max_num_iterations",
      &options->max_num_iterations,
      "Iterations of one solve");
  parser->BeginGroup("What is refined, and from where");
  add("refine_focal_length",
      &options->refine_focal_length,
      "Whether focal lengths are refined");
  add("refine_principal_point",
      &options->refine_principal_point,
      "Whether principal points are refined");
  add("refine_extra_params",
      &options->refine_extra_params,
      "Whether distortion is refined");
  add("use_prior_intrinsics",
      &options->use_prior_intrinsics,
      "Start from the intrinsics of the extrinsics file");
  parser->BeginGroup("Tracks and keypoints");
  add("retriangulation_rounds",
      &options->retriangulation_rounds,
      "How often frames with a database.db get new tracks, with the intrinsics "
      "so far");
  add("refine_keypoints",
      &options->refine_keypoints,
      "Align the keypoints of tracks on the images, by patches warped from "
      "view to view; -1: where there is --image_path, not with paper");
  add("complete_tracks",
      &options->complete_tracks,
      "Look for tracks in further cameras, in the same way");
  add("static_points",
      &options->static_points,
      "Tracks that are in place in several frames: keep (one piece of evidence "
      "for params_std), merge (for the estimate, too) or drop");
  add("held_out_share",
      &options->held_out_share,
      "Share of the tracks that take no part, to check the result");
  parser->BeginGroup("Priors");
  add("extrinsics_rotation_std_deg",
      &options->extrinsics_rotation_std_deg,
      "Standard deviation of the known rotations per axis (degrees); 0: exact");
  add("extrinsics_translation_std",
      &options->extrinsics_translation_std,
      "Standard deviation of the known camera centres per axis (units of the "
      "extrinsics); 0: exact");
  add("prior_focal_std",
      &options->prior_focal_std,
      "Standard deviation of the focal lengths of the extrinsics file (px), "
      "with use_prior_intrinsics; 0: only a start");
  add("prior_principal_point_std",
      &options->prior_principal_point_std,
      "The same for principal points (px)");
  add("min_information",
      &options->min_information,
      "Combinations of intrinsics about which the data say less (1/px^2) stay "
      "at their start; -1: determined worse than 2 % of the focal length or of "
      "half the image diagonal; 0: none");
  parser->BeginGroup("Cameras and names");
  add("camera_model",
      &options->camera_model,
      "COLMAP camera model to convert all cameras to");
  add("camera_name_regex",
      &options->camera_name_regex,
      "One capture group: the camera name within an image name");
  add("frame_name_regex",
      &options->frame_name_regex,
      "One capture group: the frame's name within an image name, where one "
      "model holds many frames");
  add("max_num_frames",
      &options->max_num_frames,
      "Use so many frames, spread evenly over the capture; 0: all");
  parser->BeginGroup("Dense features");
  AddDenseFeatureOptions(options, parser);
  parser->BeginGroup("Computer and output");
  add("use_gpu", &options->use_gpu, "-1: if there is one, 0, 1");
  add("gpu_index", &options->gpu_index, "-1: any");
  add("num_threads", &options->num_threads, "-1: all");
  add("report", &options->report, "0: no report.html");
  add("quiet", &options->quiet, "No progress output");
}

// What the inputs allow.
std::string DefaultDenseFeatures(const RefinerOptions& options) {
  const MultiFrameOptions& multi_frame = options.multi_frame;
  if (multi_frame.featuremetric_weight == 0.0) return "none";
  if (!multi_frame.features.database_path.empty()) return "database";
  if (!multi_frame.features.onnx.path.empty()) return "onnx";
  return options.image_path.empty() ? "none" : "sift";
}

// Whether an option that is -1 means 1.
bool RefinesKeypoints(const RefinerOptions& options) {
  return !options.image_path.empty() && options.multi_frame.preset != "paper" &&
         options.multi_frame.NumScheduleSolves() == 0;
}

void CheckOptions(const RefinerOptions& options) {
  options.multi_frame.Check();
  options.tracks.Check();
  options.limits.Check();
  CheckRigFormat("extrinsics_format", options.extrinsics_format);
  CheckRigFormat("ground_truth_format", options.ground_truth_format);
  for (const std::string& type : options.OutputTypes()) {
    FindRigFormat("--MultiFrame.output_types", type);
  }
  CheckPixelOffset("--extrinsics_pixel_offset",
                   options.extrinsics_pixel_offset);
  const MultiFrameOptions& multi_frame = options.multi_frame;
  if (multi_frame.dense_features == "none" &&
      multi_frame.refine_keypoints != 1 && multi_frame.complete_tracks != 1 &&
      (multi_frame.use_gpu == 1 || multi_frame.gpu_index >= 0)) {
    throw UsageError(
        "--MultiFrame.use_gpu 1 and --MultiFrame.gpu_index are for dense "
        "features and refined keypoints: give --image_path or leave them at "
        "-1.");
  }
  if (options.image_path.empty() &&
      (multi_frame.refine_keypoints == 1 || multi_frame.complete_tracks == 1)) {
    throw UsageError(
        "--MultiFrame.refine_keypoints 1 and complete_tracks 1 need images: "
        "give --image_path or leave them at -1.");
  }
  if (!options.image_path.empty() &&
      !std::filesystem::is_directory(options.image_path)) {
    throw InputError("--image_path " + options.image_path +
                     " is not a folder. Correct it or leave it out: images are "
                     "for dense features and refined keypoints only.");
  }
}

// Of the run, not of the estimate.
void AddOutputOptions(RefinerOptions* options, OptionParser* parser) {
  parser->Add("MultiFrame.output_types",
              &options->output_types,
              "Further rig files in the output, separated by commas: " +
                  RigFormatNames());
  parser->Add("MultiFrame.scale_intrinsics",
              &options->scale_intrinsics,
              "1: intrinsics of RIG for another resolution of the same ratio "
              "are scaled to the images");
  const auto add_limit = [&](const char* name, double* value, const char* of) {
    parser->Add(std::string("MultiFrame.") + name,
                value,
                std::string("Exit code 5 if ") + of +
                    " of a camera is larger; 0: no limit");
  };
  Limits* limits = &options->limits;
  add_limit("max_rms_px", &limits->max_rms_px, "the rms after");
  add_limit("max_focal_std_permille",
            &limits->max_focal_std_permille,
            "the standard deviation of a focal length");
  add_limit("max_principal_point_std_px",
            &limits->max_principal_point_std_px,
            "the standard deviation of the principal point");
  add_limit("max_focal_drift_permille",
            &limits->max_focal_drift_permille,
            "the change of the focal length since RIG");
  add_limit("max_principal_point_drift_px",
            &limits->max_principal_point_drift_px,
            "the change of the principal point since RIG");
}

}  // namespace

std::vector<std::string> RefinerOptions::OutputTypes() const {
  std::vector<std::string> types;
  std::istringstream list(output_types);
  for (std::string type; std::getline(list, type, ',');) {
    host::StringTrim(&type);
    if (!type.empty()) types.push_back(type);
  }
  return types;
}

void AddRefinerOptions(RefinerOptions* options, OptionParser* parser) {
  options->multi_frame.ApplyPreset(options->multi_frame.preset);
  AddPaths(options, parser);
  AddMultiFrameOptions(&options->multi_frame, parser);
  AddOutputOptions(options, parser);
  parser->BeginGroup("New tracks (retriangulation_rounds)");
  AddTrackOptions(&options->tracks, parser);
  parser->AddSharedSection("MultiFrameTriangulator");
}

void ParseRefinerOptions(int argc,
                         char** argv,
                         RefinerOptions* options,
                         OptionParser* parser) {
  MultiFrameOptions* multi_frame = &options->multi_frame;
  parser->SetHelp(
      "Refines the intrinsics of a camera array from several frames, with the "
      "extrinsics known: one set of\nintrinsics per camera, in OUT/rig, with a "
      "report for people (OUT/report.html) and for programs\n"
      "(OUT/summary.json).",
      "colmap multi_frame_intrinsics_refiner --input_path FRAMES "
      "--extrinsics_path RIG --output_path OUT");
  AddRefinerOptions(options, parser);
  parser->Parse(argc, argv, "MultiFrame.preset", [&](const std::string& name) {
    multi_frame->ApplyPreset(name);
  });
  // Only their defaults give way to a schedule.
  if (multi_frame->NumScheduleSolves() > 0) {
    if (!parser->IsSet("MultiFrame.held_out_share")) {
      multi_frame->held_out_share = 0.0;
    }
    if (!parser->IsSet("MultiFrame.retriangulation_rounds")) {
      multi_frame->retriangulation_rounds = 0;
    }
  }
  if (HasVideosOnly(options->image_path)) {
    // The triangulator has decoded them there.
    options->image_path = options->input_path;
  }
  if (multi_frame->dense_features.empty()) {
    multi_frame->dense_features = DefaultDenseFeatures(*options);
  }
  for (int* value :
       {&multi_frame->refine_keypoints, &multi_frame->complete_tracks}) {
    if (*value == -1) *value = RefinesKeypoints(*options) ? 1 : 0;
  }
  CheckOptions(*options);
}

}  // namespace mfir

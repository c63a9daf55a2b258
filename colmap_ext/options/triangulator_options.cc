#include "colmap_ext/options/triangulator_options.h"

#include <cmath>
#include <sstream>

#include "colmap_ext/host/feature_options.h"
#include "colmap_ext/models/camera_models.h"
#include "colmap_ext/rigs/rig_io.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

void CheckRange(const char* name, double value, double min, double max) {
  // Also false for NaN.
  if (value >= min && value <= max) return;
  std::ostringstream message;
  message << "--" << name << " must lie between " << min << " and " << max
          << ", but is " << value << ".";
  throw UsageError(message.str());
}

std::string GuidedMatchingName() {
  return std::string(host::kMatchingSection) + "guided_matching";
}

// Of matching again along epipolar lines, which is part of the verification.
void AddVerificationOptions(TriangulatorOptions* options,
                            OptionParser* parser) {
  host::VisitMatchSelectionOptions(
      &options->feature_matching,
      [parser](const std::string& name, auto* value) {
        parser->Add(name, value, "as in COLMAP");
      });
  parser->Add(host::kMinNumInliersName,
              &options->min_num_inliers,
              "as in COLMAP, of a pair of images");
  parser->Add(GuidedMatchingName(),
              &options->feature_matching.guided_matching,
              "1: match again along the known epipolar lines");
}

void AddMapperOptions(TriangulatorOptions* options, OptionParser* parser) {
  const auto add = [parser](const std::string& name,
                            auto* value,
                            const std::string& help = "as in COLMAP") {
    parser->Add("Mapper." + name, value, help);
  };
  const std::string kFromData =
      "as in COLMAP; 0: from the estimated epipolar tolerance";
  host::TriangulatorOptions* tri = &options->triangulation;
  add("min_num_matches", &options->min_num_matches);
  add("ignore_watermarks", &options->ignore_watermarks);
  add("filter_max_reproj_error", &options->filter_max_reproj_error, kFromData);
  add("filter_min_tri_angle", &options->filter_min_tri_angle);
  add("tri_max_transitivity", &tri->max_transitivity);
  add("tri_create_max_angle_error", &tri->create_max_angle_error, kFromData);
  add("tri_continue_max_angle_error",
      &tri->continue_max_angle_error,
      kFromData);
  add("tri_merge_max_reproj_error", &tri->merge_max_reproj_error, kFromData);
  add("tri_complete_max_reproj_error",
      &tri->complete_max_reproj_error,
      kFromData);
  add("tri_complete_max_transitivity", &tri->complete_max_transitivity);
  add("tri_re_max_angle_error", &tri->re_max_angle_error, kFromData);
  add("tri_re_min_ratio", &tri->re_min_ratio);
  add("tri_re_max_trials", &tri->re_max_trials);
  add("tri_min_angle", &tri->min_angle);
  add("tri_ignore_two_view_tracks", &tri->ignore_two_view_tracks);
}

void AddOwnOptions(TriangulatorOptions* options, OptionParser* parser) {
  const auto add = [parser](
                       const std::string& name, auto* value, const char* help) {
    parser->Add("MultiFrameTriangulator." + name, value, help);
  };
  add("max_view_angle",
      &options->view_overlap.max_view_angle,
      "largest angle between two lines of sight to a point, degrees");
  add("min_overlap",
      &options->view_overlap.min_overlap,
      "smallest share of each image of a pair that the other camera sees");
  add("focal_length_factor",
      &options->focal_length_factor,
      "> 0: start from this focal length / larger image side");
  add("feature_extractor",
      &options->feature_extractor,
      "built_in: the same as COLMAP's SIFT, faster; or colmap");
  add("refine_keypoints",
      &options->refine_keypoints,
      "1: align keypoints on the images; only with intrinsics that are good");
  add("complete_tracks",
      &options->complete_tracks,
      "1: look for tracks in further cameras, in the same way");
  add("num_threads", &options->num_threads, "-1: all");
  add("overwrite",
      &options->overwrite,
      "1: redo finished frames, databases of this command included");
  add("quiet", &options->quiet, "1: print no progress");
}

}  // namespace

TriangulatorOptions::TriangulatorOptions() {
  // Twice the points on a real dome: the ratio test has fewer rivals.
  feature_matching.guided_matching = true;
  triangulation.ignore_two_view_tracks = false;
  // COLMAP leaves cameras out whose intrinsics look like a failed estimate.
  // Here they are given, and k2 of a narrow lens may well be 3.
  triangulation.min_focal_length_ratio = 0.0;
  triangulation.max_focal_length_ratio = std::numeric_limits<double>::max();
  triangulation.max_extra_param = std::numeric_limits<double>::max();
  triangulation.create_max_angle_error = 0.0;
  triangulation.continue_max_angle_error = 0.0;
  triangulation.re_max_angle_error = 0.0;
  triangulation.merge_max_reproj_error = 0.0;
  triangulation.complete_max_reproj_error = 0.0;
}

bool TriangulatorOptions::MatchesAlongEpipolarLines() const {
  return feature_matching.guided_matching &&
         host::MatchesNearestSift(feature_matching);
}

void TriangulatorOptions::Check() const {
  CheckRigFormat("extrinsics_format", extrinsics_format);
  CheckRigFormat("intrinsics_format", intrinsics_format);
  CheckPixelOffset("--extrinsics_pixel_offset", extrinsics_pixel_offset);
  CheckPixelOffset("--intrinsics_pixel_offset", intrinsics_pixel_offset);
  if (FindCameraModel(camera_model) == nullptr) {
    throw UsageError("--ImageReader.camera_model '" + camera_model +
                     "' does not exist.");
  }
  const std::string prefix = "MultiFrameTriangulator.";
  CheckRange(
      (prefix + "max_view_angle").c_str(), view_overlap.max_view_angle, 1, 180);
  CheckRange(
      (prefix + "min_overlap").c_str(), view_overlap.min_overlap, 0.001, 1);
  CheckRange(
      (prefix + "focal_length_factor").c_str(), focal_length_factor, 0, 100);
  CheckRange(
      (prefix + "max_epipolar_error").c_str(), max_epipolar_error, 1e-4, 0.5);
  if (feature_extractor != "built_in" && feature_extractor != "colmap") {
    throw UsageError("--" + prefix + "feature_extractor " + feature_extractor +
                     ": must be built_in or colmap.");
  }
  if (num_threads == 0 || num_threads < -1 || num_threads > 1024) {
    throw UsageError("--" + prefix +
                     "num_threads must be 1 to 1024, or -1 for all.");
  }
  // Each octave below 0 takes 4 times the memory.
  CheckRange(host::kFirstOctaveName,
             host::SiftExtraction(feature_extraction).first_octave,
             -2,
             10);
  CheckRange("MultiFrame.max_num_frames", max_num_frames, 0, 1e9);
  const double kMax = std::numeric_limits<double>::max();
  CheckRange(host::kMinNumInliersName, min_num_inliers, 0, 1e9);
  CheckRange("Mapper.min_num_matches", min_num_matches, 1, 1e9);
  CheckRange(
      "Mapper.filter_max_reproj_error", filter_max_reproj_error, 0, kMax);
  CheckRange("Mapper.filter_min_tri_angle", filter_min_tri_angle, 0, 180);
  CheckRange("Mapper.tri_create_max_angle_error",
             triangulation.create_max_angle_error,
             0,
             90);
  CheckRange("Mapper.tri_continue_max_angle_error",
             triangulation.continue_max_angle_error,
             0,
             90);
  CheckRange(
      "Mapper.tri_re_max_angle_error", triangulation.re_max_angle_error, 0, 90);
  CheckRange("Mapper.tri_merge_max_reproj_error",
             triangulation.merge_max_reproj_error,
             0,
             kMax);
  CheckRange("Mapper.tri_complete_max_reproj_error",
             triangulation.complete_max_reproj_error,
             0,
             kMax);
  // The others are COLMAP's to check; it reports the option by itself.
  host::TriangulatorOptions positive = triangulation;
  positive.create_max_angle_error = positive.continue_max_angle_error = 1.0;
  positive.re_max_angle_error = positive.merge_max_reproj_error = 1.0;
  positive.complete_max_reproj_error = 1.0;
  if (!feature_extraction.Check() || !feature_matching.Check() ||
      !positive.Check()) {
    throw UsageError(
        "An option of [SiftExtraction], [SiftMatching] or [Mapper] is out of "
        "range; the line above names it.");
  }
}

void AddTrackOptions(TriangulatorOptions* options, OptionParser* parser) {
  parser->Add("MultiFrameTriangulator.max_epipolar_error",
              &options->max_epipolar_error,
              "cap of the tolerance of epipolar errors / larger image side");
  AddVerificationOptions(options, parser);
  AddMapperOptions(options, parser);
  for (const char* section : host::kMatchingSections) {
    parser->AddSharedSection(section);
  }
  parser->AddSharedSection("Mapper");
}

void AddTriangulatorOptions(TriangulatorOptions* options,
                            OptionParser* parser) {
  parser->AddRequired("image_path",
                      &options->image_path,
                      "IMAGES/FRAME/CAMERA.ext, IMAGES/CAMERA/FRAME.ext or "
                      "IMAGES/CAMERA_FRAME.ext");
  parser->AddRequired(
      "extrinsics_path", &options->extrinsics_path, "the known extrinsics");
  parser->AddRequired("output_path",
                      &options->output_path,
                      "gets FRAME/database.db and FRAME/sparse/0");
  parser->Add("extrinsics_format",
              &options->extrinsics_format,
              "auto, " + RigFormatNames());
  parser->Add("extrinsics_pixel_offset",
              &options->extrinsics_pixel_offset,
              "added to principal points; nan: that of the format");
  parser->Add("intrinsics_path",
              &options->intrinsics_path,
              "cameras to start from; empty: those of extrinsics_path");
  parser->Add("intrinsics_format",
              &options->intrinsics_format,
              "auto, " + RigFormatNames());
  parser->Add("intrinsics_pixel_offset",
              &options->intrinsics_pixel_offset,
              "added to principal points; nan: that of the format");
  parser->Add(
      "mask_path",
      &options->mask_path,
      "in the layout of the images: MASKS/IMAGE_NAME.png, or one for all "
      "frames: MASKS/CAMERA.png");
  parser->Add("frame_list_path",
              &options->frame_list_path,
              "file with the names of the frames, one per line");
  parser->BeginGroup("Pairs, start and computer");
  AddOwnOptions(options, parser);
  parser->BeginGroup("Names and images");
  parser->Add("MultiFrame.camera_name_regex",
              &options->camera_name_regex,
              "one capture group: the camera name within an image name");
  parser->Add("MultiFrame.frame_name_regex",
              &options->frame_name_regex,
              "one capture group: the frame within the path of an image; where "
              "the layout of the images is ambiguous");
  parser->Add("MultiFrame.max_num_frames",
              &options->max_num_frames,
              "take so many frames, spread evenly over the capture; 0: all");
  parser->Add("MultiFrame.scale_intrinsics",
              &options->scale_intrinsics,
              "1: intrinsics for another resolution of the same ratio are "
              "scaled to the images");
  parser->Add(
      "MultiFrame.video_offset_list_path",
      &options->video_offset_list_path,
      "file with lines 'CAMERA OFFSET': frame k of the capture is frame "
      "k + OFFSET of the camera's video");
  parser->Add("ImageReader.camera_model",
              &options->camera_model,
              "camera model for focal_length_factor");
  parser->Add("ImageReader.camera_mask_path",
              &options->camera_mask_path,
              "one mask for all images");
  parser->BeginGroup("COLMAP's features and matching");
  const auto add = [parser](const std::string& name, auto* value) {
    parser->Add(name, value, "as in COLMAP");
  };
  host::VisitFeatureTypes(
      &options->feature_types,
      [parser](const std::string& name, auto* value, const char* help) {
        parser->Add(name, value, help);
      });
  host::VisitExtractionOptions(&options->feature_extraction, add);
  host::VisitMatchingOptions(&options->feature_matching, add);
  parser->BeginGroup("Verification and triangulation");
  AddTrackOptions(options, parser);
  parser->AddSharedSection("MultiFrame");
  parser->AddSharedSection("ImageReader");
  for (const char* section : host::kExtractionSections) {
    parser->AddSharedSection(section);
  }
}

void ChooseFeatures(const OptionParser& parser, TriangulatorOptions* options) {
  host::SetFeatureTypes(options->feature_types,
                        &options->feature_extraction,
                        &options->feature_matching);
  // A matcher that is asked for shall match, not be matched again after.
  if (!host::MatchesNearestSift(options->feature_matching) &&
      !parser.IsSet(GuidedMatchingName())) {
    options->feature_matching.guided_matching = false;
  }
  // COLMAP's default asks for a GPU; without one it would end the program.
  if (!host::HasGpuFeatures()) {
    options->feature_extraction.use_gpu = false;
    options->feature_matching.use_gpu = false;
  }
}

}  // namespace mfir

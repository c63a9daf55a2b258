// Names of COLMAP's options of features and matches. visit(name, &value) is
// called for those of a group that have an effect on what we do.

#pragma once

#include <string>
#include <vector>

#include "colmap_ext/host/feature.h"

namespace mfir::host {

#if MFIR_COLMAP_MAJOR >= 4
inline constexpr char kExtractionSection[] = "FeatureExtraction.";
inline constexpr char kMatchingSection[] = "FeatureMatching.";
inline constexpr char kMinNumInliersName[] = "TwoViewGeometry.min_num_inliers";
inline constexpr const char* kExtractionSections[] = {
    "FeatureExtraction", "SiftExtraction", "AlikedExtraction"};
inline constexpr const char* kMatchingSections[] = {
    "FeatureMatching", "SiftMatching", "AlikedMatching", "TwoViewGeometry"};
#else
inline constexpr char kExtractionSection[] = "SiftExtraction.";
inline constexpr char kMatchingSection[] = "SiftMatching.";
inline constexpr char kMinNumInliersName[] = "SiftMatching.min_num_inliers";
inline constexpr const char* kExtractionSections[] = {"SiftExtraction"};
inline constexpr const char* kMatchingSections[] = {"SiftMatching"};
#endif
// The one whose range we check.
inline constexpr char kFirstOctaveName[] = "SiftExtraction.first_octave";

// The kinds of features and matches, which 3.8 has no choice of.
template <typename Visitor>
void VisitFeatureTypes([[maybe_unused]] FeatureTypes* types,
                       [[maybe_unused]] const Visitor& visit) {
#if MFIR_COLMAP_MAJOR >= 4
  visit("FeatureExtraction.type",
        &types->extractor,
        "SIFT; ALIKED_N16ROT and ALIKED_N32 need a COLMAP with ONNX");
  visit("FeatureMatching.type",
        &types->matcher,
        "SIFT_BRUTEFORCE, SIFT_LIGHTGLUE, ALIKED_BRUTEFORCE, "
        "ALIKED_LIGHTGLUE; empty: the first for SIFT, the last for ALIKED");
#endif
}

template <typename Visitor>
void VisitExtractionOptions(FeatureExtractionOptions* options,
                            const Visitor& visit) {
  const std::string section = kExtractionSection;
  visit(section + "num_threads", &options->num_threads);
  visit(section + "use_gpu", &options->use_gpu);
  visit(section + "gpu_index", &options->gpu_index);
  visit(section + "max_image_size", &options->max_image_size);
  colmap::SiftExtractionOptions& sift = SiftExtraction(*options);
  visit("SiftExtraction.max_num_features", &sift.max_num_features);
  visit(kFirstOctaveName, &sift.first_octave);
  visit("SiftExtraction.num_octaves", &sift.num_octaves);
  visit("SiftExtraction.octave_resolution", &sift.octave_resolution);
  visit("SiftExtraction.peak_threshold", &sift.peak_threshold);
  visit("SiftExtraction.edge_threshold", &sift.edge_threshold);
  visit("SiftExtraction.estimate_affine_shape", &sift.estimate_affine_shape);
  visit("SiftExtraction.max_num_orientations", &sift.max_num_orientations);
  visit("SiftExtraction.upright", &sift.upright);
  visit("SiftExtraction.domain_size_pooling", &sift.domain_size_pooling);
  visit("SiftExtraction.dsp_min_scale", &sift.dsp_min_scale);
  visit("SiftExtraction.dsp_max_scale", &sift.dsp_max_scale);
  visit("SiftExtraction.dsp_num_scales", &sift.dsp_num_scales);
#if MFIR_COLMAP_MAJOR >= 4
  auto& aliked = *options->aliked;
  visit("AlikedExtraction.max_num_features", &aliked.max_num_features);
  visit("AlikedExtraction.min_score", &aliked.min_score);
  visit("AlikedExtraction.n16rot_model_path", &aliked.n16rot_model_path);
  visit("AlikedExtraction.n32_model_path", &aliked.n32_model_path);
#endif
}

template <typename Visitor>
void VisitMatchingOptions(FeatureMatchingOptions* options,
                          const Visitor& visit) {
  const std::string section = kMatchingSection;
  visit(section + "num_threads", &options->num_threads);
  visit(section + "use_gpu", &options->use_gpu);
  visit(section + "gpu_index", &options->gpu_index);
  visit(section + "max_num_matches", &options->max_num_matches);
#if MFIR_COLMAP_MAJOR >= 4
  auto& sift = *options->sift;
  visit("SiftMatching.cpu_brute_force_matcher", &sift.cpu_brute_force_matcher);
  visit("SiftMatching.lightglue_min_score", &sift.lightglue.min_score);
  visit("SiftMatching.lightglue_model_path", &sift.lightglue.model_path);
  auto& brute_force = options->aliked->brute_force;
  visit("AlikedMatching.brute_force_min_cossim", &brute_force.min_cossim);
  visit("AlikedMatching.brute_force_max_ratio", &brute_force.max_ratio);
  visit("AlikedMatching.brute_force_cross_check", &brute_force.cross_check);
  visit("AlikedMatching.bruteforce_model_path", &brute_force.model_path);
  auto& lightglue = options->aliked->lightglue;
  visit("AlikedMatching.lightglue_min_score", &lightglue.min_score);
  visit("AlikedMatching.lightglue_model_path", &lightglue.model_path);
#endif
}

// Which neighbours are matches: also for matching along epipolar lines.
template <typename Visitor>
void VisitMatchSelectionOptions(FeatureMatchingOptions* options,
                                const Visitor& visit) {
  colmap::SiftMatchingOptions& sift = SiftMatching(*options);
  visit("SiftMatching.max_ratio", &sift.max_ratio);
  visit("SiftMatching.max_distance", &sift.max_distance);
  visit("SiftMatching.cross_check", &sift.cross_check);
}

}  // namespace mfir::host

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
inline constexpr const char* kExtractionSections[] = {"FeatureExtraction",
                                                      "SiftExtraction"};
inline constexpr const char* kMatchingSections[] = {
    "FeatureMatching", "SiftMatching", "TwoViewGeometry"};
#else
inline constexpr char kExtractionSection[] = "SiftExtraction.";
inline constexpr char kMatchingSection[] = "SiftMatching.";
inline constexpr char kMinNumInliersName[] = "SiftMatching.min_num_inliers";
inline constexpr const char* kExtractionSections[] = {"SiftExtraction"};
inline constexpr const char* kMatchingSections[] = {"SiftMatching"};
#endif
// The one whose range we check.
inline constexpr char kFirstOctaveName[] = "SiftExtraction.first_octave";

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
  visit("SiftMatching.cpu_brute_force_matcher",
        &options->sift->cpu_brute_force_matcher);
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

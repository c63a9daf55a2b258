#!/bin/bash
# colmap_help_test.sh COLMAP_PROGRAM: `colmap help` lists our commands, and all
# of COLMAP's own beside them, each exactly once.
set -euo pipefail

ours="multi_frame_automatic_refiner multi_frame_evaluator multi_frame_intrinsics_refiner
  multi_frame_reporter multi_frame_rig_converter multi_frame_simulator
  multi_frame_triangulator"
shared="help gui automatic_reconstructor bundle_adjuster color_extractor
  database_cleaner database_creator database_merger exhaustive_matcher
  feature_extractor feature_importer hierarchical_mapper image_deleter
  image_filterer image_rectifier image_registrator image_undistorter
  image_undistorter_standalone mapper matches_importer model_aligner
  model_analyzer model_comparer model_converter model_cropper model_merger
  model_orientation_aligner model_splitter model_transformer point_filtering
  point_triangulator project_generator sequential_matcher spatial_matcher
  transitive_matcher vocab_tree_builder vocab_tree_matcher
  vocab_tree_retriever"
dense="delaunay_mesher patch_match_stereo poisson_mesher stereo_fusion"

help=$("$1" help)
case $help in
  "COLMAP 3."*) colmaps="$shared $dense rig_bundle_adjuster" ;;
  "COLMAP 4."*)
    colmaps="$shared version geometric_verifier global_mapper
      guided_geometric_verifier model_clusterer pose_prior_mapper
      rig_configurator rotation_averager view_graph_calibrator"
    # Only where COLMAP was built with its multi-view stereo.
    [[ $help != *patch_match_stereo* ]] ||
      colmaps+=" $dense advancing_front_mesher mesh_simplifier mesh_texturer"
    ;;
  *) echo "unknown version: $help" && exit 1 ;;
esac

# shellcheck disable=SC2086 # the lists are to be split
expected=$(printf '%s\n' $ours $colmaps | sort)
listed=$(sed '1,/^Available commands:/d; s/ //g; /^$/d' <<<"$help" | sort)
if ! diff <(echo "$expected") <(echo "$listed"); then
  echo "'$1 help' (>) does not list the expected commands (<)"
  exit 1
fi
echo "$(wc -l <<<"$listed") commands listed"

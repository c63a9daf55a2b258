#!/bin/bash
# colmap_help_test.sh COLMAP_PROGRAM: `colmap help` lists our commands, and all
# of COLMAP 3.8's own beside them, each exactly once.
set -euo pipefail

ours="multi_frame_evaluator multi_frame_intrinsics_refiner multi_frame_simulator
  multi_frame_triangulator"
colmaps="help gui automatic_reconstructor bundle_adjuster color_extractor
  database_cleaner database_creator database_merger delaunay_mesher
  exhaustive_matcher feature_extractor feature_importer hierarchical_mapper
  image_deleter image_filterer image_rectifier image_registrator
  image_undistorter image_undistorter_standalone mapper matches_importer
  model_aligner model_analyzer model_comparer model_converter model_cropper
  model_merger model_orientation_aligner model_splitter model_transformer
  patch_match_stereo point_filtering point_triangulator poisson_mesher
  project_generator rig_bundle_adjuster sequential_matcher spatial_matcher
  stereo_fusion transitive_matcher vocab_tree_builder vocab_tree_matcher
  vocab_tree_retriever"

# shellcheck disable=SC2086 # the lists are to be split
expected=$(printf '%s\n' $ours $colmaps | sort)
listed=$("$1" help | sed '1,/^Available commands:/d; s/ //g; /^$/d' | sort)
if ! diff <(echo "$expected") <(echo "$listed"); then
  echo "'$1 help' (>) does not list the expected commands (<)"
  exit 1
fi
echo "$(wc -l <<<"$listed") commands listed"

// Options of the command multi_frame_intrinsics_refiner.

#pragma once

#include <limits>
#include <string>
#include <vector>

#include "colmap_ext/options/option_parser.h"
#include "colmap_ext/options/triangulator_options.h"
#include "colmap_ext/result/limits.h"
#include "src/refinement/options.h"

namespace mfir {

struct RefinerOptions {
  std::string input_path;
  std::string extrinsics_path;
  std::string output_path;
  std::string image_path;
  std::string frame_list_path;
  std::string extrinsics_format = "auto";
  double extrinsics_pixel_offset = std::numeric_limits<double>::quiet_NaN();
  std::string ground_truth_path;
  std::string ground_truth_format = "auto";
  std::string constant_camera_list_path;
  std::string output_types;  // names of RigFormats, separated by commas
  Limits limits;
  bool scale_intrinsics = false;
  MultiFrameOptions multi_frame;
  TriangulatorOptions tracks;  // of retriangulation_rounds, see AddTrackOptions

  std::vector<std::string> OutputTypes() const;
};

// Registers all options. The parser keeps pointers into `options`.
void AddRefinerOptions(RefinerOptions* options, OptionParser* parser);

// Reads the ini file and the command line into `options` and checks them. The
// parser keeps pointers into `options`. Throws UsageError, and InputError for
// paths that do not exist.
void ParseRefinerOptions(int argc,
                         char** argv,
                         RefinerOptions* options,
                         OptionParser* parser);

}  // namespace mfir

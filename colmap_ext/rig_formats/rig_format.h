// The formats of RIG as a table.

#pragma once

#include <string>
#include <vector>

#include "colmap_ext/rig_formats/formats.h"

namespace mfir {

struct RigFormat {
  std::string name;         // of --extrinsics_format and --output_type
  std::string what;         // for messages
  std::string result_name;  // of the file or folder in the refiner's OUT
  // Added to principal points to get COLMAP's, whose centre of the top-left
  // pixel is (0.5, 0.5).
  double pixel_offset;
  // Whether entries are images, whose cameras follow from their names.
  bool names_images;
  Cameras (*read)(const std::string&, double, RigRemarks*);
  void (*write)(const std::string&, const Cameras&, double, RigRemarks*);
};

const std::vector<RigFormat>& RigFormats();

// "colmap, krt, ... or multical", for help and messages.
std::string RigFormatNames();

// Throws UsageError, naming the option, for an unknown name.
const RigFormat& FindRigFormat(const std::string& option,
                               const std::string& name);

// The same for options whose value may be "auto".
void CheckRigFormat(const std::string& option, const std::string& name);

// From what lies at `path`. Throws InputError if it is no rig.
const RigFormat& DetectRigFormat(const std::string& path);

}  // namespace mfir

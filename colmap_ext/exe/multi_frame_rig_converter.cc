// The command multi_frame_rig_converter.

#include <algorithm>
#include <filesystem>
#include <iostream>
#include <limits>

#include "colmap_ext/exe/command.h"
#include "colmap_ext/frames/capture_images.h"
#include "colmap_ext/host/image_file.h"
#include "colmap_ext/options/option_parser.h"
#include "colmap_ext/rigs/rig_io.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

struct ConverterOptions {
  std::string input_path;
  std::string output_path;
  std::string output_type;
  std::string extrinsics_format = "auto";
  double extrinsics_pixel_offset = std::numeric_limits<double>::quiet_NaN();
  std::string image_path;
  std::string camera_name_regex;
  std::string frame_name_regex;
};

ConverterOptions ParseConverterOptions(int argc, char** argv) {
  ConverterOptions options;
  OptionParser parser;
  parser.SetHelp(
      "Writes the known extrinsics of a camera array in another format.",
      "colmap multi_frame_rig_converter --input_path RIG "
      "--output_path RIG2 --output_type TYPE");
  parser.AddRequired("input_path", &options.input_path, "The rig");
  parser.AddRequired("output_path",
                     &options.output_path,
                     "The file, or for colmap and opencv the folder, to write");
  parser.AddRequired("output_type", &options.output_type, RigFormatNames());
  parser.Add("extrinsics_format",
             &options.extrinsics_format,
             "Format of the rig: auto, " + RigFormatNames());
  parser.Add("extrinsics_pixel_offset",
             &options.extrinsics_pixel_offset,
             "Added to its principal points; nan: that of the format");
  parser.Add("image_path",
             &options.image_path,
             "Images, for the sizes that the rig has not");
  parser.Add("MultiFrame.camera_name_regex",
             &options.camera_name_regex,
             "One capture group: the camera name within an image name");
  parser.Add("MultiFrame.frame_name_regex",
             &options.frame_name_regex,
             "One capture group: the frame within the path of an image");
  parser.AddSharedSection("MultiFrame");
  parser.Parse(argc, argv);
  FindRigFormat("--output_type", options.output_type);
  CheckRigFormat("--extrinsics_format", options.extrinsics_format);
  CheckPixelOffset("--extrinsics_pixel_offset",
                   options.extrinsics_pixel_offset);
  return options;
}

// What is there may be replaced if it is a rig of the same format.
void CheckConverterOutput(const ConverterOptions& options,
                          const RigFormat& format) {
  std::error_code error;
  if (!fs::exists(options.output_path, error)) return;
  if (fs::equivalent(options.input_path, options.output_path, error)) {
    throw UsageError("--output_path " + options.output_path +
                     " is the input, which is not replaced. Give another.");
  }
  if (fs::is_directory(options.output_path, error) &&
      fs::is_empty(options.output_path, error)) {
    return;
  }
  try {
    RigRemarks ignored;
    format.read(options.output_path, 0.0, &ignored);
  } catch (const InputError&) {
    throw OutputError("--output_path " + options.output_path +
                      " exists, and is no rig of the format " + format.name +
                      ": it is not replaced. Remove it, or give another path.");
  }
}

// Sets image sizes that the rig has not.
void FindImageSizes(const ConverterOptions& options, Rig* rig) {
  if (options.image_path.empty()) return;
  std::vector<std::string> names;
  for (const KnownCamera& camera : rig->cameras) names.push_back(camera.name);
  const CaptureImages images =
      FindCaptureImages(options.image_path,
                        "",
                        names,
                        CameraNaming(options.camera_name_regex),
                        options.frame_name_regex);
  for (const CaptureFrame& frame : images.frames) {
    for (const CaptureImage& image : frame.images) {
      const auto camera = std::find_if(
          rig->cameras.begin(),
          rig->cameras.end(),
          [&](const KnownCamera& known) { return known.name == image.camera; });
      host::Bitmap bitmap;
      if (camera == rig->cameras.end() || camera->width > 0 ||
          !bitmap.Read(image.path, /*as_rgb=*/false)) {
        continue;
      }
      camera->width = static_cast<size_t>(bitmap.Width());
      camera->height = static_cast<size_t>(bitmap.Height());
    }
  }
}

void Convert(const ConverterOptions& options) {
  Rig rig = ReadRig(options.input_path,
                    options.extrinsics_format,
                    CameraNaming(options.camera_name_regex),
                    options.extrinsics_pixel_offset);
  const RigFormat& format = FindRigFormat("--output_type", options.output_type);
  CheckConverterOutput(options, format);
  FindImageSizes(options, &rig);
  for (const std::string& remark : rig.remarks) {
    std::cout << remark << std::endl;
  }
  for (const std::string& remark :
       WriteRig(options.output_path, format, rig.cameras)) {
    std::cout << remark << std::endl;
  }
  std::cout << rig.cameras.size() << " cameras, " << rig.format << " to "
            << format.name << ", written to " << options.output_path
            << std::endl;
}

}  // namespace

int RunMultiFrameRigConverter(int argc, char** argv) {
  return RunCommand(
      [argc, argv]() { Convert(ParseConverterOptions(argc, argv)); });
}

}  // namespace mfir

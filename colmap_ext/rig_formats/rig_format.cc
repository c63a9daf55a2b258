#include "colmap_ext/rig_formats/rig_format.h"

#include <algorithm>
#include <filesystem>
#include <sstream>
#include <system_error>

#include "colmap_ext/io/input_file.h"
#include "colmap_ext/io/json_file.h"
#include "colmap_ext/models/model_io.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

std::string DetectJson(const std::string& path, const std::string& text) {
  const nlohmann::json json = ParseJson(path, text);
  if (json.is_array()) return "rig_config";
  if (json.contains("frames")) return "transforms";
  if (json.contains("camera_poses")) return "multical";
  const auto cameras = json.find("cameras");
  if (cameras == json.end()) return "";
  if (cameras->is_object()) return "multical";
  const bool has_prefixes = cameras->is_array() && !cameras->empty() &&
                            cameras->front().is_object() &&
                            cameras->front().contains("image_prefix");
  return has_prefixes ? "rig_config" : "panoptic";
}

bool HasLineThatBegins(const std::string& text, const std::string& begin) {
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);) {
    if (line.compare(0, begin.size(), begin) == 0) return true;
  }
  return false;
}

std::string DetectFile(const std::string& path) {
  const std::string text = ReadTextFile(path);
  if (text.compare(0, 2, "PK") == 0) return "npz";  // a zip archive
  const size_t begin = text.find_first_not_of(" \t\r\n");
  if (begin == std::string::npos)
    return "krt";  // whose reader says it is empty
  if (text[begin] == '{' || text[begin] == '[') return DetectJson(path, text);
  if (text[begin] == '<') return "metashape";
  if (HasLineThatBegins(text, "cam0:")) return "kalibr";
  if (IsOpenCVRig(path)) return "opencv";
  const std::string first_line =
      text.substr(begin, text.find_first_of("\r\n", begin) - begin);
  return first_line.find(',') == std::string::npos ? "krt" : "csv";
}

}  // namespace

const std::vector<RigFormat>& RigFormats() {
  static const std::vector<RigFormat> formats = {
      {"colmap",
       "a folder with a COLMAP model (cameras and images, both .bin or both "
       ".txt)",
       "rig",
       0.0,
       true,
       ReadColmapRig,
       WriteColmapRig},
      {"rig_config",
       "a rig_config.json of COLMAP 4",
       "rig_config.json",
       0.0,
       false,
       ReadRigConfig,
       WriteRigConfig},
      {"krt", "a KRT file", "KRT", 0.0, false, ReadKRTRig, WriteKRTRig},
      {"opencv",
       "a folder with extri.yml and intri.yml (OpenCV, EasyMocap)",
       "opencv",
       0.5,
       false,
       ReadOpenCVRig,
       WriteOpenCVRig},
      {"transforms",
       "a transforms.json (nerfstudio, instant-ngp)",
       "transforms.json",
       0.0,
       true,
       ReadTransformsRig,
       WriteTransformsRig},
      {"metashape",
       "an XML file of Metashape",
       "metashape.xml",
       0.0,
       true,
       ReadMetashapeRig,
       WriteMetashapeRig},
      {"panoptic",
       "a JSON calibration of the CMU Panoptic Studio",
       "panoptic.json",
       0.5,
       false,
       ReadPanopticRig,
       WritePanopticRig},
      {"csv",
       "a calibration.csv (ActorsHQ)",
       "calibration.csv",
       0.0,
       false,
       ReadCsvRig,
       WriteCsvRig},
      {"kalibr",
       "a camchain.yaml of Kalibr",
       "camchain.yaml",
       0.5,
       false,
       ReadKalibrRig,
       WriteKalibrRig},
      {"multical",
       "a calibration.json of multical",
       "multical.json",
       0.5,
       false,
       ReadMulticalRig,
       WriteMulticalRig},
      {"npz",
       "a .npz of NumPy with intrinsics and poses (DUSt3R, MASt3R)",
       "cameras.npz",
       0.5,
       true,
       ReadNpzRig,
       WriteNpzRig}};
  return formats;
}

std::string RigFormatNames() {
  std::string names;
  for (const RigFormat& format : RigFormats()) {
    names += names.empty()                     ? ""
             : &format == &RigFormats().back() ? " or "
                                               : ", ";
    names += format.name;
  }
  return names;
}

const RigFormat& FindRigFormat(const std::string& option,
                               const std::string& name) {
  const auto format = std::find_if(
      RigFormats().begin(), RigFormats().end(), [&](const RigFormat& known) {
        return known.name == name;
      });
  if (format == RigFormats().end()) {
    throw UsageError(option + " '" + name + "' is unknown: use " +
                     RigFormatNames() + ".");
  }
  return *format;
}

void CheckRigFormat(const std::string& option, const std::string& name) {
  if (!name.empty() && name != "auto") FindRigFormat(option, name);
}

const RigFormat& DetectRigFormat(const std::string& path) {
  std::error_code error;
  std::string name;
  if (IsModelFolder(path)) {
    name = "colmap";
  } else if (fs::is_directory(path, error)) {
    name = IsOpenCVRig(path) ? "opencv" : "";
  } else if (fs::is_regular_file(path, error)) {
    name = DetectFile(path);
  }
  if (!name.empty()) return FindRigFormat("extrinsics_format", name);
  std::string known;
  for (const RigFormat& format : RigFormats()) {
    known += (known.empty() ? "" : "; ") + format.what;
  }
  throw InputError(path +
                   (fs::exists(path, error)
                        ? ": not a known rig format"
                        : ": there is no such file or folder") +
                   ". A rig is " + known + ".");
}

}  // namespace mfir

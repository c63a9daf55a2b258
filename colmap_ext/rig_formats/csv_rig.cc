#include <map>

#include <Eigen/Geometry>

#include "colmap_ext/io/input_file.h"
#include "colmap_ext/io/text_file.h"
#include "colmap_ext/rig_formats/camera_fields.h"
#include "colmap_ext/rig_formats/formats.h"

namespace mfir {
namespace {

// Columns: image size in pixels, rotation vector and translation of
// x_world = R x_camera + t, focal lengths and principal point divided by the
// width and height.
const std::vector<std::string>& Columns() {
  static const std::vector<std::string> columns = {"name",
                                                   "w",
                                                   "h",
                                                   "rx",
                                                   "ry",
                                                   "rz",
                                                   "tx",
                                                   "ty",
                                                   "tz",
                                                   "fx",
                                                   "fy",
                                                   "px",
                                                   "py"};
  return columns;
}

std::vector<std::string> SplitLine(std::string_view line) {
  std::vector<std::string> fields;
  const std::string_view blanks = " \t";
  for (size_t begin = 0; begin <= line.size();) {
    const size_t end = std::min(line.find(',', begin), line.size());
    std::string_view field = line.substr(begin, end - begin);
    field.remove_prefix(
        std::min(field.find_first_not_of(blanks), field.size()));
    field = field.substr(0, field.find_last_not_of(blanks) + 1);
    if (field.size() >= 2 && field.front() == '"' && field.back() == '"') {
      field = field.substr(1, field.size() - 2);
    }
    fields.emplace_back(field);
    begin = end + 1;
  }
  return fields;
}

class CsvFile {
 public:
  explicit CsvFile(const std::string& path)
      : file_(path, ReadTextFile(path), TextFile::Spacing::kAny) {}

  // Reads the first line. Returns columns that have no meaning here.
  std::vector<std::string> ReadHeader() {
    if (!file_.NextContentLine()) file_.Fail("the file is empty");
    std::vector<std::string> unknown;
    names_ = SplitLine(file_.Line());
    for (const std::string& name : names_) {
      if (std::find(Columns().begin(), Columns().end(), name) ==
          Columns().end()) {
        unknown.push_back(name);
      }
    }
    for (const std::string& column : Columns()) {
      if (std::find(names_.begin(), names_.end(), column) == names_.end()) {
        file_.Fail("the column " + column + " is missing");
      }
    }
    return unknown;
  }

  bool NextRow() {
    if (!file_.NextContentLine()) return false;
    const std::vector<std::string> fields = SplitLine(file_.Line());
    if (fields.size() != names_.size()) {
      file_.Fail("there are " + std::to_string(fields.size()) +
                 " fields, but " + std::to_string(names_.size()) + " columns");
    }
    for (size_t i = 0; i < fields.size(); ++i) row_[names_[i]] = fields[i];
    return true;
  }

  const std::string& Text(const std::string& column) {
    const std::string& text = row_[column];
    if (text.empty()) file_.Fail(column + " is empty");
    return text;
  }

  double Number(const std::string& column) {
    double value;
    if (!ParseNumber(Text(column), &value) || !std::isfinite(value)) {
      file_.Fail(column + " '" + row_[column] + "' is not a finite number");
    }
    return value;
  }

  size_t ImageSize(const std::string& column) {
    const double size = Number(column);
    if (!(size >= 1.0 && size <= 1e6) || size != std::floor(size)) {
      file_.Fail(column + " is not an image size in pixels");
    }
    return static_cast<size_t>(size);
  }

  std::string Where(const std::string& path) const {
    return path + ":" + std::to_string(file_.LineNumber());
  }

 private:
  TextFile file_;
  std::vector<std::string> names_;
  std::map<std::string, std::string> row_;
};

}  // namespace

Cameras ReadCsvRig(const std::string& path,
                   double pixel_offset,
                   RigRemarks* remarks) {
  CsvFile file(path);
  for (const std::string& name : file.ReadHeader()) {
    remarks->push_back(path + ": the column " + name + " is not used");
  }
  Cameras cameras;
  while (file.NextRow()) {
    KnownCamera camera;
    camera.image_name = file.Text("name");
    const std::string where =
        file.Where(path) + ": camera " + camera.image_name;
    const Eigen::Vector3d rotation(
        file.Number("rx"), file.Number("ry"), file.Number("rz"));
    const Eigen::Vector3d center(
        file.Number("tx"), file.Number("ty"), file.Number("tz"));
    Eigen::Matrix<double, 3, 4> world_from_cam;
    world_from_cam << Eigen::AngleAxisd(rotation.norm(),
                                        rotation.stableNormalized())
                          .toRotationMatrix(),
        center;
    SetPoseFromWorldFromCam(world_from_cam, where, &camera);
    camera.width = file.ImageSize("w");
    camera.height = file.ImageSize("h");
    const auto width = static_cast<double>(camera.width);
    const auto height = static_cast<double>(camera.height);
    SetLens({Lens::Kind::kBrown,
             width * file.Number("fx"),
             height * file.Number("fy"),
             width * file.Number("px") + pixel_offset,
             height * file.Number("py") + pixel_offset,
             {}},
            where,
            &camera);
    cameras.push_back(std::move(camera));
  }
  return cameras;
}

void WriteCsvRig(const std::string& path,
                 const Cameras& cameras,
                 double pixel_offset,
                 RigRemarks* remarks) {
  LensFitter fitter("csv", 0, /*has_fisheye=*/false);
  std::string text;
  for (const std::string& column : Columns()) {
    text += (text.empty() ? "" : ",") + column;
  }
  text += "\n";
  for (const KnownCamera& camera : cameras) {
    RequireIntrinsics("csv", camera);
    RequireImageSize("csv", camera);
    const Lens lens = fitter.Fit(camera);
    const Eigen::AngleAxisd angle_axis(
        camera.cam_from_world.rotation.normalized().conjugate());
    const Eigen::Vector3d rotation = angle_axis.angle() * angle_axis.axis();
    const Eigen::Vector3d center = camera.cam_from_world.Center();
    const auto width = static_cast<double>(camera.width);
    const auto height = static_cast<double>(camera.height);
    text += WrittenName(camera) + "," + std::to_string(camera.width) + "," +
            std::to_string(camera.height);
    for (const double value : {rotation.x(),
                               rotation.y(),
                               rotation.z(),
                               center.x(),
                               center.y(),
                               center.z(),
                               lens.fx / width,
                               lens.fy / height,
                               (lens.cx - pixel_offset) / width,
                               (lens.cy - pixel_offset) / height}) {
      text += "," + ExactNumber(value);
    }
    text += "\n";
  }
  fitter.AddRemarks(remarks);
  WriteRigFile(path, text);
}

}  // namespace mfir

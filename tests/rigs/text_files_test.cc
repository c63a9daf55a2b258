// Every reader of text takes what editors add and nobody sees: a byte order
// mark, Windows line ends, blanks at the ends of lines.

#include <functional>
#include <limits>
#include <sstream>

#include "colmap_ext/io/input_file.h"
#include "colmap_ext/models/model_io.h"
#include "colmap_ext/options/option_parser.h"
#include "colmap_ext/rigs/rig_io.h"
#include "tests/support/rig_examples.h"
#include "tests/support/test_files.h"

namespace mfir {
namespace {

std::string WithByteOrderMark(const std::string& text) {
  return "\xef\xbb\xbf" + text;
}

std::string WithWindowsLineEnds(const std::string& text) {
  std::string result;
  for (const char c : text) {
    result += c == '\n' ? "\r\n" : std::string(1, c);
  }
  return result;
}

std::string WithTrailingBlanks(const std::string& text) {
  std::string result;
  for (const char c : text) {
    result += c == '\n' ? " \t \n" : std::string(1, c);
  }
  return result;
}

struct Variant {
  std::string name;
  std::function<std::string(const std::string&)> change;
};

const std::vector<Variant>& Variants() {
  static const std::vector<Variant> variants = {
      {"byte_order_mark", WithByteOrderMark},
      {"windows_line_ends", WithWindowsLineEnds},
      {"trailing_blanks", WithTrailingBlanks},
      {"all_three", WithInvisibles}};
  return variants;
}

struct Reader {
  std::string name;
  RigExample files;
  // What it reads, as text to compare.
  std::function<std::string(const std::string& path)> read;
};

std::string DescribeRig(const std::string& path) {
  const Rig rig = ReadRig(
      path, "auto", CameraNaming(), std::numeric_limits<double>::quiet_NaN());
  std::ostringstream text;
  text.precision(17);
  text << rig.format;
  for (const KnownCamera& camera : rig.cameras) {
    text << "\n"
         << camera.name << " " << camera.model->Name() << " " << camera.width
         << " " << camera.height << " "
         << camera.cam_from_world.rotation.coeffs().transpose() << " "
         << camera.cam_from_world.translation.transpose();
    for (const double param : camera.params) text << " " << param;
  }
  return text.str();
}

std::string DescribeModel(const std::string& path) {
  host::Reconstruction model;
  ReadModel(path, /*require_points=*/true, &model);
  std::ostringstream text;
  text.precision(17);
  for (const auto& [image_id, image] : model.Images()) {
    text << image.Name() << "|";
    for (const auto& point : image.Points2D()) {
      text << host::Xy(point).transpose() << " ";
    }
  }
  for (const host::point3D_t id : model.Point3DIds()) {
    text << host::Xyz(model.Point3D(id)).transpose();
  }
  return text.str();
}

std::string DescribeList(const std::string& path) {
  std::string text;
  for (const ListEntry& entry : ReadNameList("--frame_list_path", path)) {
    text += entry.name + "|";
  }
  return text;
}

std::string DescribeIni(const std::string& path) {
  std::string input_path;
  double weight = 0.0;
  OptionParser parser;
  parser.Add("input_path", &input_path, "");
  parser.Add("MultiFrame.reprojection_weight", &weight, "");
  std::vector<std::string> arguments = {"command", "--project_path", path};
  std::vector<char*> argv;
  for (std::string& argument : arguments) argv.push_back(argument.data());
  parser.Parse(static_cast<int>(argv.size()), argv.data());
  return input_path + "|" + std::to_string(weight);
}

std::vector<Reader> Readers() {
  std::vector<Reader> readers;
  for (const RigExample& example : RigExamples()) {
    if (example.format == "npz") continue;  // binary
    readers.push_back({"rig_" + example.format, example, DescribeRig});
  }
  RigExample model = RigExamples().front();
  model.files[1].second =
      "1 0.5 0.5 -0.5 0.5 2 3 -1 1 a.png\n422.0 60.05 1\n"
      "2 1 0 0 0 0 0 0 2 b.png\n1420 340 1\n";
  model.files.emplace_back("points3D.txt",
                           "# points\n1 11 1 5 0 0 0 0.5 1 0 2 0\n");
  readers.push_back({"model", model, DescribeModel});
  RigExample list;
  list.path = "list.txt";
  list.files = {{"list.txt", "# frames\nframe 1\n\nframe2\n"}};
  readers.push_back({"name_list", list, DescribeList});
  RigExample ini;
  ini.path = "project.ini";
  ini.files = {{"project.ini",
                "# options\ninput_path=a b\n[MultiFrame]\n"
                "reprojection_weight=2.5\n"}};
  readers.push_back({"ini", ini, DescribeIni});
  return readers;
}

class TextFilesTest
    : public testing::TestWithParam<std::tuple<Reader, Variant>> {};

TEST_P(TextFilesTest, ReadAsTheyAreMeant) {
  const auto& [reader, variant] = GetParam();
  const TemporaryFolder plain, changed;
  const std::string expected = reader.read(reader.files.Write(plain.Path()));
  EXPECT_FALSE(expected.empty());
  RigExample files = reader.files;
  for (auto& [name, content] : files.files) content = variant.change(content);
  EXPECT_EQ(reader.read(files.Write(changed.Path())), expected);
}

INSTANTIATE_TEST_SUITE_P(Readers,
                         TextFilesTest,
                         testing::Combine(testing::ValuesIn(Readers()),
                                          testing::ValuesIn(Variants())),
                         [](const auto& info) {
                           return std::get<0>(info.param).name + "_" +
                                  std::get<1>(info.param).name;
                         });

}  // namespace
}  // namespace mfir

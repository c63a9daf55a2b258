#include "colmap_ext/models/model_io.h"

#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <filesystem>
#include <fstream>
#include <new>
#include <optional>
#include <system_error>
#include <utility>
#include <vector>

#include "colmap_ext/host/reconstruction.h"
#include "colmap_ext/host/rig_model.h"
#include "colmap_ext/io/input_file.h"
#include "colmap_ext/models/camera_models.h"
#include "colmap_ext/models/model_check.h"
#include "colmap_ext/models/model_frames.h"
#include "src/sensor/camera_naming.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

bool IsFile(const fs::path& path) {
  std::error_code error;
  return fs::is_regular_file(path, error);
}

bool IsFolder(const fs::path& path) {
  std::error_code error;
  return fs::is_directory(path, error);
}

// The files in `path`, binary before text. If `require_points`, points3D must
// be among them.
std::optional<ModelFiles> FindModelFiles(const fs::path& path,
                                         bool require_points) {
  for (const bool is_binary : {true, false}) {
    const std::string extension = is_binary ? ".bin" : ".txt";
    const fs::path cameras = path / ("cameras" + extension);
    const fs::path images = path / ("images" + extension);
    const fs::path points3D = path / ("points3D" + extension);
    const bool has_points = IsFile(points3D);
    if (IsFile(cameras) && IsFile(images) && (has_points || !require_points)) {
      return ModelFiles{is_binary,
                        cameras.string(),
                        images.string(),
                        has_points ? points3D.string() : ""};
    }
  }
  return std::nullopt;
}

ModelFiles LocateModelFiles(const std::string& path, bool require_points) {
  // As COLMAP, text with points before binary without.
  std::optional<ModelFiles> files = FindModelFiles(path, true);
  if (!files && !require_points) {
    files = FindModelFiles(path, false);
  }
  if (!files) {
    if (!IsFolder(path)) {
      throw InputError(path +
                       ": there is no such folder. Give the folder of a "
                       "COLMAP model.");
    }
    throw InputError(path +
                     ": no COLMAP model in this folder. It must have "
                     "cameras and images" +
                     (require_points ? " and points3D" : "") +
                     ", all as .bin or all as .txt files.");
  }
  return *files;
}

size_t CheckModelFiles(const ModelFiles& files, const ModelFiles& copies) {
  return files.is_binary ? CheckBinaryModel(files, copies)
                         : CheckTextModel(files, copies);
}

// Whether COLMAP's reader can take the files as they are. It reads nothing
// without points3D, and takes a byte order mark for a part of the first line.
bool IsReadable(const ModelFiles& files) {
  if (files.points3D.empty()) return false;
  return files.is_binary ||
         (!HasByteOrderMark(files.cameras) && !HasByteOrderMark(files.images) &&
          !HasByteOrderMark(files.points3D));
}

// The files as they are now: what is checked is what COLMAP reads, also if they
// change meanwhile, in a form that it can read. They are held in memory, behind
// links in a private folder that goes with the object.
class ModelSnapshot {
 public:
  explicit ModelSnapshot(const ModelFiles& files)
      : path_(fs::path(files.cameras).parent_path()), files_(files) {
    try {
      MakeFolder();
      files_.cameras = Add("cameras", files.cameras);
      files_.images = Add("images", files.images);
      files_.points3D = Add("points3D", files.points3D);
    } catch (const std::system_error& error) {
      Remove();
      path_ = fs::path(files.cameras).parent_path();
      files_ = files;
      if (IsReadable(files)) return;
      throw OutputError(std::string("cannot make a temporary folder: ") +
                        error.what() +
                        ". Set TMPDIR to a folder that is writable.");
    } catch (...) {
      Remove();
      throw;
    }
  }
  ~ModelSnapshot() { Remove(); }
  ModelSnapshot(const ModelSnapshot&) = delete;
  ModelSnapshot& operator=(const ModelSnapshot&) = delete;

  std::string Path() const { return path_.string(); }
  const ModelFiles& Files() const { return files_; }

 private:
  void MakeFolder() {
    std::string path =
        (fs::temp_directory_path() / "colmap_model_XXXXXX").string();
    if (mkdtemp(path.data()) == nullptr) {
      throw std::system_error(errno, std::generic_category(), path);
    }
    path_ = path;
    is_temporary_ = true;
  }

  // A file of this name with the content of `source`; "": an empty one.
  std::string Add(const std::string& name, const std::string& source) {
    const int memory = memfd_create(name.c_str(), MFD_CLOEXEC);
    if (memory < 0) {
      throw std::system_error(errno, std::generic_category(), name);
    }
    memories_.push_back(memory);
    const fs::path held = "/proc/self/fd/" + std::to_string(memory);
    Write(held, Content(source));
    const fs::path link = path_ / (name + (files_.is_binary ? ".bin" : ".txt"));
    fs::create_symlink(held, link);
    return link.string();
  }

  // COLMAP does not know byte order marks.
  std::string Content(const std::string& source) const {
    if (source.empty()) {
      return std::string(files_.is_binary ? sizeof(uint64_t) : 0, '\0');
    }
    return files_.is_binary ? ReadInputFile(source) : ReadTextFile(source);
  }

  static void Write(const fs::path& path, const std::string& content) {
    std::ofstream file(path, std::ios::binary);
    file << content;
    file.close();
    if (!file) {
      throw std::system_error(errno, std::generic_category(), path.string());
    }
  }

  void Remove() {
    for (const int memory : memories_) close(memory);
    memories_.clear();
    if (is_temporary_) {
      std::error_code error;
      fs::remove_all(path_, error);
    }
    is_temporary_ = false;
  }

  fs::path path_;
  ModelFiles files_;
  bool is_temporary_ = false;
  std::vector<int> memories_;
};

void ReadWithColmap(const std::string& path,
                    const ModelSnapshot& snapshot,
                    host::Reconstruction* reconstruction) {
  try {
    host::ReadReconstruction(
        snapshot.Path(), snapshot.Files().is_binary, reconstruction);
  } catch (const std::bad_alloc&) {
    throw;
  } catch (const std::exception& error) {
    throw InputError(path + ": COLMAP cannot read this model (" + error.what() +
                     "). Export it again.");
  }
}

// A model without points may have observations of the points that it had.
void ForgetPoints(host::Reconstruction* reconstruction) {
  for (const auto& id_and_image : reconstruction->Images()) {
    host::Image& image = reconstruction->Image(id_and_image.first);
    for (host::point2D_t i = 0; i < image.NumPoints2D(); ++i) {
      image.ResetPoint3DForPoint2D(i);
    }
  }
}

// Makes the folder and the files, empty, that COLMAP's writer then finds there:
// where it cannot make one it ends the program.
void MakeModelFiles(const fs::path& folder, const std::string& extension) {
  std::error_code error;
  fs::create_directories(folder, error);
  if (error) {
    throw OutputError(folder.string() +
                      ": cannot make the folder: " + error.message() + ".");
  }
  std::vector<std::string> names = {"cameras", "images", "points3D"};
  if (host::kHasRigs) names.insert(names.end(), {"rigs", "frames"});
  for (const std::string& name : names) {
    if (!std::ofstream(folder / (name + extension))) {
      throw OutputError((folder / (name + extension)).string() +
                        ": cannot write the file. Is the disk full?");
    }
  }
}

// Whole lines that are no comments; images without observations have empty
// ones. More than there can be if the file is cut, or lacks COLMAP's comments.
size_t CountLines(const fs::path& path) {
  const std::string text = ReadInputFile(path.string());
  size_t count = 0;
  size_t begin = 0;
  for (size_t end; (end = text.find('\n', begin)) != std::string::npos;) {
    if (text[begin] != '#') ++count;
    begin = end + 1;
  }
  return begin == text.size() && begin > 0 ? count : SIZE_MAX;
}

// Sub-folders of `path` whose names are numbers, in the order of the numbers.
std::vector<fs::path> NumberedFolders(const fs::path& path) {
  std::vector<std::string> names;
  std::error_code error;
  for (fs::directory_iterator it(path, error), end; !error && it != end;
       it.increment(error)) {
    const std::string name = it->path().filename().string();
    if (name.find_first_not_of("0123456789") == std::string::npos &&
        IsFolder(it->path())) {
      names.push_back(name);
    }
  }
  std::sort(names.begin(), names.end(), CameraNameLess);
  std::vector<fs::path> folders;
  for (const std::string& name : names) {
    folders.push_back(path / name);
  }
  return folders;
}

}  // namespace

bool IsModelFolder(const std::string& path) {
  return FindModelFiles(path, /*require_points=*/false).has_value();
}

bool IsBinaryModel(const std::string& path) {
  return LocateModelFiles(path, /*require_points=*/false).is_binary;
}

std::string FindSparseModel(const std::string& frame_path) {
  const fs::path frame = frame_path;
  std::vector<fs::path> folders = {frame,
                                   frame / "sparse" / "0",
                                   frame / "0",
                                   frame / "sparse",
                                   frame / "refined"};
  for (const fs::path& parent : {frame / "sparse", frame}) {
    for (const fs::path& folder : NumberedFolders(parent)) {
      if (folder.filename() != "0") {
        folders.push_back(folder);
      }
    }
  }
  folders.erase(std::remove_if(folders.begin(),
                               folders.end(),
                               [](const fs::path& folder) {
                                 return !IsModelFolder(folder.string());
                               }),
                folders.end());
  if (folders.size() <= 1) {
    return folders.empty() ? "" : folders[0].string();
  }

  std::string best_folder;
  size_t max_num_images = 0;
  for (const fs::path& folder : folders) {
    ModelFiles files =
        LocateModelFiles(folder.string(), /*require_points=*/false);
    files.points3D.clear();  // only images count here
    const size_t num_images = CheckModelFiles(files, files);
    if (best_folder.empty() || num_images > max_num_images) {
      best_folder = folder.string();
      max_num_images = num_images;
    }
  }
  return best_folder;
}

void ReadModel(const std::string& path,
               bool require_points,
               host::Reconstruction* reconstruction) {
  const ModelFiles files = LocateModelFiles(path, require_points);
  host::Reconstruction model;
  {
    const ModelSnapshot snapshot(files);
    CheckModelFiles(files, snapshot.Files());
    ReadWithColmap(path, snapshot, &model);
  }
  if (!require_points && model.NumPoints3D() == 0) {
    ForgetPoints(&model);
  }
  CheckModelValues(files, model);
  *reconstruction = std::move(model);
}

host::Camera MakeHostCamera(host::camera_t camera_id, const RigCamera& camera) {
  return host::MakeCamera(camera_id,
                          CameraModelId(*camera.model),
                          camera.width,
                          camera.height,
                          camera.params);
}

void AddPosedImage(host::image_t image_id,
                   const std::string& image_name,
                   host::camera_t camera_id,
                   const RigCamera& camera,
                   host::Reconstruction* reconstruction) {
  host::AddCameraWithTrivialRig(MakeHostCamera(camera_id, camera),
                                reconstruction);
  host::Image image;
  image.SetImageId(image_id);
  image.SetCameraId(camera_id);
  image.SetName(image_name);
  host::AddImageWithTrivialFrame(image, camera.cam_from_world, reconstruction);
}

void WriteModel(const std::string& path,
                bool with_text,
                const host::Reconstruction& reconstruction) {
  const fs::path folder = path;
  MakeModelFiles(folder, ".bin");
  reconstruction.WriteBinary(path);
  const ModelFiles files = {true,
                            (folder / "cameras.bin").string(),
                            (folder / "images.bin").string(),
                            (folder / "points3D.bin").string()};
  try {
    CheckBinaryModel(files, files);
    if (host::kHasRigs) ReadModelFrames(path, reconstruction);
  } catch (const InputError& error) {
    throw OutputError("The model just written to " + path +
                      " is not complete: " + error.what() +
                      " Is the disk full?");
  }
  if (with_text) WriteTextModel(path, reconstruction);
}

void WriteTextModel(const std::string& path,
                    const host::Reconstruction& reconstruction) {
  const fs::path folder = path;
  MakeModelFiles(folder, ".txt");
  reconstruction.WriteText(path);
  if (CountLines(folder / "cameras.txt") != reconstruction.NumCameras() ||
      CountLines(folder / "images.txt") != 2 * reconstruction.NumRegImages() ||
      CountLines(folder / "points3D.txt") != reconstruction.NumPoints3D()) {
    throw OutputError("The model just written to " + path +
                      " is not complete. Is the disk full?");
  }
}

}  // namespace mfir

// COLMAP models on disk: finding them, reading them with COLMAP's reader such
// that bad files end in a message instead of an abort, and writing them such
// that a full disk is noticed.

#pragma once

#include <string>

#include "colmap_ext/host/reconstruction.h"
#include "src/scene/scene.h"

namespace mfir {

// Whether `path` holds cameras, images (both .bin or both .txt).
bool IsModelFolder(const std::string& path);

// Whether ReadModel reads the binary files of the model in `path`.
bool IsBinaryModel(const std::string& path);

// The folder of a frame's sparse model: among FRAME/, FRAME/sparse/0, FRAME/0,
// FRAME/sparse, FRAME/refined, and the numbered siblings FRAME/sparse/N and
// FRAME/N, the one with most registered images (the first of the list on a
// tie). "" when there is none. Throws InputError for an unreadable candidate.
std::string FindSparseModel(const std::string& frame_path);

// Reads the model in folder `path` (binary before text, as COLMAP does) into
// `reconstruction`, which is replaced, and unchanged if this throws.
// `require_points`: points3D must exist too. Otherwise it may be missing or
// empty; observations are then of no point.
//
// Files that change meanwhile are read as they were at one instant each. Text
// files may begin with a byte order mark. COLMAP's reader gets a copy (links in
// a folder of TMPDIR to memory); where that cannot be made it reads the files
// themselves, or, since it can neither do without points3D nor take a byte
// order mark, OutputError is thrown. Throws
// InputError, naming the file, what is wrong where and what to do, for
// everything that COLMAP's reader would crash, hang or stay silent on: missing
// or truncated files, counts beyond the file size, trailing bytes, unknown
// camera models, wrong number of parameters, malformed numbers (line),
// non-finite values, zero quaternion, focal length <= 0, image size 0,
// duplicate ids or image names, images of an unknown camera, observations of
// unknown points, tracks that name unknown images, keypoints out of range, or
// keypoints that do not point back to the track's point.
void ReadModel(const std::string& path,
               bool require_points,
               host::Reconstruction* reconstruction);

// The intrinsics of `camera`.
host::Camera MakeHostCamera(host::camera_t camera_id, const RigCamera& camera);

// Adds an image with the pose and intrinsics of `camera`, and its camera.
void AddPosedImage(host::image_t image_id,
                   const std::string& image_name,
                   host::camera_t camera_id,
                   const RigCamera& camera,
                   host::Reconstruction* reconstruction);

// Writes a binary model, and with `with_text` a text model too, to the folder
// `path`, which is made. COLMAP 3.8 does not check its writes, so the files are
// checked afterwards. Throws OutputError if the folder cannot be made or the
// files are not complete.
void WriteModel(const std::string& path,
                bool with_text,
                const host::Reconstruction& reconstruction);

// The same for a text model alone.
void WriteTextModel(const std::string& path,
                    const host::Reconstruction& reconstruction);

}  // namespace mfir

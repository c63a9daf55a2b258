// Readers and writers of the single formats. docs/rig_formats.md has their
// conventions, with sources.
//
// Readers return cameras with image_name as the file has it; name is left
// empty. `pixel_offset` is added to principal points to get COLMAP's. They
// throw InputError that names file and line or field. Writers subtract it,
// throw OutputError, and InputError for what the format needs and a camera has
// not. Both add lines to `remarks` for what gets lost.

#pragma once

#include <string>
#include <vector>

#include "colmap_ext/rig_formats/known_camera.h"

namespace mfir {

using Cameras = std::vector<KnownCamera>;

// Folder of a COLMAP model; one camera per image.
Cameras ReadColmapRig(const std::string& path,
                      double pixel_offset,
                      RigRemarks* remarks);
void WriteColmapRig(const std::string& path,
                    const Cameras& cameras,
                    double pixel_offset,
                    RigRemarks* remarks);

// COLMAP 4's rig_config.json, of one rig: its coordinates are the world.
Cameras ReadRigConfig(const std::string& path,
                      double pixel_offset,
                      RigRemarks* remarks);
void WriteRigConfig(const std::string& path,
                    const Cameras& cameras,
                    double pixel_offset,
                    RigRemarks* remarks);

// Multiface: per camera the lines name, K (3), distortion (k1 k2 p1 p2 k3),
// [R | t] (3).
Cameras ReadKRTRig(const std::string& path,
                   double pixel_offset,
                   RigRemarks* remarks);
void WriteKRTRig(const std::string& path,
                 const Cameras& cameras,
                 double pixel_offset,
                 RigRemarks* remarks);
// The same; returns the names of the cameras whose distortion KRT cannot hold
// (fisheye, FOV, thin prism, FULL_OPENCV with k4..k6): they have zeros there.
std::vector<std::string> WriteKRT(const std::string& path,
                                  const Cameras& cameras,
                                  double pixel_offset = 0.0);

// `path`: folder with extri.yml and, if intrinsics are known, intri.yml; or one
// of the two; or another .yml file that holds both. Written is the folder.
Cameras ReadOpenCVRig(const std::string& path,
                      double pixel_offset,
                      RigRemarks* remarks);
void WriteOpenCVRig(const std::string& path,
                    const Cameras& cameras,
                    double pixel_offset,
                    RigRemarks* remarks);

// transforms.json of nerfstudio and instant-ngp.
Cameras ReadTransformsRig(const std::string& path,
                          double pixel_offset,
                          RigRemarks* remarks);
void WriteTransformsRig(const std::string& path,
                        const Cameras& cameras,
                        double pixel_offset,
                        RigRemarks* remarks);

// XML that Metashape exports as "Agisoft XML".
Cameras ReadMetashapeRig(const std::string& path,
                         double pixel_offset,
                         RigRemarks* remarks);
void WriteMetashapeRig(const std::string& path,
                       const Cameras& cameras,
                       double pixel_offset,
                       RigRemarks* remarks);

// calibration_*.json of the CMU Panoptic Studio.
Cameras ReadPanopticRig(const std::string& path,
                        double pixel_offset,
                        RigRemarks* remarks);
void WritePanopticRig(const std::string& path,
                      const Cameras& cameras,
                      double pixel_offset,
                      RigRemarks* remarks);

// calibration.csv of ActorsHQ.
Cameras ReadCsvRig(const std::string& path,
                   double pixel_offset,
                   RigRemarks* remarks);
void WriteCsvRig(const std::string& path,
                 const Cameras& cameras,
                 double pixel_offset,
                 RigRemarks* remarks);

// camchain.yaml of Kalibr: the first camera is the world.
Cameras ReadKalibrRig(const std::string& path,
                      double pixel_offset,
                      RigRemarks* remarks);
void WriteKalibrRig(const std::string& path,
                    const Cameras& cameras,
                    double pixel_offset,
                    RigRemarks* remarks);

// calibration.json of multical.
Cameras ReadMulticalRig(const std::string& path,
                        double pixel_offset,
                        RigRemarks* remarks);
void WriteMulticalRig(const std::string& path,
                      const Cameras& cameras,
                      double pixel_offset,
                      RigRemarks* remarks);

// .npz of NumPy, as loaders in Python take known cameras (DUSt3R, MASt3R).
Cameras ReadNpzRig(const std::string& path,
                   double pixel_offset,
                   RigRemarks* remarks);
void WriteNpzRig(const std::string& path,
                 const Cameras& cameras,
                 double pixel_offset,
                 RigRemarks* remarks);

// Whether `path` is a folder or file that ReadOpenCVRig takes.
bool IsOpenCVRig(const std::string& path);

}  // namespace mfir

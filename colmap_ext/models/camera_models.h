// COLMAP's camera models behind the refiner's CameraModel interface.

#pragma once

#include <optional>
#include <string>

#include "src/sensor/camera_model.h"

namespace mfir {

// The model with COLMAP's identifier, nullptr if there is none. The object
// lives as long as the program.
const CameraModel* FindCameraModel(int model_id);

// The model with COLMAP's name (e.g. "OPENCV"), nullptr if there is none.
const CameraModel* FindCameraModel(const std::string& model_name);

// For a model of COLMAP that is not among them: why, and what to do. Nothing
// for a model that no version of COLMAP has.
std::optional<std::string> WhyNotSupported(int model_id);
std::optional<std::string> WhyNotSupported(const std::string& model_name);

// COLMAP's identifier of a model.
int CameraModelId(const CameraModel& model);

// Names of the parameters of a model, as COLMAP's: "fx", "fy", "cx", ...
std::vector<std::string> CameraParamNames(const CameraModel& model);

// All models of this COLMAP version, by ascending identifier.
std::vector<const CameraModel*> AllCameraModels();

}  // namespace mfir

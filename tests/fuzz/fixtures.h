// Good files that the fuzzed ones belong to, of two cameras: "a" and "b".

#pragma once

#include <string>
#include <vector>

#include "src/dense/dense_features.h"
#include "src/scene/scene.h"

namespace mfir {

// Side by side, 640 x 480 pixels, focal length 500 px.
const std::vector<RigCamera>& FixtureCameras();

// Bytes of a database with keypoints, descriptors and matches of both images.
std::string FixtureFrameDatabase();

// Bytes of a database of dense features that has those of the request.
std::string FixtureFeatureDatabase();
DenseFeatureRequest FixtureFeatureRequest();

// Writes the models of a result, rig and frames/f, to the folder.
void WriteFixtureResult(const std::string& path);

// The summary.json that belongs to them.
std::string FixtureSummary();

}  // namespace mfir

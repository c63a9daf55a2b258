// Choice of the source of dense features.

#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "colmap_ext/options/option_parser.h"
#include "src/dense/dense_features.h"
#include "src/refinement/options.h"

namespace mfir {

// Registers the options of all sources, [MultiFrame].
void AddDenseFeatureOptions(MultiFrameOptions* multi_frame,
                            OptionParser* parser);

// The source that options.dense_features names ("sift", "onnx" or "database"),
// which also writes what it gives if options.features.write_path is set.
//
// `requests` are all images that will be asked for; only their names matter
// here. Images without a file, or without rows in the database, have no
// features: `log` gets one line about them. Throws InputError when that is true
// for all of them, UsageError for options that do not fit together, OutputError
// when the features cannot be written.
std::unique_ptr<DenseFeatureSource> MakeDenseFeatureSource(
    const MultiFrameOptions& options,
    const std::string& image_path,
    const std::vector<DenseFeatureRequest>& requests,
    const std::function<void(const std::string&)>& log);

}  // namespace mfir

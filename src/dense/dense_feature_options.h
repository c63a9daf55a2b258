// Options of the dense feature sources.

#pragma once

#include <string>
#include <vector>

namespace mfir {

// Dense SIFT at every pixel.
struct SiftFeatureOptions {
  // Width of each of the 4 x 4 spatial bins, px. Even: descriptors of odd bins
  // would be centred between pixels.
  int bin_size = 4;
  // Standard deviation (px) of the Gaussian that the image is smoothed with.
  double smoothing = 1.0;
};

// A fully convolutional network in an ONNX file.
struct OnnxFeatureOptions {
  std::string path;
  // Names in the file; empty: the only one.
  std::string input_name;
  std::string output_name;
  // Channels of the network's input: rgb, bgr or grey.
  std::string color_order = "rgb";
  // Input = (value / 255 - mean) / std, one number or one per channel,
  // separated by commas.
  std::string mean = "0";
  std::string std = "1";
  // Scales each descriptor to unit length.
  bool l2_normalize = true;
  // Image pixels per pixel of the descriptor map; 0: from its size. Map pixel i
  // has its centre at (i + 0.5) * stride.
  int stride = 0;
  // Larger images are cut into tiles of this side (px), whose descriptors are
  // used at least tile_overlap px (the radius of the receptive field) inside.
  int tile_size = 1024;
  int tile_overlap = 64;
  // Sides and positions of tiles are multiples of this (px): the product of all
  // strides and poolings inside the network.
  int tile_alignment = 32;
  // The network takes inputs of tile_size x tile_size only; smaller images are
  // continued by their border pixels.
  bool fixed_size = false;
};

struct DenseFeatureOptions {
  // Side of the patches that are computed, in feature pixels.
  int patch_size = 16;
  SiftFeatureOptions sift;
  OnnxFeatureOptions onnx;
  // SQLite file that the source "database" reads.
  std::string database_path;
  // SQLite file that all features are written to; empty: none.
  std::string write_path;

  // Throws UsageError that names the first option that does not suit the source
  // ("none", "sift", "onnx", "database", empty: not chosen yet).
  void Check(const std::string& source) const;
};

// "0.485,0.456,0.406" -> numbers. Throws UsageError that names the option.
std::vector<double> ParseNumberList(const std::string& option_name,
                                    const std::string& text);

}  // namespace mfir

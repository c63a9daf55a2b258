// COLMAP's bitmaps, read from and written to files.

#pragma once

#include <cstdint>
#include <string>
#include <vector>

#if MFIR_COLMAP_MAJOR >= 4
#include "colmap/sensor/bitmap.h"
#else
#include "util/bitmap.h"
#endif

namespace mfir::host {

using colmap::Bitmap;
using BitmapColor = colmap::BitmapColor<uint8_t>;

// Black.
Bitmap MakeBitmap(int width, int height, bool as_rgb);

// Pixel by pixel: red, green, blue, or grey.
std::vector<uint8_t> RowMajorData(const Bitmap& bitmap);

// Of the first channel; 0 outside of the bitmap.
uint8_t PixelOrBlack(const Bitmap& bitmap, int x, int y);

// Shrinks the bitmap so that no side is longer, with its aspect ratio.
void Thumbnail(int max_image_size, Bitmap* bitmap);

// The content of a JPEG file; empty if it cannot be made.
std::vector<uint8_t> EncodeJpeg(const Bitmap& bitmap);

// By its extension.
bool IsImageFileName(const std::string& path);

}  // namespace mfir::host

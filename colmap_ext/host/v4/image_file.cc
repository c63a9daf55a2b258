#include "colmap_ext/host/image_file.h"

#include <algorithm>
#include <cctype>
#include <filesystem>
#include <memory>
#include <sstream>

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>

namespace mfir::host {

Bitmap MakeBitmap(int width, int height, bool as_rgb) {
  Bitmap bitmap(width, height, as_rgb);
  bitmap.Fill(BitmapColor(0));
  return bitmap;
}

std::vector<uint8_t> RowMajorData(const Bitmap& bitmap) {
  return bitmap.RowMajorData();
}

uint8_t PixelOrBlack(const Bitmap& bitmap, int x, int y) {
  const auto color = bitmap.GetPixel(x, y);
  return color ? color->r : 0;
}

void Thumbnail(int max_image_size, Bitmap* bitmap) {
  bitmap->Thumbnail(max_image_size);
}

std::vector<uint8_t> EncodeJpeg(const Bitmap& bitmap) {
  std::vector<uint8_t> bytes;
  OIIO::Filesystem::IOVecOutput file(bytes);
  OIIO::ImageSpec spec(bitmap.Width(),
                       bitmap.Height(),
                       bitmap.Channels(),
                       OIIO::TypeDesc::UINT8);
  spec["CompressionQuality"] = 80;
  const std::unique_ptr<OIIO::ImageOutput> output =
      OIIO::ImageOutput::create("image.jpg", &file);
  if (output == nullptr || !output->open("image.jpg", spec) ||
      !output->write_image(OIIO::TypeDesc::UINT8,
                           RowMajorData(bitmap).data()) ||
      !output->close()) {
    bytes.clear();
  }
  return bytes;
}

bool IsImageFileName(const std::string& path) {
  std::string extension = std::filesystem::path(path).extension().string();
  if (extension.empty()) return false;
  extension.erase(0, 1);
  std::transform(extension.begin(),
                 extension.end(),
                 extension.begin(),
                 [](unsigned char c) { return std::tolower(c); });
  // "format:ext,ext;format:ext"; formats themselves are no extensions.
  std::istringstream formats(OIIO::get_string_attribute("extension_list"));
  std::string format;
  while (std::getline(formats, format, ';')) {
    // Videos, of which OpenImageIO reads single images.
    if (format.rfind("ffmpeg:", 0) == 0) continue;
    std::istringstream names(format.substr(format.find(':') + 1));
    std::string name;
    while (std::getline(names, name, ',')) {
      if (name == extension) return true;
    }
  }
  return false;
}

}  // namespace mfir::host

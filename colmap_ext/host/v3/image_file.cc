#include "colmap_ext/host/image_file.h"

#include <algorithm>

namespace mfir::host {

Bitmap MakeBitmap(int width, int height, bool as_rgb) {
  Bitmap bitmap;
  bitmap.Allocate(width, height, as_rgb);
  bitmap.Fill(BitmapColor(0));
  return bitmap;
}

std::vector<uint8_t> RowMajorData(const Bitmap& bitmap) {
  std::vector<uint8_t> data = bitmap.ConvertToRowMajorArray();
  // FreeImage has blue first.
  if (bitmap.Channels() == 3) {
    for (size_t i = 0; i + 2 < data.size(); i += 3) {
      std::swap(data[i], data[i + 2]);
    }
  }
  return data;
}

uint8_t PixelOrBlack(const Bitmap& bitmap, int x, int y) {
  BitmapColor color(0);
  return bitmap.GetPixel(x, y, &color) ? color.r : 0;
}

void Thumbnail(int max_image_size, Bitmap* bitmap) {
  const int size = std::max(bitmap->Width(), bitmap->Height());
  if (size <= max_image_size) return;
  const double scale = static_cast<double>(max_image_size) / size;
  bitmap->Rescale(static_cast<int>(bitmap->Width() * scale),
                  static_cast<int>(bitmap->Height() * scale));
}

std::vector<uint8_t> EncodeJpeg(const Bitmap& bitmap) {
  std::vector<uint8_t> bytes;
  constexpr int kQuality = 80;
  // FreeImage does not know const.
  auto* const dib = const_cast<FIBITMAP*>(bitmap.Data());
  FIMEMORY* const memory = FreeImage_OpenMemory();
  BYTE* data = nullptr;
  DWORD size = 0;
  if (FreeImage_SaveToMemory(FIF_JPEG, dib, memory, kQuality) &&
      FreeImage_AcquireMemory(memory, &data, &size)) {
    bytes.assign(data, data + size);
  }
  FreeImage_CloseMemory(memory);
  return bytes;
}

bool IsImageFileName(const std::string& path) {
  return FreeImage_GetFIFFromFilename(path.c_str()) != FIF_UNKNOWN;
}

}  // namespace mfir::host

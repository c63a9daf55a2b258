#include "colmap_ext/host/image_file.h"

#include <gtest/gtest.h>

namespace mfir {
namespace {

TEST(IsImageFileName, ImagesAndNoVideos) {
  for (const char* name : {"a/b.png", "b.JPG", "b.jpeg", "c.tif", "d.bmp"}) {
    EXPECT_TRUE(host::IsImageFileName(name)) << name;
  }
  for (const char* name : {"a.mp4", "a.avi", "a.MOV", "a.txt"}) {
    EXPECT_FALSE(host::IsImageFileName(name)) << name;
  }
}

}  // namespace
}  // namespace mfir

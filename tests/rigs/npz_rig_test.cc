// Known cameras as arrays of NumPy: what is written, and bad input.

#include <limits>

#include "colmap_ext/io/npz_file.h"
#include "colmap_ext/rigs/rig_io.h"
#include "tests/support/rig_examples.h"
#include "tests/support/test_files.h"

namespace mfir {
namespace {

using Arrays = std::vector<std::pair<std::string, NumpyArray>>;

Rig ReadNpz(const std::string& path) {
  return ReadRig(
      path, "npz", CameraNaming(), std::numeric_limits<double>::quiet_NaN());
}

// One camera "ä", at (1, 2, 3), without rotation.
Arrays OneCamera() {
  return {{"images", {{1}, {}, {"\xc3\xa4"}}},
          {"intrinsics", {{1, 3, 3}, {9, 0, 4, 0, 8, 3, 0, 0, 1}, {}}},
          {"trajectories",
           {{1, 4, 4}, {1, 0, 0, 1, 0, 1, 0, 2, 0, 0, 1, 3, 0, 0, 0, 1}, {}}},
          {"image_sizes", {{1, 2}, {640, 480}, {}}}};
}

TEST(NpzRig, IsReadAsWritten) {
  const TemporaryFolder folder;
  WriteNpz(folder / "cameras.npz", OneCamera());
  const Rig rig = ReadNpz(folder / "cameras.npz");
  ASSERT_EQ(rig.cameras.size(), 1);
  EXPECT_EQ(rig.cameras[0].name, "\xc3\xa4");
  EXPECT_EQ(rig.cameras[0].params, std::vector<double>({9, 8, 4.5, 3.5}));
  EXPECT_EQ(rig.cameras[0].cam_from_world.Center(), Eigen::Vector3d(1, 2, 3));
  EXPECT_EQ(rig.cameras[0].width, 640);
  EXPECT_EQ(rig.cameras[0].height, 480);
}

// As NumPy itself writes an array; the archive is not compressed.
TEST(NpzRig, HeaderIsThatOfNumpy) {
  const TemporaryFolder folder;
  WriteNpz(folder / "cameras.npz", OneCamera());
  const std::string bytes = ReadFile(folder / "cameras.npz");
  const size_t begin = bytes.find("\x93NUMPY\x01", bytes.find("sizes.npy"));
  ASSERT_NE(begin, std::string::npos);
  const std::string header =
      "{'descr': '<f8', 'fortran_order': False, 'shape': (1,2,), }";
  EXPECT_EQ(bytes.substr(begin + 7, 3), std::string("\0\x76\0", 3));
  EXPECT_EQ(bytes.substr(begin + 10, 118),
            header + std::string(117 - header.size(), ' ') + "\n");
  const double expected[] = {640, 480};
  EXPECT_EQ(bytes.substr(begin + 128, 16),
            std::string(reinterpret_cast<const char*>(expected), 16));
}

TEST(NpzRig, BadArraysAreErrors) {
  struct Case {
    std::string name;
    NumpyArray array;
    std::string part;
  };
  for (const Case& bad : std::vector<Case>{
           {"images", {{0}, {}, {}}, "images has no names"},
           {"images", {{2}, {}, {"a", "b"}}, "is not one of 2 x 3 x 3 numbers"},
           {"intrinsics", {{1, 3}, {1, 2, 3}, {}}, "of 1 x 3 x 3 numbers"},
           {"intrinsics",
            {{1, 3, 3}, {0, 0, 4, 0, 8, 3, 0, 0, 1}, {}},
            "focal length"},
           {"trajectories", {{1}, {}, {"a"}}, "of 1 x 4 x 4 numbers"},
           {"trajectories",
            {{1, 4, 4}, std::vector<double>(16, 1.0), {}},
            "last row"},
           {"image_sizes", {{1, 2}, {0, 480}, {}}, "is not a size"}}) {
    SCOPED_TRACE(bad.name + ": " + bad.part);
    const TemporaryFolder folder;
    Arrays arrays = OneCamera();
    for (auto& [name, array] : arrays) {
      if (name == bad.name) array = bad.array;
    }
    WriteNpz(folder / "cameras.npz", arrays);
    ExpectInputError([&]() { ReadNpz(folder / "cameras.npz"); },
                     {"cameras.npz", bad.part});
  }
  const TemporaryFolder folder;
  Arrays arrays = OneCamera();
  arrays.erase(arrays.begin() + 1);
  WriteNpz(folder / "cameras.npz", arrays);
  ExpectInputError([&]() { ReadNpz(folder / "cameras.npz"); },
                   {"the array intrinsics is missing"});
  WriteFile(folder / "cameras.npz", "no archive");
  ExpectInputError([&]() { ReadNpz(folder / "cameras.npz"); }, {"is no .npz"});
  EXPECT_THROW(WriteNpz(folder / "cameras.npz", {{"x", {{1}, {}, {"\xff"}}}}),
               InputError);
  EXPECT_THROW(WriteNpz(folder / "none/cameras.npz", OneCamera()), OutputError);
}

// Neither a crash nor an endless loop.
TEST(NpzRig, EveryDamagedByteIsAnErrorOrDoesNotMatter) {
  const TemporaryFolder folder;
  WriteNpz(folder / "cameras.npz", OneCamera());
  for (const std::string& bytes :
       {NpzExample(), ReadFile(folder / "cameras.npz")}) {
    for (size_t i = 0; i < bytes.size(); ++i) {
      for (const int change : {0x01, 0x80, 0xff}) {
        std::string damaged = bytes;
        damaged[i] = static_cast<char>(damaged[i] ^ change);
        WriteFile(folder / "damaged.npz", damaged);
        try {
          EXPECT_GE(ReadNpz(folder / "damaged.npz").cameras.size(), 1);
        } catch (const InputError&) {
        }
      }
    }
  }
}

}  // namespace
}  // namespace mfir

#include "colmap_ext/io/work_folder.h"

#include <filesystem>
#include <optional>

#include "tests/support/test_files.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

void ExpectOutputError(const std::function<void()>& body,
                       const std::string& part) {
  try {
    body();
    ADD_FAILURE() << "no error, expected: " << part;
  } catch (const OutputError& error) {
    EXPECT_NE(std::string(error.what()).find(part), std::string::npos)
        << error.what();
  }
}

TEST(WorkFolder, GoesWithTheObject) {
  const TemporaryFolder folder;
  {
    const WorkFolder work(folder / "work");
    EXPECT_EQ(work.Path().string(), folder / "work");
    WriteFile(folder / "work/a/b", "x");
  }
  EXPECT_TRUE(fs::is_empty(folder.Path()));
}

TEST(WorkFolder, OfAKilledRunIsEmptied) {
  const TemporaryFolder folder;
  WriteFile(folder / "work/a/b", "x");
  const WorkFolder work(folder / "work");
  EXPECT_TRUE(fs::is_empty(folder / "work"));
}

TEST(WorkFolder, OfAnotherRunStays) {
  const TemporaryFolder folder;
  std::optional<WorkFolder> work(folder / "work");
  WriteFile(folder / "work/a", "x");
  ExpectOutputError([&]() { WorkFolder(folder / "work"); }, "another run");
  EXPECT_EQ(ReadFile(folder / "work/a"), "x");
  work.reset();
  const WorkFolder next(folder / "work");
}

TEST(WorkFolder, LinksAreNotFollowed) {
  const TemporaryFolder folder;
  WriteFile(folder / "elsewhere/a", "keep me");
  fs::create_directory_symlink(folder / "elsewhere", folder / "work");
  {
    const WorkFolder work(folder / "work");
    WriteFile(folder / "work/b", "x");
  }
  EXPECT_FALSE(fs::exists(folder / "work"));
  EXPECT_EQ(ReadFile(folder / "elsewhere/a"), "keep me");
  EXPECT_FALSE(fs::exists(folder / "elsewhere/b"));
}

TEST(WorkFolder, CannotBeMade) {
  const TemporaryFolder folder;
  ExpectOutputError([&]() { WorkFolder(folder / "a/b"); }, "cannot write");
  ExpectOutputError([&]() { WorkFolder("/proc/mfir"); }, "/proc: cannot write");
}

TEST(WorkFolder, BesideIsShortAndOfTheName) {
  const fs::path longest = "/a/" + std::string(255, 'n');
  const fs::path beside = WorkFolder::Beside(longest);
  EXPECT_EQ(beside.parent_path(), "/a");
  EXPECT_LT(beside.filename().string().size(), 40);
  EXPECT_NE(beside, WorkFolder::Beside("/a/n"));
  EXPECT_EQ(WorkFolder::Beside("b/c/"), WorkFolder::Beside("b/c"));
  EXPECT_TRUE(WorkFolder::Beside("c").parent_path().empty());
}

TEST(ReplaceFile, Replaces) {
  const TemporaryFolder folder;
  WriteFile(folder / "file", "before, and longer");
  ReplaceFile(folder / "file", "after");
  EXPECT_EQ(ReadFile(folder / "file"), "after");
  const std::string longest = folder / std::string(255, 'n');
  ReplaceFile(longest, "text");
  EXPECT_EQ(ReadFile(longest), "text");
  fs::remove(longest);
  fs::remove(folder / "file");
  EXPECT_TRUE(fs::is_empty(folder.Path()));
}

TEST(ReplaceFile, LinksAreNotFollowed) {
  const TemporaryFolder folder;
  WriteFile(folder / "elsewhere", "keep me");
  fs::create_symlink(folder / "elsewhere", folder / "file");
  ReplaceFile(folder / "file", "text");
  EXPECT_EQ(ReadFile(folder / "elsewhere"), "keep me");
  EXPECT_EQ(ReadFile(folder / "file"), "text");
}

TEST(ReplaceFile, CannotBeWritten) {
  const TemporaryFolder folder;
  fs::create_directory(folder / "folder");
  for (const std::string& path :
       {folder / "folder", folder / "folder/", folder / "no/file"}) {
    ExpectOutputError([&]() { ReplaceFile(path, "text"); }, "cannot write");
  }
  EXPECT_TRUE(fs::is_empty(folder / "folder"));
}

}  // namespace
}  // namespace mfir

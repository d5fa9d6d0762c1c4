// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/files/output_folder.h"

#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/files/temporary_folder_testing.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;

class OutputFolderTest : public ::testing::Test {
 protected:
  void write(const char* text, bool force) const {
    write_output_folder("OUT", out_, force,
                        [&](const fs::path& folder) { write_file(folder / "a", text); });
  }
  std::ptrdiff_t entries() const {
    return std::distance(fs::directory_iterator(folder_.path), fs::directory_iterator());
  }

  TemporaryFolder folder_;
  const fs::path out_ = folder_.path / "out";
};

TEST_F(OutputFolderTest, ReplacesOnlyWhatItMade) {
  EXPECT_NO_THROW(check_output_folder("OUT", out_, false));
  write("first", false);
  EXPECT_THROW(write("second", false), UsageError);
  EXPECT_THROW(check_output_folder("OUT", out_, false), UsageError);
  EXPECT_NO_THROW(check_output_folder("OUT", out_, true));
  write("second", true);
  EXPECT_EQ(read_file(out_ / "a"), "second");
  EXPECT_EQ(entries(), 1);
  for (const char* file : {"sparse/0/cameras.bin", "transforms.json", "000000.png"}) {
    const fs::path foreign = folder_.path / "foreign";
    folder_.write(foreign / file, "");
    EXPECT_THROW(check_output_folder("OUT", foreign, true), UsageError) << file;
    EXPECT_THROW(write_output_folder("OUT", foreign, true, [](const fs::path&) {}), UsageError);
    EXPECT_TRUE(fs::exists(foreign / file)) << file;
    fs::remove_all(foreign);
  }
}

TEST_F(OutputFolderTest, LeavesEverythingAsItWas) {
  write("first", false);
  const auto fail = [](const fs::path& folder) {
    write_file(folder / "a", "half");
    throw Interrupted();
  };
  EXPECT_THROW(write_output_folder("OUT", out_, true, fail), Interrupted);
  EXPECT_EQ(read_file(out_ / "a"), "first");
  EXPECT_EQ(entries(), 1);
}

}  // namespace
}  // namespace redrive

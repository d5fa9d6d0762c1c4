// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/folder_kind.h"

#include "redrive/recording/core/recording.h"
#include "redrive/recording/formats/kitti/kitti_testing.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::HasSubstr;
using testing::input_error;
using ::testing::Not;

class FolderKindTest : public ::testing::Test {
 protected:
  std::string refusal(const std::string& below) {
    return input_error([&] { open_recording(folder_.path / below); });
  }
  TemporaryFolder folder_;
};

TEST_F(FolderKindTest, RecordingsOneOrTwoFoldersAwayAreNamed) {
  testing::write_kitti_drive(folder_);
  const std::string drive = folder_.path / testing::kKittiDrive;
  for (const std::string below :
       {"2011_09_26", "", "2011_09_26/2011_09_26_drive_0001_sync/image_02",
        "2011_09_26/2011_09_26_drive_0001_sync/image_02/data",
        "2011_09_26/2011_09_26_drive_0002_sync"})
    EXPECT_THAT(refusal(below), HasSubstr("did you mean " + drive + ", a recording (kitti)?"))
        << below;
  EXPECT_THAT(refusal("2011_09_26"), Not(HasSubstr("looked for")));
  fs::copy(drive, drive + "_again", fs::copy_options::recursive);
  EXPECT_THAT(refusal("2011_09_26"), HasSubstr("did you mean one of " + drive));
}

TEST_F(FolderKindTest, AFileBelongsToItsFolder) {
  folder_.write("set/transforms.json", "{}");
  EXPECT_THAT(refusal("set/transforms.json"), AllOf(HasSubstr("is a folder, this is none"),
                                                    HasSubstr("set, a recording (transforms)")));
}

TEST_F(FolderKindTest, RunsAndPosesAreNoRecordings) {
  folder_.write("run/config.json", "{}");
  folder_.write("run/checkpoint.safetensors", "");
  folder_.write("aligned/report.html", "");
  folder_.write("aligned/egomotion.json", "{}");
  EXPECT_EQ(kind_of_folder(folder_.path / "run"), FolderKind::kRun);
  EXPECT_EQ(kind_of_folder(folder_.path / "aligned"), FolderKind::kPoses);
  EXPECT_EQ(kind_of_folder(folder_.path), FolderKind::kUnknown);
  EXPECT_THAT(refusal("run"), HasSubstr("is no recording but a run of redrive train"));
  EXPECT_THAT(refusal("aligned"), HasSubstr("poses that redrive align wrote: --poses takes it"));
  EXPECT_THAT(refusal("run/poses"), HasSubstr("did you mean " + (folder_.path / "run").string()));
}

TEST_F(FolderKindTest, WithoutAnyTheFormatsAreListed) {
  folder_.write("photos/1.jpg", "");
  EXPECT_EQ(did_you_mean(folder_.path / "photos"), "");
  EXPECT_THAT(refusal("photos"), HasSubstr("looked for aimotive"));
}

}  // namespace
}  // namespace redrive

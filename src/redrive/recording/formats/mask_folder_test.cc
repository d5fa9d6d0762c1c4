// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/mask_folder.h"

#include "redrive/recording/core/recording_testing.h"

namespace redrive {
namespace {

using ::testing::HasSubstr;

TEST(MaskFolder, FindsMasksByTheNamesOfOtherPrograms) {
  TemporaryFolder folder;
  for (const char* name : {"1.jpg.png", "1.png", "a/2.PNG", "3_mask.png", "4.mask.jpg", "5.jpg",
                           "6.png", "nobody.png"})
    folder.write(std::string("masks/") + name, "");
  MaskFolder masks(folder.path);
  const std::filesystem::path at = folder.path / "masks";
  EXPECT_EQ(masks.find("1.jpg").path, at / "1.jpg.png") << "COLMAP's comes first";
  EXPECT_TRUE(masks.find("1.jpg").black_is_masked);
  EXPECT_EQ(masks.find("a/2.JPG").path, at / "a/2.PNG");
  EXPECT_EQ(masks.find("3.png").path, at / "3_mask.png");
  EXPECT_EQ(masks.find("4.jpg").path, at / "4.mask.jpg");
  EXPECT_EQ(masks.find("5.jpg").path, at / "5.jpg");
  EXPECT_TRUE(masks.find("2.JPG").path.empty()) << "it is of a/2";
  masks.use(at / "../masks/6.png");
  std::vector<Finding> findings;
  masks.report_unused(&findings);
  ASSERT_EQ(findings.size(), 1u);
  EXPECT_EQ(findings[0].subject, "masks");
  EXPECT_THAT(findings[0].what, HasSubstr("2 files not used"));
  EXPECT_THAT(findings[0].what, HasSubstr("1.png, nobody.png"));
}

TEST(MaskFolder, OtherFoldersHaveNoMasks) {
  TemporaryFolder folder;
  folder.write("images/1.png", "");
  MaskFolder masks(folder.path);
  EXPECT_TRUE(masks.find("1.png").path.empty());
  std::vector<Finding> findings;
  masks.report_unused(&findings);
  EXPECT_TRUE(findings.empty());
}

}  // namespace
}  // namespace redrive

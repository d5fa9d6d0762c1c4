// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/image_size.h"

#include "redrive/image/image_io.h"
#include "redrive/recording/core/recording_testing.h"

namespace redrive {
namespace {

Image8 grey_image(int width, int height) {
  return {width, height, std::vector<std::uint8_t>(std::size_t(3) * width * height, 128)};
}

TEST(ImageSize, IsReadFromHeadersOfBothKinds) {
  TemporaryFolder folder;
  for (const char* name : {"a.png", "a.jpg"}) {
    write_image(folder.path / name, grey_image(37, 21));
    EXPECT_EQ(image_size(folder.path / name), (ImageSize{37, 21})) << name;
  }
  folder.write("empty.png", "");
  folder.write("text.jpg", "\xff\xd8\xff\xe0");
  EXPECT_EQ(image_size(folder.path / "empty.png"), std::nullopt);
  EXPECT_EQ(image_size(folder.path / "text.jpg"), std::nullopt);
  EXPECT_EQ(image_size(folder.path / "missing.png"), std::nullopt);
}

}  // namespace
}  // namespace redrive

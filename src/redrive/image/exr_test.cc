// SPDX-License-Identifier: Apache-2.0
// Reads EXR files back by tinyexr; skips where the build has none.
#include "redrive/image/exr.h"

#include <cstdlib>
#include <limits>
#include <vector>

#include <gtest/gtest.h>

#if __has_include(<tinyexr.h>)
#include <tinyexr.h>
#endif

#include "redrive/base/files/temporary_folder_testing.h"

namespace redrive {
namespace {

TEST(Exr, IsReadBackBitForBit) {
  if (const auto obstacle = exr_obstacle()) GTEST_SKIP() << *obstacle;
#if __has_include(<tinyexr.h>)
  const int width = 37, height = 21;  // more than one block of 16 rows
  std::vector<float> values;
  for (int i = 0; i < width * height; ++i) values.push_back(0.001f * static_cast<float>(i * i));
  values[5] = std::numeric_limits<float>::infinity();
  const TemporaryFolder folder;
  const std::string file = (folder.path / "depth.exr").string();
  write_exr(file, width, height, values);

  EXRVersion version;
  ASSERT_EQ(ParseEXRVersionFromFile(&version, file.c_str()), TINYEXR_SUCCESS);
  EXRHeader header;
  InitEXRHeader(&header);
  const char* message = nullptr;
  ASSERT_EQ(ParseEXRHeaderFromFile(&header, &version, file.c_str(), &message), TINYEXR_SUCCESS);
  ASSERT_EQ(header.num_channels, 1);
  EXPECT_STREQ(header.channels[0].name, "Z");
  EXPECT_EQ(header.pixel_types[0], TINYEXR_PIXELTYPE_FLOAT);
  EXRImage image;
  InitEXRImage(&image);
  ASSERT_EQ(LoadEXRImageFromFile(&image, &header, file.c_str(), &message), TINYEXR_SUCCESS);
  ASSERT_EQ(image.width, width);
  ASSERT_EQ(image.height, height);
  const float* const read = reinterpret_cast<const float*>(image.images[0]);
  EXPECT_EQ(std::vector<float>(read, read + values.size()), values);
  FreeEXRImage(&image);
  FreeEXRHeader(&header);
#endif
}

}  // namespace
}  // namespace redrive

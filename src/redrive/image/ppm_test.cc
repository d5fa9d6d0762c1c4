// SPDX-License-Identifier: Apache-2.0
#include "redrive/image/ppm.h"

#include <gmock/gmock.h>

#include "redrive/base/error.h"

namespace redrive {
namespace {

using ::testing::ElementsAre;

TEST(Ppm, ReadsColoursAndGrey) {
  const Image8 colour = decode_ppm(ppm_head_text(2, 1, 3) + "abcdef", "x.ppm");
  EXPECT_EQ(colour.width, 2);
  EXPECT_EQ(colour.height, 1);
  EXPECT_THAT(colour.rgb, ElementsAre('a', 'b', 'c', 'd', 'e', 'f'));
  const Image8 grey = decode_ppm("P5 1\t2\r255\nxy", "x.pgm");
  EXPECT_EQ(grey.height, 2);
  EXPECT_THAT(grey.rgb, ElementsAre('x', 'x', 'x', 'y', 'y', 'y'));
}

TEST(Ppm, RefusesOtherFiles) {
  EXPECT_THROW(decode_ppm(ppm_head_text(2, 1, 3) + "abcde", "x.ppm"), InputError) << "cut off";
  for (const char* head :
       {"", "P6", "P6 2 1 255", "P4 2 1 255\n", "P6 2 1 65535\n", "P6 0 1 255\n", "P6 -2 1 255\n",
        "P6 70000 1 255\n", "P6 65536 65536 255\n", "P62 1 255\n"})
    EXPECT_FALSE(parse_ppm_head(head)) << head;
}

}  // namespace
}  // namespace redrive

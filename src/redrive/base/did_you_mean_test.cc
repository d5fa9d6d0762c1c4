// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/did_you_mean.h"

#include <gtest/gtest.h>

namespace redrive {
namespace {

TEST(EditDistance, CountsInsertionsDeletionsReplacementsAndSwaps) {
  EXPECT_EQ(edit_distance("train", "train"), 0);
  EXPECT_EQ(edit_distance("train", "rain"), 1);
  EXPECT_EQ(edit_distance("train", "tarin"), 1);
  EXPECT_EQ(edit_distance("train", "TRAIM"), 1);
  EXPECT_EQ(edit_distance("", "abc"), 3);
  EXPECT_EQ(edit_distance("kitten", "sitting"), 3);
}

TEST(DidYouMean, NamesWhatIsNear) {
  const std::vector<std::string> names = {"inspect", "align", "train", "F_MIDRANGECAM_C", ""};
  EXPECT_EQ(did_you_mean("tarin", names), "; did you mean train?");
  EXPECT_EQ(did_you_mean("insp", names), "; did you mean inspect?");
  EXPECT_EQ(did_you_mean("f_midrangecam_c", names), "; did you mean F_MIDRANGECAM_C?");
  EXPECT_EQ(did_you_mean("velodrome", names), "");
  EXPECT_EQ(did_you_mean("x", {}), "");
}

TEST(DidYouMean, ListsAllNamesToo) {
  EXPECT_EQ(unknown_name("meshh", {"", "ply", "mesh"}),
            "unknown; known are ply, mesh; did you mean mesh?");
}

}  // namespace
}  // namespace redrive

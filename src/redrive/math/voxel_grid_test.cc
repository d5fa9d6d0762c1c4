// SPDX-License-Identifier: Apache-2.0
#include "redrive/math/voxel_grid.h"

#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace redrive {
namespace {

using ::testing::ElementsAre;

TEST(VoxelGrid, RoundsDownOnBothSidesOfTheOrigin) {
  EXPECT_EQ(voxel_of(Eigen::Vector3d(0.49, -0.01, 1), 0.5), Voxel(0, -1, 2));
  EXPECT_EQ(voxel_of(Eigen::Vector3f(-0.5f, -0.51f, 3e9f), 0.5f), Voxel(-1, -2, 6'000'000'000));
}

TEST(VoxelGrid, KeysReturnTheirVoxelsInTheirOrder) {
  const std::vector<Voxel> ascending = {{-1048576, 5, 0}, {-3, 1048575, 0}, {-2, -4, 7},
                                        {-2, -4, 8},      {-2, 0, -9},      {0, 0, 0},
                                        {0, 0, 1},        {1048575, 0, 0}};
  for (std::size_t i = 0; i < ascending.size(); ++i) {
    EXPECT_EQ(voxel_of_key(voxel_key(ascending[i])), ascending[i]);
    if (i > 0) {
      EXPECT_LT(voxel_key(ascending[i - 1]), voxel_key(ascending[i])) << i;
    }
  }
  EXPECT_EQ(voxel_of_key(voxel_key({1 << 20, 0, 0})), Voxel(-(1 << 20), 0, 0)) << "wraps";
}

TEST(VoxelGrid, GroupsPointsByKey) {
  const VoxelGroups groups(std::vector<std::uint64_t>{7, 3, 7, 9, 3});
  ASSERT_EQ(groups.size(), 3u);
  EXPECT_THAT(groups[0], ElementsAre(1, 4));
  EXPECT_THAT(groups[1], ElementsAre(0, 2));
  EXPECT_THAT(groups[2], ElementsAre(3));
  EXPECT_EQ(VoxelGroups(std::vector<std::uint64_t>{}).size(), 0u);
}

}  // namespace
}  // namespace redrive

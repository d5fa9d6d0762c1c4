// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/splat/actors/articulated.h"

#include <gtest/gtest.h>

namespace redrive {
namespace {

MovingObject of_type(const char* type, const Eigen::Vector3d& size_m) {
  return {.id = 1, .type = type, .size_m = size_m, .keys = {}};
}

TEST(Articulated, ArePeopleAndWhatIsNoLarger) {
  EXPECT_TRUE(is_articulated(of_type("human.pedestrian.adult", {0.8, 0.7, 1.8})));
  EXPECT_TRUE(is_articulated(of_type("Cyclist", {1.8, 0.6, 1.7})));
  EXPECT_TRUE(is_articulated(of_type("FOUND", {2.2, 0.5, 1.9})));
  EXPECT_FALSE(is_articulated(of_type("FOUND", {4.2, 0.5, 1.5}))) << "a car's side";
  EXPECT_FALSE(is_articulated(of_type("FOUND", {2, 1.7, 1.5}))) << "a car's back";
  EXPECT_FALSE(is_articulated(of_type("Car", {2, 1, 1.5})));
}

TEST(Articulated, PartsAreCellsAndWhatIsOnTheRoad) {
  const Eigen::Vector3d size_m(1.8, 0.6, 1.8);
  GaussianList list;
  const auto add = [&](const Eigen::Vector3d& at) {
    std::array<float, kGaussianRows> row{};
    for (int k = 0; k < 3; ++k) row[kPositionRow + k] = static_cast<float>(at[k]);
    list.rows.insert(list.rows.end(), row.begin(), row.end());
  };
  for (std::size_t part = 1; part < kArticulatedParts; ++part) add(pivot_of(part, size_m));
  add({2, 1, -0.85});    // a shadow beside the box
  add({1.1, 0.5, 1.2});  // beyond the last cell
  const std::vector<GaussianList> parts = divided(list, size_m);
  ASSERT_EQ(parts.size(), kArticulatedParts);
  for (std::size_t part = 0; part < parts.size(); ++part)
    EXPECT_EQ(parts[part].size(), part + 1 == parts.size() ? 2u : 1u) << part;
  EXPECT_FLOAT_EQ(parts[0].rows[kPositionRow], 2);
  for (std::size_t part = 1; part < kArticulatedParts; ++part)
    EXPECT_FLOAT_EQ(parts[part].rows[kPositionRow + 2],
                    static_cast<float>(pivot_of(part, size_m).z()));
  EXPECT_EQ(pivot_of(kMiddlePart, size_m), Eigen::Vector3d::Zero());
}

}  // namespace
}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
// Orders and choices of a ray table's pixels.
#include <set>
#include <utility>

#include <gtest/gtest.h>

#include "redrive/rays/ray_table.h"

namespace redrive {
namespace {

TEST(PixelSquares, HoldEachPixelOnceNextToItsNeighbours) {
  RayTable table;
  table.width = 37;
  table.height = 19;
  const auto reached = [](int x, int y) {
    return (x - 18) * (x - 18) + (y - 9) * (y - 9) < 130;
  };                                       // a fisheye's circle
  std::set<std::pair<int, int>> expected;  // squares with a pixel that is reached
  for (int y = 0; y < table.height; ++y)
    for (int x = 0; x < table.width; ++x)
      if (reached(x, y)) {
        table.pixel.push_back(y * table.width + x);
        expected.insert({x / 2, y / 2});
      }
  const PixelSquares squares = make_pixel_squares(table);
  EXPECT_EQ(std::set(squares.entry.begin(), squares.entry.end()).size(), table.pixel.size());
  ASSERT_EQ(squares.entry.size(), table.pixel.size());
  ASSERT_EQ(squares.first.front(), 0u);
  ASSERT_EQ(squares.first.back(), squares.entry.size());
  std::set<std::pair<int, int>> found;
  for (std::size_t s = 0; s + 1 < squares.first.size(); ++s) {
    ASSERT_LT(squares.first[s], squares.first[s + 1]);
    std::set<std::pair<int, int>> of_square;
    for (std::uint32_t i = squares.first[s]; i < squares.first[s + 1]; ++i) {
      const std::uint32_t pixel = table.pixel[squares.entry[i]];
      of_square.insert({pixel % table.width / 2, pixel / table.width / 2});
    }
    EXPECT_EQ(of_square.size(), 1u) << "square " << s;
    found.insert(*of_square.begin());
  }
  EXPECT_EQ(found, expected);
  EXPECT_EQ(squares.first.size() - 1, expected.size());
}

TEST(PixelSquares, AreEmptyForAnEmptyTable) {
  RayTable table;
  table.width = 5;
  table.height = 3;
  EXPECT_EQ(make_pixel_squares(table).first, std::vector<std::uint32_t>{0});
}

TEST(UsedPixels, FindsTheKthPixelInUse) {
  RayTable table{50, 7, {}, {}};
  std::vector<std::uint8_t> used(350, 0);
  for (std::uint32_t pixel = 0; pixel < 350; ++pixel)
    if (pixel % 5 != 0) table.pixel.push_back(pixel);  // 280: not a multiple of 64
  std::vector<std::size_t> expected;
  for (std::size_t k = 0; k < table.pixel.size(); ++k) {
    if (k / 64 == 2 || k % 3 == 1) continue;  // the third word is empty
    used[table.pixel[k]] = 255;
    expected.push_back(k);
  }
  used[0] = 255;  // no ray
  const UsedPixels pixels(table, used);
  ASSERT_EQ(pixels.size(), expected.size());
  for (std::size_t k = 0; k < expected.size(); ++k) EXPECT_EQ(pixels.entry(k), expected[k]) << k;
  EXPECT_EQ(UsedPixels(table, std::vector<std::uint8_t>(350, 0)).size(), 0u);
}

}  // namespace
}  // namespace redrive

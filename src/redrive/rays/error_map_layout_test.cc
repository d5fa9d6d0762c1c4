// SPDX-License-Identifier: Apache-2.0
#include "redrive/rays/error_map_layout.h"

#include <cmath>
#include <numeric>

#include <gtest/gtest.h>

#include "redrive/base/rng.h"

namespace redrive {
namespace {

ErrorMapLayout cells_of(int width, int height, float share = 1) {
  ErrorMapLayout cells;
  cells.add(width, height, std::vector<float>(std::size_t(width) * height, share));
  return cells;
}

TEST(ErrorMapLayout, TilesTheImagesInOrder) {
  ErrorMapLayout cells = cells_of(100, 70);           // side 4: 25 x 18, the last row 2 high
  cells.add(33, 65, std::vector<float>(33 * 65, 1));  // side 3: 11 x 22, the last row 2 high
  ASSERT_EQ(cells.size(), 25u * 18 + 11 * 22);
  std::vector<int> pixels(cells.size());
  for (const auto& [image, width, height] : {std::array{0, 100, 70}, std::array{1, 33, 65}})
    for (int y = 0; y < height; ++y)
      for (int x = 0; x < width; ++x) {
        const std::uint32_t cell = cells.at(image, y * width + x);
        ASSERT_LT(cell, cells.size());
        ++pixels[cell];
        const CellRect r = cells.rect(cell);
        ASSERT_EQ(r.image, image);
        ASSERT_TRUE(x >= r.x && x < r.x + r.width && y >= r.y && y < r.y + r.height);
      }
  for (std::size_t cell = 0; cell < cells.size(); ++cell)
    EXPECT_EQ(pixels[cell], cells.rect(cell).width * cells.rect(cell).height) << cell;
}

/// Returns the rate of cell 7 among `draws` samples.
double rate(const ErrorMapLayout& cells, const std::vector<float>& errors, int draws) {
  int drawn = 0;
  double pixels = 0, error = 0;
  for (int i = 0; i < draws; ++i) {
    const CellSample draw = sample_cell(cells.pixels(), errors, random_bits(kStreamTest, i));
    drawn += draw.cell == 7;
    pixels += draw.pixels;
    error += draw.error;
  }
  double mean = 0;  // cells of whole pixels
  for (const float of_cell : errors) mean += of_cell / errors.size();
  EXPECT_NEAR(error / pixels, mean + 1e-5, 0.05 * mean);
  return static_cast<double>(drawn) / draws;
}

/// Returns the expected rate of one of n cells whose weight is w times every other cell's: k of the
/// candidates are this cell with binomial probability, and it is then chosen with probability k w /
/// (k w + the weight of the others).
double expected_rate(double w, double n) {
  if (w == 0) return 0;
  double rate = 0;
  for (int k = 1; k <= kCellCandidates; ++k) {
    const double ways = std::exp(std::lgamma(kCellCandidates + 1) - std::lgamma(k + 1) -
                                 std::lgamma(kCellCandidates - k + 1));
    rate += ways * std::pow(1 / n, k) * std::pow(1 - 1 / n, kCellCandidates - k) * k * w /
            (k * w + kCellCandidates - k);
  }
  return rate;
}

TEST(ErrorMapLayout, SamplesByErrorUpToTheNumberOfCandidates) {
  const ErrorMapLayout cells = cells_of(64, 32);  // 512 cells of 2 x 2
  ASSERT_EQ(cells.size(), 512u);
  constexpr int kDraws = 400'000;
  double last = 0;
  for (const double w : {0.0, 0.5, 1.0, 2.0, 5.0, 1e4}) {
    std::vector<float> errors(512, 1e-2f);
    errors[7] = static_cast<float>(1e-2 * w);
    const double expected =
        w == 0 ? expected_rate(1e-3, 512) : expected_rate(w, 512);  // the floor is 1e-5
    EXPECT_NEAR(rate(cells, errors, kDraws), expected, 5 * std::sqrt(expected / kDraws)) << w;
    EXPECT_GT(expected, last);
    last = expected;
  }
  EXPECT_NEAR(expected_rate(1, 512), 1.0 / 512, 1e-12);
  EXPECT_LT(last, kCellCandidates / 512.0);
}

TEST(ErrorMapLayout, SamplesCellsInProportionToTheirPixels) {
  for (const float share : {0.25f, 0.0f}) {
    std::vector<float> shares(64 * 32, 1);
    for (const int pixel : {14, 15, 64 + 14, 64 + 15}) shares[pixel] = share;
    ErrorMapLayout cells;
    cells.add(64, 32, shares);
    constexpr int kDraws = 400'000;
    const double expected = expected_rate(share, 512);
    EXPECT_NEAR(rate(cells, std::vector<float>(512, 1e-2f), kDraws), expected,
                5 * std::sqrt(expected / kDraws));
  }
}

// Most candidates, out of 512 cells, have no pixel.
TEST(ErrorMapLayout, FindsTheOnlyCellWithAPixel) {
  std::vector<float> shares(64 * 32);
  shares[15] = 0.25f;
  ErrorMapLayout cells;
  cells.add(64, 32, shares);
  for (int i = 0; i < 1000; ++i) {
    const CellSample draw = sample_cell(cells.pixels(), std::vector<float>(512, 0.0f), i);
    ASSERT_EQ(draw.cell, 7u);
    ASSERT_NEAR(draw.error / draw.pixels, 1e-5f, 1e-11);
  }
}

// Two kinds of cells, many of each error: the weighted mean of any quantity over the rays of both
// strategies is its mean over all pixels.
TEST(ErrorMapLayout, BalanceHeuristicKeepsTheMean) {
  constexpr float kHigh = 3, kShare = 0.5f;
  constexpr double kCells = 512,
                   kHighCells =
                       8;  // few, so that the other candidates nearly all have the mean error
  const double mean = (kHighCells * kHigh + kCells - kHighCells) / kCells;
  const double often = expected_rate(kHigh, kCells) * kCells;
  const double density = 1 - kShare + kShare * often;  // relative to uniform sampling
  EXPECT_NEAR(balance_heuristic_weight(kHigh, static_cast<float>(mean), kShare) * density, 1, 0.05);
  EXPECT_EQ(balance_heuristic_weight(0.5f, 0.5f + 1e-5f, kShare), 1);
  EXPECT_NEAR(balance_heuristic_weight(1, 1e-9f, 0.75f), 1 / (0.25 + 0.75 * kCellCandidates), 1e-6);
  EXPECT_NEAR(balance_heuristic_weight(0, 1, 0.75f), 4, 1e-3);
}

TEST(ErrorMapLayout, ErrorsStartWithTheFirstRayAndAreSmoothed) {
  std::vector<float> errors(3, kInitialError);
  update_error_map(std::vector<std::uint32_t>{2, 0, 2}, std::vector<float>{0.5f, 7.0f, 0.25f},
                   errors);
  EXPECT_EQ(errors[0], 1) << "the largest error";
  EXPECT_EQ(errors[1], kInitialError);
  EXPECT_NEAR(errors[2], 0.5 - 0.2 * 0.25, 1e-7);
  for (int i = 0; i < 200; ++i)
    update_error_map(std::vector<std::uint32_t>{2}, std::vector<float>{0.125f}, errors);
  EXPECT_NEAR(errors[2], 0.125, 1e-6);
}

}  // namespace
}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
#include "redrive/report/svg.h"

#include <limits>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace redrive {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

TEST(Svg, CurvesLieWhereTheirNumbersAre) {
  // 560 x 300: 490 px by 246 px within the margins, 5 % of the range beyond each end of x and above y.
  const double nan = std::numeric_limits<double>::quiet_NaN();
  SvgPlot plot{"x & y", "y", {{{{0, 0}, {10, 1}, {nan, nan}, {5, 0.5}, {10, 0}}, "#123456", "key"}}, {}};
  plot.from_zero = true;
  const std::string svg = svg_plot(plot);
  // x: 56 + 490 (v + 0.5) / 11; y: 12 + 246 (1.05 - v) / 1.05.
  EXPECT_THAT(svg, HasSubstr("d=\"M78.273 258L523.73 23.714M301 140.86L523.73 258\""));
  EXPECT_THAT(svg, HasSubstr("#123456"));
  EXPECT_THAT(svg, HasSubstr(">key<"));
  EXPECT_THAT(svg, HasSubstr("x &amp; y"));
  EXPECT_THAT(svg, Not(HasSubstr("nan")));
}

TEST(Svg, ToScaleAUnitIsAsLongUpAsAcross) {
  SvgPlot plot{"", "", {{{{0, 0}, {10, 0}, {10, 2}}, "#000", ""}}, {}, true};
  // x has 11 units on 490 px; up 2 units are 2 * 490 / 11 = 89.09 px around the middle, 135.
  EXPECT_THAT(svg_plot(plot), HasSubstr("d=\"M78.273 179.55L523.73 179.55L523.73 90.455\""));
}

TEST(Svg, NothingToDrawIsAnEmptyPlot) { EXPECT_THAT(svg_plot({}), HasSubstr("</svg>")); }

}  // namespace
}  // namespace redrive

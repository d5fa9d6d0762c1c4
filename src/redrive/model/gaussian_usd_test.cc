// SPDX-License-Identifier: Apache-2.0
// The text read back by the schema's rules: names, types, lengths of the arrays.
#include "redrive/model/gaussian_usd.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/field/splat_numbers.h"
#include "redrive/model/gaussians_testing.h"

namespace redrive {
namespace {

using ::testing::HasSubstr;
using ::testing::StartsWith;

/// The numbers of "TYPE NAME = [...]".
std::vector<double> array_of(const std::string& text, const std::string& declaration) {
  const std::size_t begin = text.find("        " + declaration + " = [");
  EXPECT_NE(begin, std::string::npos) << declaration;
  if (begin == std::string::npos) return {};
  std::vector<double> numbers;
  const char* at = text.data() + text.find('[', text.find(" = ", begin)) + 1;
  for (; *at != ']'; ++at) {
    if (*at == '(' || *at == ')' || *at == ',' || *at == ' ') continue;
    char* end = nullptr;
    numbers.push_back(std::strtod(at, &end));
    if (end == at) return {};
    at = end - 1;
  }
  return numbers;
}

TEST(Usd, HasTheNumbersOfTheGaussians) {
  constexpr std::size_t n = 37;
  const std::vector<float> storage = gaussians_of_test(n, 20);
  kernels::Gaussians gaussians;
  gaussians.n = n;
  gaussians.numbers = storage;
  for (const std::size_t degree : {0, 1}) {
    const std::string text = gaussian_usd(gaussians, static_cast<int>(degree));
    EXPECT_THAT(text, StartsWith("#usda 1.0\n"));
    for (const char* const part : {"defaultPrim = \"World\"", "metersPerUnit = 1", "upAxis = \"Z\"",
                                   "def ParticleField3DGaussianSplat \"Gaussians\""})
      EXPECT_THAT(text, HasSubstr(part));
    for (const char* const pair : {"{}", "()", "[]"})
      EXPECT_EQ(std::ranges::count(text, pair[0]), std::ranges::count(text, pair[1]));
    const std::size_t of_each = (degree + 1) * (degree + 1);
    EXPECT_THAT(text, HasSubstr("uniform int radiance:sphericalHarmonicsDegree = " +
                                std::to_string(degree) + "\n"));
    EXPECT_THAT(text, HasSubstr("elementSize = " + std::to_string(of_each) + "\n"));
    const std::vector<double> positions = array_of(text, "point3f[] positions"),
                              turns = array_of(text, "quatf[] orientations"),
                              scales = array_of(text, "float3[] scales"),
                              opacities = array_of(text, "float[] opacities"),
                              extent = array_of(text, "float3[] extent"),
                              colours = array_of(
                                  text, "float3[] radiance:sphericalHarmonicsCoefficients");
    ASSERT_EQ(positions.size(), 3 * n);
    ASSERT_EQ(turns.size(), 4 * n);
    ASSERT_EQ(scales.size(), 3 * n);
    ASSERT_EQ(opacities.size(), n);
    ASSERT_EQ(colours.size(), 3 * n * of_each);
    ASSERT_EQ(extent.size(), 6u);
    const auto near = [](double is, double expected) {
      EXPECT_NEAR(is, expected, 6e-4 * std::abs(expected) + 1e-9) << "4 digits";
    };
    for (std::size_t i = 0; i < n; ++i) {
      const SplatNumbers of = splat_numbers(storage, i);
      near(opacities[i], 1 / (1 + std::exp(-of.opacity)));
      for (int k = 0; k < 4; ++k) near(turns[4 * i + k], of.quaternion[k]);
      for (int k = 0; k < 3; ++k) {
        EXPECT_NEAR(positions[3 * i + k], of.position[k], 5.1e-5);
        near(scales[3 * i + k], std::exp(of.log_scale[k]));
        EXPECT_LT(extent[k], of.position[k]);
        EXPECT_GT(extent[3 + k], of.position[k]);
        near(colours[3 * of_each * i + k], of.dc[k]);
        for (int j = 0; degree > 0 && j < 3; ++j)
          near(colours[3 * (of_each * i + 1 + j) + k], of.rest[k][j]);
      }
    }
  }
}

}  // namespace
}  // namespace redrive

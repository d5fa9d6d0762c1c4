// SPDX-License-Identifier: Apache-2.0
#include "redrive/model/gaussian_usd.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <limits>
#include <span>

#include "redrive/base/error.h"
#include "redrive/field/splat_numbers.h"

namespace redrive {
namespace {

constexpr int kHalfDigits = 4;

void append(double number, std::chars_format format, int digits, std::string* text) {
  char buffer[64];
  const auto end = std::to_chars(buffer, buffer + sizeof buffer, number, format, digits).ptr;
  text->append(buffer, end);
}

/// Appends "(a, b, c)".
void append_tuple(std::span<const double> numbers, std::string* text,
                  std::chars_format format = std::chars_format::general, int digits = kHalfDigits) {
  *text += '(';
  for (std::size_t i = 0; i < numbers.size(); ++i) {
    if (i > 0) *text += ", ";
    append(numbers[i], format, digits, text);
  }
  *text += ')';
}

/// Appends an attribute whose values `write` appends, one call for each Gaussian.
template <class Write>
void append_array(const char* declaration, const kernels::Gaussians& gaussians, std::string* text,
                  const Write& write) {
  *text += std::string("        ") + declaration + " = [";
  for (std::size_t i = 0; i < gaussians.n; ++i) {
    if (i > 0) *text += ", ";
    write(splat_numbers(gaussians.numbers, i));
  }
  *text += "]";
}

std::array<double, 3> scales_of(const SplatNumbers& of) {
  return {std::exp(of.log_scale[0]), std::exp(of.log_scale[1]), std::exp(of.log_scale[2])};
}

void append_extent(const kernels::Gaussians& gaussians, std::string* text) {
  constexpr double kSigmas = 3, kInfinity = std::numeric_limits<double>::infinity();
  std::array<double, 3> low, high;
  low.fill(gaussians.n > 0 ? kInfinity : 0);
  high.fill(gaussians.n > 0 ? -kInfinity : 0);
  for (std::size_t i = 0; i < gaussians.n; ++i) {
    const SplatNumbers of = splat_numbers(gaussians.numbers, i);
    const double reach = kSigmas * std::ranges::max(scales_of(of));
    for (int k = 0; k < 3; ++k) {
      low[k] = std::min(low[k], of.position[k] - reach);
      high[k] = std::max(high[k], of.position[k] + reach);
    }
  }
  *text += "        float3[] extent = [";
  append_tuple(low, text);
  *text += ", ";
  append_tuple(high, text);
  *text += "]\n";
}

}  // namespace

std::string gaussian_usd(const kernels::Gaussians& gaussians, int sh_degree) {
  REDRIVE_CHECK_OP(sh_degree, >=, 0);
  REDRIVE_CHECK_OP(sh_degree, <=, 1);
  std::string text = R"(#usda 1.0
(
    defaultPrim = "World"
    doc = "redrive"
    metersPerUnit = 1
    upAxis = "Z"
)

def Xform "World"
{
    def ParticleField3DGaussianSplat "Gaussians"
    {
)";
  append_extent(gaussians, &text);
  constexpr int kTenthsOfMillimetres = 4;
  append_array("point3f[] positions", gaussians, &text, [&](const SplatNumbers& of) {
    append_tuple(of.position, &text, std::chars_format::fixed, kTenthsOfMillimetres);
  });
  text += "\n";
  append_array("quatf[] orientations", gaussians, &text,
               [&](const SplatNumbers& of) { append_tuple(of.quaternion, &text); });
  text += "\n";
  append_array("float3[] scales", gaussians, &text,
               [&](const SplatNumbers& of) { append_tuple(scales_of(of), &text); });
  text += "\n";
  append_array("float[] opacities", gaussians, &text, [&](const SplatNumbers& of) {
    append(1 / (1 + std::exp(-of.opacity)), std::chars_format::general, kHalfDigits, &text);
  });
  text += "\n        uniform int radiance:sphericalHarmonicsDegree = " + std::to_string(sh_degree) +
          "\n";
  append_array("float3[] radiance:sphericalHarmonicsCoefficients", gaussians, &text,
               [&](const SplatNumbers& of) {
                 append_tuple(of.dc, &text);
                 for (int j = 0; sh_degree > 0 && j < 3; ++j) {
                   text += ", ";
                   append_tuple(std::array{of.rest[0][j], of.rest[1][j], of.rest[2][j]}, &text);
                 }
               });
  text += " (\n            elementSize = " + std::to_string((sh_degree + 1) * (sh_degree + 1)) +
          "\n            interpolation = \"vertex\"\n        )\n";
  text += R"(        uniform token projectionModeHint = "perspective"
        uniform token sortingModeHint = "cameraDistance"
    }
}
)";
  return text;
}

}  // namespace redrive

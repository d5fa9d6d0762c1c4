// SPDX-License-Identifier: Apache-2.0
#include "redrive/model/gaussian_ply.h"

#include <bit>
#include <cmath>
#include <cstring>
#include <vector>

#include "redrive/base/error.h"
#include "redrive/field/spherical_harmonics.h"

namespace redrive {
namespace {

static_assert(std::endian::native == std::endian::little, "as the file");

constexpr int kRestCoefficients = 3;  // of degree 1, a channel

std::string ply_header(std::size_t n, int sh_degree) {
  std::string text =
      "ply\nformat binary_little_endian 1.0\nelement vertex " + std::to_string(n) + "\n";
  const auto property = [&](const std::string& name) { text += "property float " + name + "\n"; };
  const auto properties = [&](const std::string& prefix, int count) {
    for (int i = 0; i < count; ++i) property(prefix + std::to_string(i));
  };
  for (const char* name : {"x", "y", "z", "nx", "ny", "nz"}) property(name);
  properties("f_dc_", 3);
  if (sh_degree > 0) properties("f_rest_", 3 * kRestCoefficients);
  property("opacity");
  properties("scale_", 3);
  properties("rot_", 4);
  return text + "end_header\n";
}

}  // namespace

std::string gaussian_ply(const kernels::Gaussians& gaussians, int sh_degree) {
  REDRIVE_CHECK_OP(sh_degree, >=, 0);
  REDRIVE_CHECK_OP(sh_degree, <=, 1);
  // In this direction each function of degree 1 is its factor of y, z or x.
  constexpr double kAllOnes[3] = {1, 1, 1};
  constexpr int kAxis[kRestCoefficients] = {1, 2, 0};
  double factor[kHarmonics];
  spherical_harmonics(kAllOnes, factor);

  std::vector<float> rows;
  for (std::size_t i = 0; i < gaussians.n; ++i) {
    const auto at = [&](int row) { return gaussians.numbers[gaussian_slot(i, row)]; };
    const auto add = [&](double number) { rows.push_back(static_cast<float>(number)); };
    for (int k = 0; k < 3; ++k) add(at(kPositionRow + k));
    for (int k = 0; k < 3; ++k) add(0);
    for (int c = 0; c < 3; ++c) add((at(kColourRow + c) - 0.5) / factor[0]);
    for (int c = 0; sh_degree > 0 && c < 3; ++c)
      for (int j = 0; j < kRestCoefficients; ++j)
        add(at(kHarmonicsRow + 3 * kAxis[j] + c) / factor[1 + j]);
    add(at(kOpacityRow));
    for (int k = 0; k < 3; ++k) add(at(kLogScaleRow + k));
    double norm2 = 0;
    for (int k = 0; k < 4; ++k) norm2 += double(at(kQuaternionRow + k)) * at(kQuaternionRow + k);
    for (int k = 0; k < 4; ++k) add(at(kQuaternionRow + k) / std::sqrt(norm2));
  }
  std::string bytes = ply_header(gaussians.n, sh_degree);
  const std::size_t header = bytes.size();
  bytes.resize(header + rows.size() * sizeof(float));
  std::memcpy(bytes.data() + header, rows.data(), rows.size() * sizeof(float));
  return bytes;
}

}  // namespace redrive

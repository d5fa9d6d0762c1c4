// SPDX-License-Identifier: Apache-2.0
#include "redrive/model/gaussian_ply.h"

#include <array>
#include <bit>
#include <cstring>
#include <vector>

#include "redrive/base/error.h"
#include "redrive/field/splat_numbers.h"

namespace redrive {
namespace {

static_assert(std::endian::native == std::endian::little, "as the file");

constexpr int kRestCoefficients = 3;  // coefficients of degree 1 in each channel

std::string ply_header(std::size_t n, int sh_degree, std::span<const std::string> comments) {
  std::string text = "ply\nformat binary_little_endian 1.0\n";
  for (const std::string& comment : comments) text += "comment " + comment + "\n";
  text += "element vertex " + std::to_string(n) + "\n";
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

std::string gaussian_ply(const kernels::Gaussians& gaussians, int sh_degree,
                         std::span<const std::string> comments) {
  REDRIVE_CHECK_OP(sh_degree, >=, 0);
  REDRIVE_CHECK_OP(sh_degree, <=, 1);
  std::vector<float> rows;
  for (std::size_t i = 0; i < gaussians.n; ++i) {
    const SplatNumbers numbers = splat_numbers(gaussians.numbers, i);
    const auto add = [&](const auto& some) {
      for (const double number : some) rows.push_back(static_cast<float>(number));
    };
    add(numbers.position);
    add(std::array<double, 3>{});
    add(numbers.dc);
    for (int c = 0; sh_degree > 0 && c < 3; ++c) add(numbers.rest[c]);
    add(std::array{numbers.opacity});
    add(numbers.log_scale);
    add(numbers.quaternion);
  }
  std::string bytes = ply_header(gaussians.n, sh_degree, comments);
  const std::size_t header = bytes.size();
  bytes.resize(header + rows.size() * sizeof(float));
  std::memcpy(bytes.data() + header, rows.data(), rows.size() * sizeof(float));
  return bytes;
}

}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/actor_body.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <sstream>

#include "redrive/base/files.h"
#include "redrive/field/gaussian_blocks.h"
#include "redrive/field/splat_numbers.h"
#include "redrive/recording/ply_vertices.h"

namespace redrive {
namespace {

constexpr std::size_t kMaxBodyGaussians = 1'000'000;
constexpr double kMaxBody_m = 100;  // of a mean from the origin, and of a side of the box
constexpr double kMaxNumber = 1e6;  // of colours and quaternions
constexpr double kMaxLogScale = 5;  // 150 m; less than -20 is nothing
constexpr double kMostOpaque = 15;  // logit
constexpr double kWithinSize = 0.98;
constexpr std::string_view kClassComment = "redrive class ", kSizeComment = "redrive size_m ";

/// Columns of the properties, in the order of property_names().
enum Column { kX, kDc = 3, kOpacity = 6, kScale, kRotation = 10, kRest = 14 };

/// Returns the properties to read; those of f_rest, if any, are the coefficients of degree 1.
std::vector<std::string> property_names(const PlyVertices& ply) {
  std::vector<std::string> names = {"x",      "y",       "z",       "f_dc_0",  "f_dc_1",
                                    "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2",
                                    "rot_0",  "rot_1",   "rot_2",   "rot_3"};
  int rest = 0;
  while (rest <= 45 && ply.has("f_rest_" + std::to_string(rest))) ++rest;
  if (rest != 0 && rest != 9 && rest != 24 && rest != 45)
    ply.fail("property f_rest", std::to_string(rest),
             "must be 0, 9, 24 or 45 of them: harmonics of degree 0 to 3");
  for (int c = 0; rest > 0 && c < 3; ++c)
    for (int j = 0; j < 3; ++j) names.push_back("f_rest_" + std::to_string(c * rest / 3 + j));
  return names;
}

SplatNumbers numbers_of(std::span<const double> values) {
  SplatNumbers out{};
  for (std::size_t k = 0; k < 3; ++k) {
    out.position[k] = values[kX + k];
    out.dc[k] = values[kDc + k];
    out.log_scale[k] = std::max(values[kScale + k], -20.0);
    for (std::size_t j = 0; values.size() > kRest && j < 3; ++j)
      out.rest[k][j] = values[kRest + 3 * k + j];
  }
  for (std::size_t k = 0; k < 4; ++k) out.quaternion[k] = values[kRotation + k];
  out.opacity = std::clamp(values[kOpacity], -kMostOpaque, kMostOpaque);
  return out;
}

/// Fails unless a Gaussian with these numbers can be drawn.
void check(const PlyVertices& ply, std::size_t index, std::span<const std::string> names,
           std::span<const double> values) {
  const auto fail = [&](const std::string& name, double value, const std::string& rule) {
    ply.fail("vertex " + std::to_string(index) + " " + name, std::to_string(value), rule);
  };
  for (std::size_t k = 0; k < values.size(); ++k) {
    if (k < kDc && !(std::abs(values[k]) <= kMaxBody_m))
      fail(names[k], values[k], "must be metres from the centre of the box, at most 100");
    if (k >= kScale && k < kRotation && !(std::isfinite(values[k]) && values[k] <= kMaxLogScale))
      fail(names[k], values[k], "must be the logarithm of metres, at most 5");
    if (!(std::abs(values[k]) <= kMaxNumber)) fail(names[k], values[k], "must be at most 1e6");
  }
  const auto q = values.subspan(kRotation, 4);
  if (!(std::hypot(std::hypot(q[0], q[1]), std::hypot(q[2], q[3])) > 1e-6))
    fail("rot_0", q[0], "must be a quaternion that is not 0");
}

/// Twice what kWithinSize of the means keep of the origin along each axis.
Eigen::Vector3d measured_size(const ActorBody& body) {
  Eigen::Vector3d size_m;
  for (int k = 0; k < 3; ++k) {
    std::vector<float> off(body.n);
    for (std::size_t i = 0; i < body.n; ++i)
      off[i] = std::abs(body.numbers[gaussian_slot(i, kPositionRow + k)]);
    const auto at =
        off.begin() + static_cast<std::ptrdiff_t>(kWithinSize * static_cast<double>(body.n - 1));
    std::ranges::nth_element(off, at);
    size_m[k] = std::max(2.0 * double(*at), 0.01);
  }
  return size_m;
}

}  // namespace

std::vector<std::string> body_comments(const std::string& type, const Eigen::Vector3d& size_m) {
  std::string name;
  for (const char c : type) name += static_cast<unsigned char>(c) < ' ' ? '_' : c;
  std::ostringstream size;
  size << kSizeComment << size_m.x() << ' ' << size_m.y() << ' ' << size_m.z();
  return {std::string(kClassComment) + name, size.str()};
}

ActorBody parse_actor_body(std::string_view bytes, const std::filesystem::path& file) {
  PlyVertices ply(bytes, file, kMaxBodyGaussians);
  if (ply.size() == 0) ply.fail("element vertex", "0", "must be Gaussians, 1 at least");
  ActorBody body;
  body.n = ply.size();
  const std::vector<std::string> names = property_names(ply);
  body.numbers = Buffer<float>(gaussian_blocks(body.n) * kBlockSize);
  ply.read(names, [&](std::size_t index, std::span<const double> values) {
    check(ply, index, names, values);
    constexpr double kDistance_m = 1;  // it does not train
    set_splat_numbers(numbers_of(values), kDistance_m, index, body.numbers);
  });
  clear_unused(body.n, gaussian_blocks(body.n) * kGaussianBlock, body.numbers.data());
  for (const std::string& comment : ply.comments()) {
    if (comment.starts_with(kClassComment)) body.type = comment.substr(kClassComment.size());
    if (!comment.starts_with(kSizeComment)) continue;
    std::istringstream numbers(comment.substr(kSizeComment.size()));
    numbers >> body.size_m.x() >> body.size_m.y() >> body.size_m.z();
    if (!numbers || !(body.size_m.minCoeff() > 0 && body.size_m.maxCoeff() <= 2 * kMaxBody_m))
      ply.fail("comment", comment, "must be three metres above 0, at most 200");
  }
  if (body.size_m.isZero()) body.size_m = measured_size(body);
  return body;
}

ActorBody read_actor_body(const std::filesystem::path& file) {
  return parse_actor_body(read_file(file), file);
}

}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
#include "redrive/edit/actor_body.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <sstream>
#include <system_error>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/files/gzip.h"
#include "redrive/field/gaussian_blocks.h"
#include "redrive/field/splat_numbers.h"
#include "redrive/recording/lidar/ply_vertices.h"

namespace redrive {
namespace {

constexpr std::size_t kMaxBodyGaussians = 1'000'000;
// largest distance of a mean from the origin, and largest side of the box
constexpr double kMaxBody_m = 100;
constexpr double kMaxNumber = 1e6;  // bound of colours and quaternions
constexpr double kMaxLogScale = 5;  // 150 m; less than -20 is nothing
constexpr double kMostOpaque = 15;  // logit
constexpr double kWithinSize = 0.98;
constexpr double kDistance_m = 1;  // value of kDistanceRow: it does not train
constexpr const char* kPositionRule = "must be metres from the centre of the box, at most 100";
constexpr const char* kScaleRule = "must be the logarithm of metres, at most 5";
constexpr std::string_view kClassComment = "redrive class ", kSizeComment = "redrive size_m ";

/// Columns of the properties, in the order of property_names().
enum Column { kX, kDc = 3, kOpacity = 6, kScale, kRotation = 10, kRest = 14 };

/// Returns the properties to read; if there are any f_rest, they are the coefficients of degree 1.
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

/// Fails if a Gaussian with these numbers cannot be drawn.
void check(const PlyVertices& ply, std::size_t index, std::span<const std::string> names,
           std::span<const double> values) {
  const auto fail = [&](const std::string& name, double value, const std::string& rule) {
    ply.fail("vertex " + std::to_string(index) + " " + name, std::to_string(value), rule);
  };
  for (std::size_t k = 0; k < values.size(); ++k) {
    if (k < kDc && !(std::abs(values[k]) <= kMaxBody_m)) fail(names[k], values[k], kPositionRule);
    if (k >= kScale && k < kRotation && !(std::isfinite(values[k]) && values[k] <= kMaxLogScale))
      fail(names[k], values[k], kScaleRule);
    if (!(std::abs(values[k]) <= kMaxNumber)) fail(names[k], values[k], "must be at most 1e6");
  }
  const auto q = values.subspan(kRotation, 4);
  if (!(std::hypot(std::hypot(q[0], q[1]), std::hypot(q[2], q[3])) > 1e-6))
    fail("rot_0", q[0], "must be a quaternion that is not 0");
}

/// Twice the range that holds kWithinSize of the means along each axis, from the origin.
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

/// Completes a body whose Gaussians are written.
void finish(ActorBody* body) {
  clear_unused(body->n, gaussian_blocks(body->n) * kGaussianBlock, body->numbers.data());
  if (body->size_m.isZero()) body->size_m = measured_size(*body);
}

ActorBody parse_ply(std::string_view bytes, const std::filesystem::path& file) {
  PlyVertices ply(bytes, file, kMaxBodyGaussians);
  if (ply.size() == 0) ply.fail("element vertex", "0", "must be Gaussians, 1 at least");
  ActorBody body;
  body.n = ply.size();
  const std::vector<std::string> names = property_names(ply);
  body.numbers = Buffer<float>(gaussian_blocks(body.n) * kBlockSize);
  ply.read(names, [&](std::size_t index, std::span<const double> values) {
    check(ply, index, names, values);
    set_splat_numbers(numbers_of(values), kDistance_m, index, body.numbers);
  });
  for (const std::string& comment : ply.comments()) {
    if (comment.starts_with(kClassComment)) body.type = comment.substr(kClassComment.size());
    if (!comment.starts_with(kSizeComment)) continue;
    std::istringstream numbers(comment.substr(kSizeComment.size()));
    numbers >> body.size_m.x() >> body.size_m.y() >> body.size_m.z();
    if (!numbers || !(body.size_m.minCoeff() > 0 && body.size_m.maxCoeff() <= 2 * kMaxBody_m))
      ply.fail("comment", comment, "must be three metres above 0, at most 200");
  }
  finish(&body);
  return body;
}

/// The bytes of an SPZ, decompressed: numbers of one kind after the other.
struct Spz {
  /// bytes of the header; bytes of a Gaussian, at most
  static constexpr std::size_t kHeader = 16, kMostBytes = 65;
  std::string bytes;
  std::uint32_t version = 0, n = 0;
  int bits = 0;               ///< fractional bits of positions
  std::size_t harmonics = 0;  ///< coefficients in each channel

  std::uint32_t at(std::size_t offset, std::size_t count) const {
    std::uint32_t number = 0;
    for (std::size_t i = count; i-- > 0;)
      number = number << 8 | static_cast<unsigned char>(bytes[offset + i]);
    return number;
  }
  std::size_t rotation_bytes() const { return version == 2 ? 3 : 4; }
  std::size_t body_bytes() const { return 16 + rotation_bytes() + 3 * harmonics; }
};

Spz read_spz(std::string_view file_bytes, const std::filesystem::path& file) {
  const auto fail = [&](const std::string& field, std::size_t value, const std::string& rule) {
    throw InputError(file, field, std::to_string(value), rule);
  };
  auto bytes = gunzip_at_most(Spz::kHeader + Spz::kMostBytes * kMaxBodyGaussians, file_bytes);
  if (!bytes)
    throw InputError(file, "gzip", "",
                     "is damaged, cut, or holds more than 1000000 Gaussians (SPZ)");
  Spz spz;
  spz.bytes = *std::move(bytes);
  if (spz.bytes.size() < Spz::kHeader || !spz.bytes.starts_with("NGSP"))
    fail("bytes", spz.bytes.size(), "must begin with the 16 bytes of an SPZ's header");
  spz.version = spz.at(4, 4);
  if (spz.version != 2 && spz.version != 3) fail("version", spz.version, "must be 2 or 3");
  spz.n = spz.at(8, 4);
  if (spz.n < 1 || spz.n > kMaxBodyGaussians) fail("number of Gaussians", spz.n, "1 to 1000000");
  const std::uint32_t degree = spz.at(12, 1);
  if (degree > 3) fail("degree of the harmonics", degree, "must be 0 to 3");
  spz.harmonics = degree * (degree + 2);
  spz.bits = static_cast<int>(spz.at(13, 1));
  if (spz.bits > 23) fail("fractional bits", spz.at(13, 1), "must be 0 to 23");
  if (const std::size_t size = Spz::kHeader + spz.n * spz.body_bytes(); spz.bytes.size() != size)
    fail("bytes", spz.bytes.size(), "must be " + std::to_string(size) + " by the header");
  return spz;
}

/// Returns w x y z.
std::array<double, 4> quaternion_of(const Spz& spz, std::size_t at) {
  std::array<double, 4> xyzw{};
  std::size_t largest = 3;
  double rest2 = 1;
  const auto set = [&](std::size_t k, double value) {
    xyzw[k] = value;
    rest2 -= value * value;
  };
  if (spz.version == 2) {
    for (std::size_t k = 0; k < 3; ++k) set(k, (spz.at(at + k, 1) - 127.5) / 127.5);
  } else {
    std::uint32_t packed = spz.at(at, 4);
    largest = packed >> 30;
    for (std::size_t k = 4; k-- > 0;) {
      if (k == largest) continue;
      set(k, (packed & 512 ? -1 : 1) * std::sqrt(0.5) * (packed & 511) / 511.0);
      packed >>= 10;
    }
  }
  xyzw[largest] = std::sqrt(std::max(rest2, 0.0));
  return {xyzw[3], xyzw[0], xyzw[1], xyzw[2]};
}

ActorBody parse_spz(std::string_view file_bytes, const std::filesystem::path& file) {
  const Spz spz = read_spz(file_bytes, file);
  ActorBody body;
  body.n = spz.n;
  body.numbers = Buffer<float>(gaussian_blocks(body.n) * kBlockSize);
  const std::size_t opacity = Spz::kHeader + 9 * body.n, colour = opacity + body.n,
                    scale = colour + 3 * body.n, rotation = scale + 3 * body.n,
                    rest = rotation + spz.rotation_bytes() * body.n;
  for (std::size_t i = 0; i < body.n; ++i) {
    const auto fail = [&](const std::string& name, double value, const std::string& rule) {
      throw InputError(file, "Gaussian " + std::to_string(i) + " " + name, std::to_string(value),
                       rule);
    };
    SplatNumbers numbers{};
    for (std::size_t k = 0; k < 3; ++k) {
      const auto fixed = static_cast<std::int32_t>(spz.at(Spz::kHeader + 9 * i + 3 * k, 3) << 8);
      numbers.position[k] = std::ldexp(fixed, -spz.bits - 8);
      if (std::abs(numbers.position[k]) > kMaxBody_m)
        fail("position", numbers.position[k], kPositionRule);
      numbers.dc[k] = (spz.at(colour + 3 * i + k, 1) / 255.0 - 0.5) / 0.15;
      numbers.log_scale[k] = spz.at(scale + 3 * i + k, 1) / 16.0 - 10;
      if (numbers.log_scale[k] > kMaxLogScale) fail("scale", numbers.log_scale[k], kScaleRule);
      for (std::size_t j = 0; spz.harmonics > 0 && j < 3; ++j)
        numbers.rest[k][j] = (spz.at(rest + 3 * (spz.harmonics * i + j) + k, 1) - 128.0) / 128;
    }
    const double share = spz.at(opacity + i, 1) / 255.0;
    numbers.opacity = std::clamp(std::log(share / (1 - share)), -kMostOpaque, kMostOpaque);
    numbers.quaternion = quaternion_of(spz, rotation + spz.rotation_bytes() * i);
    set_splat_numbers(numbers, kDistance_m, i, body.numbers);
  }
  finish(&body);
  return body;
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
  return bytes.starts_with("\x1f\x8b") ? parse_spz(bytes, file) : parse_ply(bytes, file);
}

ActorBody read_actor_body(const std::filesystem::path& file) {
  return parse_actor_body(read_file(file, kMaxDataBytes), file);
}

std::shared_ptr<const ActorBody> ActorBodies::read(const std::filesystem::path& file) {
  std::error_code missing;  // a missing file is an error of reading it
  const auto written = std::filesystem::last_write_time(file, missing);
  Known& known = known_[file];
  if (!known.body || missing || known.written != written)
    known = {written, std::make_shared<const ActorBody>(read_actor_body(file))};
  return known.body;
}

}  // namespace redrive

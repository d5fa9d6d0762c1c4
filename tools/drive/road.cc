// SPDX-License-Identifier: Apache-2.0
#include "tools/drive/road.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "redrive/base/error.h"
#include "redrive/base/rng.h"
#include "tools/drive/streams.h"

namespace redrive::drive {
namespace {

constexpr double kTwoPi = 2 * std::numbers::pi;

}  // namespace

Road::Road(unsigned seed, double first_m, double last_m, double loop_m)
    : first_(std::lround(std::floor(first_m))),
      last_(std::lround(std::ceil(last_m))),
      loop_m_(loop_m),
      turns_{{0.6, 523.7, 0}, {0.25, 227.3, 0}, {0.05, 89.1, 0}},
      hills_{{1.2, 311.9, 0}, {0.4, 137.7, 0}} {
  // Headings that are the opposite half a loop later: waves of even parts of it.
  if (loop_m > 0) {
    turns_ = {{0.25, loop_m / 2, 0}, {0.1, loop_m / 4, 0}};
    hills_ = {{0.8, loop_m, 0}, {0.3, loop_m / 3, 0}};
  }
  REDRIVE_CHECK(first_ <= 0 && last_ >= 0);
  const std::uint64_t key = random_key(seed, kStreamRoad);
  std::uint64_t drawn = 0;
  for (std::vector<Wave>* waves : {&turns_, &hills_})
    for (Wave& wave : *waves) wave.phase = kTwoPi * random_unit(key, drawn++);
  const auto before = static_cast<std::size_t>(-first_), n = before + std::size_t(last_) + 1;
  knots_.assign(n, {Eigen::Vector2d::Zero(), Eigen::Vector2d::Zero()});
  const auto at = [this](std::size_t i) {
    return static_cast<double>(first_ + static_cast<long>(i));
  };
  for (std::size_t i = before; i + 1 < n; ++i)
    knots_[i + 1].centre = knots_[i].centre + step(at(i), at(i + 1));
  for (std::size_t i = before; i > 0; --i)
    knots_[i - 1].centre = knots_[i].centre + step(at(i), at(i - 1));
  for (std::size_t i = 0; i < n; ++i) {
    const double heading = heading_rad(at(i));
    knots_[i].ahead = {std::cos(heading), std::sin(heading)};
  }
}

double Road::heading_rad(double s) const {
  double sum = loop_m_ > 0 ? kTwoPi * s / loop_m_ : 0;
  for (const Wave& wave : turns_)
    sum += wave.amplitude * std::sin(kTwoPi * s / wave.period_m + wave.phase);
  return sum;
}

double Road::height_m(double s) const {
  double sum = 0;
  for (const Wave& wave : hills_)
    sum += wave.amplitude * std::sin(kTwoPi * s / wave.period_m + wave.phase);
  return sum;
}

double Road::slope(double s) const {
  double sum = 0;
  for (const Wave& wave : hills_)
    sum +=
        wave.amplitude * kTwoPi / wave.period_m * std::cos(kTwoPi * s / wave.period_m + wave.phase);
  return sum;
}

/// Displacement of the centre line over at most 1 m by Simpson's rule, exact to 1e-9 m.
Eigen::Vector2d Road::step(double from, double to) const {
  const double a = heading_rad(from), m = heading_rad((from + to) / 2), b = heading_rad(to);
  return (to - from) / 6 *
         Eigen::Vector2d(std::cos(a) + 4 * std::cos(m) + std::cos(b),
                         std::sin(a) + 4 * std::sin(m) + std::sin(b));
}

Eigen::Vector3d Road::position(double s, double t, double z) const {
  const double clamped = std::clamp(s, first_m(), last_m());
  const long before = std::lround(std::floor(clamped));
  const Eigen::Vector2d centre = knot(before).centre + step(static_cast<double>(before), clamped);
  const double heading = heading_rad(clamped);
  return {centre.x() - t * std::sin(heading), centre.y() + t * std::cos(heading),
          height_m(clamped) + z};
}

}  // namespace redrive::drive

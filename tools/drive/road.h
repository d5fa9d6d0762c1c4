// SPDX-License-Identifier: Apache-2.0
// The road of a made drive: a curve of any length whose heading and height are sums of sines with
// incommensurate periods, so that it never repeats. World axes: x is the road's mean direction, y
// left, z up, metres; s = 0 is the origin. Curves have radii of 57 m and more, slopes are at most
// 4 %.
#pragma once

#include <cstddef>
#include <vector>

#include <Eigen/Core>

namespace redrive::drive {

// The cross-section, metres to either side of the centre line.
constexpr double kLaneEdge_m = 3.2;      ///< edge of the two lanes; parking bays beyond
constexpr double kKerb_m = 5.4;          ///< pavement beyond
constexpr double kPavementEdge_m = 9.0;  ///< houses beyond
constexpr double kVergeEdge_m = 36;
constexpr double kKerbHeight_m = 0.12;

class Road {
 public:
  /// Covers first_m <= s <= last_m, with first_m <= 0 <= last_m. The part that two roads of a seed
  /// have in common is the same. loop_m: 0, or a multiple of 3 after which the road meets itself.
  Road(unsigned seed, double first_m, double last_m, double loop_m = 0);

  double first_m() const { return static_cast<double>(first_); }
  double last_m() const { return static_cast<double>(last_); }
  double loop_m() const { return loop_m_; }
  double heading_rad(double s) const;  ///< from x towards y
  double height_m(double s) const;
  double slope(double s) const;  ///< derivative of the height by s
  /// The point of the road t metres left of the centre line and z metres above the road there.
  Eigen::Vector3d position(double s, double t = 0, double z = 0) const;

  /// The centre line and the direction of the road at a whole metre.
  struct Knot {
    Eigen::Vector2d centre, ahead;
  };
  const Knot& knot(long s) const { return knots_[static_cast<std::size_t>(s - first_)]; }

 private:
  struct Wave {
    double amplitude, period_m, phase;
  };
  Eigen::Vector2d step(double from, double to) const;

  long first_, last_;
  double loop_m_;
  std::vector<Wave> turns_, hills_;
  std::vector<Knot> knots_;
};

}  // namespace redrive::drive

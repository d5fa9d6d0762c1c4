// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/bundle/fit_way.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include <Eigen/QR>

namespace redrive {
namespace {

using Eigen::Vector2d;

constexpr double kSpacing_m = 0.4, kLongestPiece_m = 200;
constexpr double kSmoothed_m = 0.02;       // most that smoothing may move a point
constexpr double kEndHeading_rad = 0.003;  // most that a line or an arc may end beside the way's
// A simpler piece is taken if it reaches this part of what a clothoid reaches.
constexpr double kSimplerReach = 0.7;

/// Sums f over [0, 1] with the weights of Gauss and Legendre's rule of five points, in `parts`
/// parts.
template <class F>
auto integral(int parts, const F& f) {
  constexpr std::array<double, 5> kNode = {0.0469100770306680, 0.2307653449471585, 0.5,
                                           0.7692346550528415, 0.9530899229693320},
                                  kWeight = {0.1184634425280945, 0.2393143352496832,
                                             0.2844444444444444, 0.2393143352496832,
                                             0.1184634425280945};
  decltype(f(0.0)) sum = f(0.0) * 0.0;
  for (int part = 0; part < parts; ++part)
    for (std::size_t k = 0; k < 5; ++k) sum += kWeight[k] / parts * f((part + kNode[k]) / parts);
  return sum;
}

double wrapped(double angle_rad) { return std::remainder(angle_rad, 2 * std::numbers::pi); }

/// The way at one of its points.
struct Knot {
  std::size_t point = 0;  ///< index of the point
  double along_m = 0;
  PlanPose smooth;
};

/// Returns the points that are kSpacing_m apart, and the last one.
std::vector<Knot> spaced(std::span<const Vector2d> points) {
  std::vector<Knot> knots{{}};
  for (std::size_t i = 1; i < points.size(); ++i) {
    const double step_m = (points[i] - points[knots.back().point]).norm();
    if (step_m >= kSpacing_m) knots.push_back({i, knots.back().along_m + step_m, {}});
  }
  const Vector2d rest = points.back() - points[knots.back().point];
  if (knots.size() > 1) knots.back() = {points.size() - 1, knots.back().along_m + rest.norm(), {}};
  return knots;
}

/// Sets a knot's pose to a cubic through its neighbourhood, the widest that moves it little.
void smooth(std::span<const Vector2d> points, std::size_t at, std::vector<Knot>* knots) {
  Knot& knot = (*knots)[at];
  const Vector2d here = points[knot.point];
  for (const double reach_m : {6.0, 3.0, 1.5}) {
    std::size_t first = at, last = at;
    while (first > 0 && knot.along_m - (*knots)[first - 1].along_m <= reach_m) --first;
    while (last + 1 < knots->size() && (*knots)[last + 1].along_m - knot.along_m <= reach_m) ++last;
    const auto n = static_cast<Eigen::Index>(last - first + 1);
    constexpr Eigen::Index kFewest = 6;
    if (n < kFewest) continue;
    Eigen::MatrixXd powers(n, 4), values(n, 2);
    for (Eigen::Index i = 0; i < n; ++i) {
      const Knot& other = (*knots)[first + static_cast<std::size_t>(i)];
      const double s = (other.along_m - knot.along_m) / reach_m;
      powers.row(i) << 1, s, s * s, s * s * s;
      values.row(i) = points[other.point].transpose();
    }
    const Eigen::MatrixXd fit = powers.colPivHouseholderQr().solve(values);
    if ((fit.row(0).transpose() - here).norm() > kSmoothed_m) continue;
    knot.smooth = {fit(0, 0), fit(0, 1), std::atan2(fit(1, 1), fit(1, 0))};
    return;
  }
  const Vector2d ahead = points[(*knots)[std::min(at + 1, knots->size() - 1)].point] -
                         points[(*knots)[at > 0 ? at - 1 : 0].point];
  knot.smooth = {here.x(), here.y(), std::atan2(ahead.y(), ahead.x())};
}

class WayFit {
 public:
  explicit WayFit(std::span<const Vector2d> points) : points_(points), knots_(spaced(points)) {
    for (std::size_t i = 0; i < knots_.size(); ++i) smooth(points, i, &knots_);
  }

  std::vector<PlanPiece> pieces() const {
    std::vector<PlanPiece> pieces;
    PlanPose at = knots_[0].smooth;
    for (std::size_t from = 0; from + 1 < knots_.size();) {
      const Reach clothoid = longest(from, at, &WayFit::clothoid);
      Reach chosen = clothoid;
      for (const Make make : {&WayFit::line, &WayFit::arc}) {
        const Reach simple = longest(from, at, make);
        if (simple.piece.length_m == 0 ||
            simple.piece.length_m < kSimplerReach * clothoid.piece.length_m)
          continue;
        chosen = simple;
        break;
      }
      if (chosen.piece.length_m == 0) {  // a jump of the points
        chosen.to = from + 1;
        const Vector2d step = knots_[chosen.to].smooth.position() - at.position();
        at.heading_rad = std::atan2(step.y(), step.x());
        chosen.piece = {at, std::max(step.norm(), 1e-3), 0, 0};
      }
      pieces.push_back(chosen.piece);
      at = chosen.piece.at(chosen.piece.length_m);
      from = chosen.to;
    }
    return pieces;
  }

 private:
  struct Reach {
    PlanPiece piece;  ///< length 0: there is none
    std::size_t to = 0;
  };
  using Make = PlanPiece (WayFit::*)(const PlanPose& from, const Knot& to) const;

  PlanPiece line(const PlanPose& from, const Knot& to) const {
    const Vector2d chord = to.smooth.position() - from.position();
    return {from, std::max(0.0, chord.dot(from.ahead())), 0, 0};
  }
  /// The arc that ends at the knot.
  PlanPiece arc(const PlanPose& from, const Knot& to) const {
    const Vector2d chord = to.smooth.position() - from.position();
    const double half_rad = wrapped(std::atan2(chord.y(), chord.x()) - from.heading_rad);
    constexpr double kMost_rad = 1, kStraight_rad = 1e-9;
    if (std::abs(half_rad) > kMost_rad || std::abs(half_rad) < kStraight_rad) return {};
    const double length_m = chord.norm() * half_rad / std::sin(half_rad);
    return {from, length_m, 2 * half_rad / length_m, 0};
  }
  PlanPiece clothoid(const PlanPose& from, const Knot& to) const {
    return clothoid_between(from, to.smooth);
  }

  /// Whether a piece follows the points up to a knot.
  bool follows(const PlanPiece& piece, std::size_t from, std::size_t to, bool simple) const {
    if (piece.length_m <= 0) return false;
    const PlanPose end = piece.at(piece.length_m);
    const double most_m = simple ? kLineTolerance_m : kClothoidTolerance_m;
    if (simple &&
        ((end.position() - knots_[to].smooth.position()).norm() > most_m ||
         std::abs(wrapped(end.heading_rad - knots_[to].smooth.heading_rad)) > kEndHeading_rad))
      return false;
    for (std::size_t i = knots_[from].point; i <= knots_[to].point; ++i)
      if (foot_on(piece, points_[i]).distance_m > most_m) return false;
    return true;
  }

  /// Returns the longest piece of a kind; a clothoid to the next knot whatever it leaves.
  Reach longest(std::size_t from, const PlanPose& at, Make make) const {
    const bool simple = make != &WayFit::clothoid;
    Reach best;
    const auto reaches = [&](std::size_t to) {
      const PlanPiece piece = (this->*make)(at, knots_[to]);
      if (!follows(piece, from, to, simple)) return false;
      if (to > best.to) best = {piece, to};
      return true;
    };
    std::size_t step = 1, most = from;
    while (most + 1 < knots_.size() &&
           knots_[most + 1].along_m - knots_[from].along_m <= kLongestPiece_m)
      ++most;
    if (most == from) most = from + 1;
    // A short piece may fail where noise turns the pose at its start, and a longer one succeed.
    std::size_t failed = most + 1;
    for (std::size_t to = from + 1; to <= most; to = from + (step *= 2))
      if (!reaches(to) && step >= 8) {
        failed = to;
        break;
      }
    if (best.to == 0) {
      if (!simple) best = {(this->*make)(at, knots_[from + 1]), from + 1};
      return best;
    }
    for (std::size_t low = best.to, high = failed; low + 1 < high;) {
      const std::size_t middle = (low + high) / 2;
      (reaches(middle) ? low : high) = middle;
    }
    return best;
  }

  std::span<const Vector2d> points_;
  std::vector<Knot> knots_;
};

}  // namespace

PlanPose PlanPiece::at(double length) const {
  const auto heading = [&](double s) {
    return start.heading_rad + s * (curvature_per_m + curvature_rate_per_m2 * s / 2);
  };
  constexpr double kPart_rad = 0.5;
  const double turn =
      std::abs(length) * (std::abs(curvature_per_m) + std::abs(curvature_rate_per_m2 * length));
  const Vector2d way = integral(1 + static_cast<int>(turn / kPart_rad), [&](double part) {
    const double h = heading(part * length);
    return Vector2d(std::cos(h), std::sin(h));
  });
  return {start.x + length * way.x(), start.y + length * way.y(), heading(length)};
}

PlanPiece clothoid_between(const PlanPose& from, const PlanPose& to) {
  const Vector2d chord = to.position() - from.position();
  const double chord_rad = std::atan2(chord.y(), chord.x()),
               first_rad = wrapped(from.heading_rad - chord_rad),
               last_rad = wrapped(to.heading_rad - chord_rad), turn_rad = last_rad - first_rad;
  constexpr double kMost_rad = std::numbers::pi / 2;
  if (chord.norm() == 0 || std::abs(first_rad) > kMost_rad || std::abs(last_rad) > kMost_rad)
    return {};
  // Heading over the part t of the length: bend t^2 + (turn - bend) t + first. Newton's method for
  // the bend that ends on the chord.
  double bend = 3 * (first_rad + last_rad);
  constexpr int kParts = 4, kSteps = 12;
  const auto heading = [&](double t) { return (bend * t + turn_rad - bend) * t + first_rad; };
  double beside = 0;
  for (int i = 0; i < kSteps; ++i) {
    beside = integral(kParts, [&](double t) { return std::sin(heading(t)); });
    const double slope =
        integral(kParts, [&](double t) { return std::cos(heading(t)) * t * (t - 1); });
    if (slope == 0) return {};
    bend -= beside / slope;
  }
  constexpr double kExact = 1e-10;
  const double ahead = integral(kParts, [&](double t) { return std::cos(heading(t)); });
  if (!(std::abs(beside) < kExact) || ahead <= 0) return {};
  const double length = chord.norm() / ahead;
  return {from, length, (turn_rad - bend) / length, 2 * bend / (length * length)};
}

Foot foot_on(const PlanPiece& piece, const Vector2d& point) {
  const PlanPose end = piece.at(piece.length_m);
  const Vector2d chord = end.position() - piece.start.position();
  double along = piece.length_m * (point - piece.start.position()).dot(chord) /
                 std::max(chord.squaredNorm(), 1e-12);
  PlanPose at;
  for (int i = 0; i < 4; ++i) {
    along = std::clamp(along, 0.0, piece.length_m);
    at = piece.at(along);
    along += (point - at.position()).dot(at.ahead());
  }
  along = std::clamp(along, 0.0, piece.length_m);
  return {(point - piece.at(along).position()).norm(), along};
}

std::vector<PlanPiece> fit_way(std::span<const Vector2d> points) {
  if (points.size() < 2) return {};
  return WayFit(points).pieces();
}

}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/lidar/lost_rays.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>

#include "redrive/math/angles.h"

namespace redrive {
namespace {

constexpr double kTurn_rad = 2 * std::numbers::pi;
constexpr double kMostTurns = 2;        // a revolution's times
constexpr double kMostMisplaced = 0.1;  // share of returns that time puts elsewhere
constexpr double kSameRay = 0.2;        // share of a step between the returns of one ray

/// A return: how far its beam had turned, in the direction of rotation.
struct Fired {
  float turned_rad;
  std::uint8_t beam;
  std::int64_t t_ns;
};

double beam_turn(const LidarSensor& sensor, double azimuth_rad) {
  return sensor.clockwise ? -azimuth_rad : azimuth_rad;
}

std::vector<Fired> returns_of(std::span<const LidarPoint> points, const Rigid3d& body_from_lidar,
                              const LidarSensor& sensor) {
  const Eigen::Isometry3f lidar_from_body = body_from_lidar.inverse(Eigen::Isometry).cast<float>();
  const std::vector<std::uint8_t> beams = beams_of(points, body_from_lidar, sensor);
  std::vector<Fired> returns;
  returns.reserve(points.size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (beams[i] == kNoRing) continue;
    const Eigen::Vector3f p = lidar_from_body * points[i].in_body_m;
    returns.push_back({static_cast<float>(beam_turn(sensor, std::atan2(p.y(), p.x()))), beams[i],
                       points[i].t_ns});
  }
  return returns;
}

/// Counts the turns of all returns from the first time, by the rate of rotation. Returns the turn
/// that counts as 0; nothing where times do not fit.
std::optional<double> unwrap_by_time(double rate_hz, std::vector<Fired>* returns) {
  constexpr std::size_t kStride = 16;
  const auto [first, last] = std::ranges::minmax(*returns, {}, &Fired::t_ns);
  const double rad_per_ns = kTurn_rad * rate_hz * 1e-9;
  if (!(static_cast<double>(last.t_ns) - static_cast<double>(first.t_ns) <
        kMostTurns * 1e9 / rate_hz))
    return std::nullopt;
  const auto expected = [rad_per_ns, start_ns = first.t_ns](const Fired& one) {
    return rad_per_ns * static_cast<double>(one.t_ns - start_ns);
  };
  double sine = 0, cosine = 0;
  for (std::size_t i = 0; i < returns->size(); i += kStride) {
    const double off = (*returns)[i].turned_rad - expected((*returns)[i]);
    sine += std::sin(off);
    cosine += std::cos(off);
  }
  const double phase_rad = std::atan2(sine, cosine);
  const std::size_t misplaced = std::erase_if(*returns, [&](Fired& one) {
    const double turned_rad = expected(one);
    double off = one.turned_rad - turned_rad - phase_rad;
    off -= kTurn_rad * std::nearbyint(off / kTurn_rad);
    one.turned_rad = static_cast<float>(turned_rad + off);
    return std::abs(off) > kTurn_rad / 8;
  });
  if (static_cast<double>(misplaced) >
      kMostMisplaced * static_cast<double>(returns->size() + misplaced))
    return std::nullopt;
  return phase_rad;
}

/// Likewise from the end of the widest sector without returns, where times do not tell.
double unwrap_by_gap(int steps, std::vector<Fired>* returns) {
  std::vector<std::uint8_t> seen(static_cast<std::size_t>(steps));
  const auto sector = [steps](double turned_rad) {
    const double share = turned_rad / kTurn_rad;
    return std::min(static_cast<int>((share - std::floor(share)) * steps), steps - 1);
  };
  for (const Fired& one : *returns) seen[static_cast<std::size_t>(sector(one.turned_rad))] = 1;
  int longest = 0, run = 0, start = 0;
  for (int i = 0; i < 2 * steps; ++i) {
    run = seen[static_cast<std::size_t>(i % steps)] ? 0 : run + 1;
    if (run > longest) longest = run, start = (i + 1) % steps;
  }
  const double phase_rad = kTurn_rad * start / steps;
  for (Fired& one : *returns) {
    const double share = (one.turned_rad - phase_rad) / kTurn_rad;
    one.turned_rad = static_cast<float>(kTurn_rad * (share - std::floor(share)));
  }
  return phase_rad;
}

/// Times of the columns, one step wide, from the first to the last with returns.
class Columns {
 public:
  /// A column with returns of few beams is none: these are strays.
  Columns(const std::vector<Fired>& returns, double step_rad, std::size_t beams)
      : step_rad_(step_rad) {
    const auto [first, last] = std::ranges::minmax(returns, {}, &Fired::turned_rad);
    from_rad = first.turned_rad;
    start_ns_ = returns[0].t_ns;
    std::vector<std::pair<double, std::size_t>> sums(
        static_cast<std::size_t>((last.turned_rad - from_rad) / step_rad) + 1);
    const auto column = [&](const Fired& one) {
      return static_cast<std::size_t>((one.turned_rad - from_rad) / step_rad);
    };
    for (const Fired& one : returns) {
      auto& [sum, count] = sums[column(one)];
      sum += static_cast<double>(one.t_ns - start_ns_);
      ++count;
    }
    const std::size_t least = std::max<std::size_t>(beams / 8, 1);
    to_rad = from_rad;
    double least_rad = last.turned_rad;
    for (const Fired& one : returns)
      if (sums[column(one)].second >= least) {
        least_rad = std::min<double>(least_rad, one.turned_rad);
        to_rad = std::max<double>(to_rad, one.turned_rad);
      }
    first_rad_ = from_rad;
    from_rad = least_rad;
    for (std::size_t i = 0; i < sums.size(); ++i)
      if (sums[i].second > 0)
        known_.emplace_back(static_cast<double>(i) + 0.5,
                            sums[i].first / static_cast<double>(sums[i].second));
  }
  std::int64_t t_ns(double turned_rad) const {
    const double column = (turned_rad - first_rad_) / step_rad_;
    const auto after = std::ranges::lower_bound(known_, column, {}, &Known::first);
    if (after == known_.begin()) return start_ns_ + std::llround(known_.front().second);
    if (after == known_.end()) return start_ns_ + std::llround(known_.back().second);
    const Known &a = after[-1], &b = *after;
    const double share = (column - a.first) / (b.first - a.first);
    return start_ns_ + std::llround(a.second + share * (b.second - a.second));
  }

  double from_rad, to_rad;  ///< azimuths of the first and the last return in a column

 private:
  using Known = std::pair<double, double>;  // middle of a column and its time
  double step_rad_, first_rad_;
  std::int64_t start_ns_;
  std::vector<Known> known_;
};

/// Returns the distance of neighbouring rays in this revolution: the rate of rotation varies.
double step_of(const std::vector<std::vector<float>>& of_beam, double usual_rad) {
  double sum = 0;
  std::size_t gaps = 0;
  for (const std::vector<float>& turned_rad : of_beam)
    for (std::size_t i = 1; i < turned_rad.size(); ++i) {
      const double gap = turned_rad[i] - turned_rad[i - 1];
      if (!(gap > 0.5 * usual_rad && gap < 1.5 * usual_rad)) continue;
      sum += gap;
      ++gaps;
    }
  return gaps > 0 ? sum / static_cast<double>(gaps) : usual_rad;
}

struct Lost {
  std::int64_t t_ns;
  double turned_rad;
  std::uint8_t beam;
};

/// Returns the lost rays of one beam, whose returns are sorted.
void find_gaps(const std::vector<float>& turned_rad, double step_rad, const Columns& columns,
               std::uint8_t beam, std::vector<Lost>* lost) {
  double before = columns.from_rad - step_rad;
  const auto look_until = [&](double next) {
    const double steps = std::round((next - before) / step_rad);
    for (double k = 1; k < steps; ++k) {
      const double at = before + (next - before) * k / steps;
      lost->push_back({columns.t_ns(at), at, beam});
    }
    before = next;
  };
  for (const float one : turned_rad) look_until(one);
  look_until(columns.to_rad + step_rad);
}

}  // namespace

LostRays lost_rays(std::span<const LidarPoint> points, const Rigid3d& body_from_lidar,
                   const ScanStructure& structure, std::string* why) {
  std::string reason;
  if (!why) why = &reason;
  LostRays out;
  const LidarSensor& sensor = structure.sensor;
  *why = sensor.azimuth_steps < 2 ? "the azimuth steps of its beams are unknown"
                                  : misfit(structure).value_or("");
  if (!why->empty()) return out;
  std::vector<Fired> returns = returns_of(points, body_from_lidar, sensor);
  if (returns.empty()) {
    *why = "no ray has a return";
    return out;
  }
  for (Fired& one : returns)
    one.turned_rad -= static_cast<float>(beam_turn(sensor, sensor.beams[one.beam].azimuth_rad));
  const auto phase_rad = sensor.rate_hz > 0
                             ? unwrap_by_time(sensor.rate_hz, &returns)
                             : std::optional(unwrap_by_gap(sensor.azimuth_steps, &returns));
  if (!phase_rad) {
    *why = "times of its returns do not fit its rate of rotation";
    return out;
  }
  const double usual_rad = kTurn_rad / sensor.azimuth_steps;
  std::vector<std::vector<float>> of_beam(sensor.beams.size());
  for (const Fired& one : returns) of_beam[one.beam].push_back(one.turned_rad);
  for (std::vector<float>& beam : of_beam) std::ranges::sort(beam);
  const double step_rad = step_of(of_beam, usual_rad);
  const Columns columns(returns, step_rad, sensor.beams.size());
  std::vector<Lost> lost;
  for (std::size_t b = 0; b < of_beam.size(); ++b) {
    find_gaps(of_beam[b], step_rad, columns, static_cast<std::uint8_t>(b), &lost);
    for (std::size_t i = 0; i < of_beam[b].size(); ++i)
      out.returned += i == 0 || of_beam[b][i] - of_beam[b][i - 1] > kSameRay * step_rad;
  }
  std::ranges::sort(lost, {}, [](const Lost& one) { return std::pair(one.t_ns, one.beam); });
  for (const Lost& one : lost) {
    const LidarBeam& beam = sensor.beams[one.beam];
    const double turned_rad = beam_turn(sensor, one.turned_rad + *phase_rad);
    out.direction.push_back(
        beam_direction(beam.elevation_rad, beam.azimuth_rad + turned_rad).cast<float>());
    out.t_ns.push_back(one.t_ns);
    out.beam.push_back(one.beam);
  }
  return out;
}

}  // namespace redrive

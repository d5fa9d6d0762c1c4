// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/lidar/scan_structure.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <map>
#include <numbers>
#include <utility>

#include "redrive/math/angles.h"
#include "redrive/recording/core/wording.h"

namespace redrive {
namespace {

constexpr std::size_t kLeastReturns = 1000, kLeastOfBeam = 20;
constexpr int kMostBeams = 256;
constexpr double kBin_rad = 0.02 * kRadiansPerDegree;  // bin of elevations
constexpr double kLeastShareInBin = 2e-4;              // a bin with fewer returns separates beams
constexpr double kLeastShareInBeams = 0.9;
constexpr double kMostWidth = 0.5;    // median of beams' widths over their distances
constexpr double kSameAzimuth = 0.2;  // share of a step between the returns of one ray
constexpr double kTwoPi = 2 * std::numbers::pi;

struct Return {
  double azimuth_rad, elevation_rad, range_m, t_s;
  int beam = -1;
};
using Scan = std::vector<Return>;

double wrapped(double angle_rad) { return std::remainder(angle_rad, kTwoPi); }

double median(std::vector<double>* values) {
  const auto middle = values->begin() + static_cast<std::ptrdiff_t>(values->size() / 2);
  std::ranges::nth_element(*values, middle);
  return *middle;
}

/// Returns the mean of angles.
class CircularMean {
 public:
  void add(double angle_rad) {
    sine_ += std::sin(angle_rad);
    cosine_ += std::cos(angle_rad);
  }
  double value() const { return std::atan2(sine_, cosine_); }

 private:
  double sine_ = 0, cosine_ = 0;
};

/// Sets the beam of each return by the clusters of elevations. Returns their number, 0 where there
/// are none.
int cluster_elevations(std::vector<Scan>* scans, std::size_t returns) {
  std::map<long, std::size_t> bins;
  for (const Scan& scan : *scans)
    for (const Return& one : scan) ++bins[std::lround(one.elevation_rad / kBin_rad)];
  std::map<long, int> beam_of;
  std::vector<double> widths;  // width of each beam but the last over its distance from the next
  int beams = 0;
  std::size_t inside = 0;
  long first = 0, last = 0;
  for (const auto& [bin, count] : bins) {
    if (static_cast<double>(count) < kLeastShareInBin * static_cast<double>(returns)) continue;
    if (beams == 0 || bin > last + 1) {
      if (beams > 0)
        widths.push_back(static_cast<double>(last + 1 - first) / static_cast<double>(bin - first));
      first = bin;
      ++beams;
    }
    beam_of[bin] = beams - 1;
    last = bin;
    inside += count;
  }
  if (beams < 2 || beams > kMostBeams || median(&widths) > kMostWidth ||
      static_cast<double>(inside) < kLeastShareInBeams * static_cast<double>(returns))
    return 0;
  for (Scan& scan : *scans)
    for (Return& one : scan) {
      const auto at = beam_of.find(std::lround(one.elevation_rad / kBin_rad));
      one.beam = at == beam_of.end() ? -1 : at->second;
    }
  return beams;
}

/// Sets elevations. Returns the numbers of returns.
std::vector<std::size_t> fit_elevations(const std::vector<Scan>& scans,
                                        std::vector<LidarBeam>* beams, double* residual_rad) {
  std::vector<std::vector<double>> of_beam(beams->size());
  for (const Scan& scan : scans)
    for (const Return& one : scan)
      if (one.beam >= 0) of_beam[static_cast<std::size_t>(one.beam)].push_back(one.elevation_rad);
  std::vector<double> squares;
  std::vector<std::size_t> returns;
  for (std::size_t b = 0; b < of_beam.size(); ++b) {
    returns.push_back(of_beam[b].size());
    if (of_beam[b].empty()) continue;
    const double elevation_rad = (*beams)[b].elevation_rad = median(&of_beam[b]);
    for (const double one : of_beam[b]) squares.push_back(std::pow(one - elevation_rad, 2));
  }
  std::ranges::sort(squares);
  squares.resize(squares.size() - squares.size() / 20);
  double sum = 0;
  for (const double square : squares) sum += square;
  *residual_rad = std::sqrt(sum / static_cast<double>(squares.size()));
  return returns;
}

/// Returns, for each beam of a scan, its returns in the order of time.
std::vector<std::vector<const Return*>> by_beam(const Scan& scan, std::size_t beams) {
  std::vector<std::vector<const Return*>> out(beams);
  for (const Return& one : scan)
    if (one.beam >= 0) out[static_cast<std::size_t>(one.beam)].push_back(&one);
  for (auto& of_beam : out) std::ranges::stable_sort(of_beam, {}, [](auto* r) { return r->t_s; });
  return out;
}

/// Returns the rate of rotation, rad/s, to the left; nothing where times do not tell.
std::optional<double> fit_rotation(const std::vector<Scan>& scans, std::size_t beams) {
  constexpr std::size_t kMostApart = 64;  // returns; times may be known by packets only
  constexpr double kMostApart_s = 0.05;   // half a turn at 10 Hz
  std::vector<double> rates;
  for (const Scan& scan : scans)
    for (const auto& of_beam : by_beam(scan, beams)) {
      const std::size_t apart = std::clamp<std::size_t>(of_beam.size() / 8, 1, kMostApart);
      for (std::size_t i = 0; i + apart < of_beam.size(); ++i) {
        const Return &a = *of_beam[i], &b = *of_beam[i + apart];
        const double seconds = b.t_s - a.t_s;
        if (seconds > 0 && seconds < kMostApart_s)
          rates.push_back(wrapped(b.azimuth_rad - a.azimuth_rad) / seconds);
      }
    }
  if (rates.size() < kLeastOfBeam) return std::nullopt;
  const double rough = median(&rates);
  // What is left of the azimuths changes linearly with the error of the rate.
  double sum_tt = 0, sum_ta = 0;
  for (const Scan& scan : scans)
    for (const auto& of_beam : by_beam(scan, beams)) {
      if (of_beam.size() < kLeastOfBeam) continue;
      CircularMean mean;
      double mean_s = 0;
      const auto left = [&](const Return& one) { return one.azimuth_rad - rough * one.t_s; };
      for (const Return* one : of_beam) {
        mean.add(left(*one));
        mean_s += one->t_s / static_cast<double>(of_beam.size());
      }
      for (const Return* one : of_beam) {
        sum_tt += std::pow(one->t_s - mean_s, 2);
        sum_ta += (one->t_s - mean_s) * wrapped(left(*one) - mean.value());
      }
    }
  if (sum_tt <= 0 || !std::isfinite(rough)) return std::nullopt;
  return rough + sum_ta / sum_tt;
}

/// Sets each beam's azimuth relative to the mean of all.
void fit_azimuths(const std::vector<Scan>& scans, double rate_rad_per_s,
                  const std::vector<std::size_t>& returns, std::vector<LidarBeam>* beams) {
  std::vector<CircularMean> of_beam(beams->size());
  for (const Scan& scan : scans) {
    CircularMean heading;
    for (const Return& one : scan)
      if (one.beam >= 0) heading.add(one.azimuth_rad - rate_rad_per_s * one.t_s);
    for (const Return& one : scan)
      if (one.beam >= 0)
        of_beam[static_cast<std::size_t>(one.beam)].add(one.azimuth_rad - rate_rad_per_s * one.t_s -
                                                        heading.value());
  }
  double mean = 0;
  std::size_t used = 0;
  for (std::size_t b = 0; b < beams->size(); ++b)
    if (returns[b] > 0) {
      mean += (*beams)[b].azimuth_rad = of_beam[b].value();
      ++used;
    }
  for (LidarBeam& beam : *beams) beam.azimuth_rad -= mean / static_cast<double>(used);
}

/// Sets the number of steps from the gaps between a beam's returns, and the share of rays with a
/// second one.
void fit_steps(const std::vector<Scan>& scans, ScanStructure* out) {
  constexpr double kLeastGap_rad = 1e-4;
  std::vector<double> gaps;
  std::vector<std::vector<double>> azimuths;
  for (const Scan& scan : scans)
    for (const auto& of_beam : by_beam(scan, out->sensor.beams.size())) {
      std::vector<double>& own = azimuths.emplace_back();
      for (const Return* one : of_beam) own.push_back(one->azimuth_rad);
      std::ranges::sort(own);
      for (std::size_t i = 1; i < own.size(); ++i)
        if (own[i] - own[i - 1] > kLeastGap_rad) gaps.push_back(own[i] - own[i - 1]);
    }
  if (gaps.empty()) return;
  const double usual = median(&gaps);
  double sum = 0;
  std::size_t whole = 0;
  for (const double gap : gaps)
    if (gap > 0.4 * usual && gap < 1.6 * usual) {  // neighbouring rays, none lost between them
      sum += gap;
      ++whole;
    }
  out->sensor.azimuth_steps =
      static_cast<int>(std::lround(kTwoPi * static_cast<double>(whole) / std::max(sum, 1e-9)));
  std::size_t second = 0, all = 0;
  for (const std::vector<double>& own : azimuths) {
    all += own.size();
    for (std::size_t i = 1; i < own.size(); ++i)
      second += own[i] - own[i - 1] < kSameAzimuth * usual;
  }
  out->second_returns = static_cast<double>(second) / static_cast<double>(all - second);
}

}  // namespace

bool has_rings(std::span<const LidarPoint> points) {
  return std::ranges::any_of(points, [](const LidarPoint& point) { return point.ring != kNoRing; });
}

std::vector<std::uint8_t> beams_of(std::span<const LidarPoint> points,
                                   const Rigid3d& body_from_lidar, const LidarSensor& sensor) {
  const Eigen::Isometry3f lidar_from_body = body_from_lidar.inverse(Eigen::Isometry).cast<float>();
  std::vector<float> beam_sines;
  for (const LidarBeam& beam : sensor.beams)
    beam_sines.push_back(static_cast<float>(std::sin(beam.elevation_rad)));
  const auto nearest = [&](float sine) {
    const auto above = std::ranges::lower_bound(beam_sines, sine);
    if (above == beam_sines.begin()) return std::uint8_t{0};
    const bool below = above == beam_sines.end() || sine - above[-1] < *above - sine;
    return static_cast<std::uint8_t>(above - beam_sines.begin() - below);
  };
  const bool rings = has_rings(points);
  constexpr float kNowhere = 2;  // no sine
  std::vector<float> sines;
  std::array<std::vector<float>, kNoRing> of_ring;
  for (const LidarPoint& point : points) {
    const Eigen::Vector3f p = lidar_from_body * point.in_body_m;
    const float range_m = p.norm();
    const bool is_return = range_m > 0 && std::isfinite(range_m);
    sines.push_back(is_return && (!rings || point.ring != kNoRing) ? p.z() / range_m : kNowhere);
    if (rings && sines.back() != kNowhere) of_ring[point.ring].push_back(sines.back());
  }
  std::array<std::uint8_t, kNoRing> beam_of{};
  for (std::size_t ring = 0; ring < kNoRing; ++ring) {
    if (of_ring[ring].empty()) continue;
    const auto middle = of_ring[ring].begin() + std::ssize(of_ring[ring]) / 2;
    std::ranges::nth_element(of_ring[ring], middle);
    beam_of[ring] = nearest(*middle);
  }
  std::vector<std::uint8_t> beams;
  for (std::size_t i = 0; i < points.size(); ++i)
    beams.push_back(sines[i] == kNowhere ? kNoRing
                    : rings              ? beam_of[points[i].ring]
                                         : nearest(sines[i]));
  return beams;
}

std::optional<ScanStructure> estimate_structure(std::span<const std::vector<LidarPoint>> scans,
                                                const Rigid3d& body_from_lidar, std::string* why) {
  const Rigid3d lidar_from_body = body_from_lidar.inverse(Eigen::Isometry);
  std::vector<Scan> all(scans.size());
  std::size_t returns = 0;
  const bool have_rings = std::ranges::any_of(
      scans, [](const std::vector<LidarPoint>& scan) { return has_rings(scan); });
  std::vector<double> ranges_m;
  std::uint16_t most_intensity = 0;
  for (std::size_t s = 0; s < scans.size(); ++s)
    for (const LidarPoint& point : scans[s]) {
      const Eigen::Vector3d p = lidar_from_body * point.in_body_m.cast<double>();
      const double range_m = p.norm();
      if (!(range_m > 0) || (have_rings && point.ring == kNoRing)) continue;
      all[s].push_back({std::atan2(p.y(), p.x()), std::asin(p.z() / range_m), range_m,
                        1e-9 * static_cast<double>(point.t_ns - scans[s].front().t_ns),
                        point.ring == kNoRing ? -1 : point.ring});
      ranges_m.push_back(range_m);
      most_intensity = std::max(most_intensity, point.intensity);
      ++returns;
    }
  if (returns < kLeastReturns) {
    *why = "its scans have only " + counted(returns, "return");
    return std::nullopt;
  }
  ScanStructure out;
  LidarSensor& sensor = out.sensor;
  sensor.name = "estimated";
  sensor.azimuth_steps = 0;
  sensor.rate_hz = 0;
  const int beams = have_rings ? kNoRing : cluster_elevations(&all, returns);
  if (beams == 0) {
    *why = "elevations of its returns form no beams, and the format gives no rings";
    return std::nullopt;
  }
  sensor.beams.resize(static_cast<std::size_t>(beams));
  const std::vector<std::size_t> of_beam = fit_elevations(all, &sensor.beams, &out.residual_rad);
  if (const auto rotation = fit_rotation(all, sensor.beams.size())) {
    sensor.clockwise = *rotation < 0;
    sensor.rate_hz = std::abs(*rotation) / kTwoPi;
    fit_azimuths(all, *rotation, of_beam, &sensor.beams);
  }
  fit_steps(all, &out);
  std::vector<LidarBeam> seen;
  for (std::size_t b = 0; b < sensor.beams.size(); ++b)
    if (of_beam[b] >= kLeastOfBeam) seen.push_back(sensor.beams[b]);
  sensor.beams = std::move(seen);
  if (sensor.beams.empty()) {
    *why = "no ring of its scans has " + std::to_string(kLeastOfBeam) + " returns";
    return std::nullopt;
  }
  std::ranges::sort(sensor.beams, {}, &LidarBeam::elevation_rad);
  const auto [least, most] = std::ranges::minmax(ranges_m);
  sensor.min_range_m = least;
  sensor.max_range_m = most;
  out.intensity_scale = intensity_scale(most_intensity);
  return out;
}

std::optional<std::string> misfit(const ScanStructure& structure) {
  constexpr double kMostResidual = 0.5;  // share of the median distance between beams
  const std::vector<LidarBeam>& beams = structure.sensor.beams;
  std::vector<double> apart;
  for (std::size_t b = 1; b < beams.size(); ++b)
    apart.push_back(beams[b].elevation_rad - beams[b - 1].elevation_rad);
  if (apart.empty() || structure.residual_rad <= kMostResidual * median(&apart))
    return std::nullopt;
  char text[200];
  std::snprintf(text, sizeof text,
                "its returns lie %.3f degrees off the elevations of its beams, which are %.3f "
                "apart: the extrinsics, or scans that are motion compensated?",
                kDegreesPerRadian * structure.residual_rad, kDegreesPerRadian * median(&apart));
  return text;
}

}  // namespace redrive

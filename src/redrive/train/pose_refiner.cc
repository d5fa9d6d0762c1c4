// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/pose_refiner.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace redrive {
namespace {

// An update hears of some tens of rays a frame: what Adam follows is the mean of twenty.
constexpr double kBeta1 = 0.95, kBeta2 = 0.99;
/// Of each number an update: small corrections are likelier than large ones, and of what moves nothing, as all frames against all cameras, none.
constexpr double kDecay = 1e-3;

float bound_of(const PoseCorrections& corrections, std::size_t i) {
  if (i >= corrections.at_time(0)) return kMostLate_s;
  return i % 6 < 3 ? kMostMoved_m : kMostTurned_rad;
}

}  // namespace

PoseRates pose_rates(double rate_m) { return {rate_m, rate_m / 10, rate_m / 10}; }

std::vector<ViewGradient> view_gradients(const Scene& scene, const RayBatch& batch, const StepLosses& losses) {
  const std::size_t n = batch.n;
  std::vector<ViewGradient> views(scene.views.size());
  for (std::size_t ray = 0; ray < n; ++ray) {
    Eigen::Vector3d d_origin, direction, d_direction;
    for (int k = 0; k < 3; ++k) {
      d_origin[k] = losses.d_origin[k * n + ray];
      direction[k] = batch.direction[k * n + ray];
      d_direction[k] = losses.d_direction[k * n + ray];
    }
    ViewGradient& view = views[batch.view[ray]];
    view.d_place += d_origin;
    view.d_turn += direction.cross(d_direction);
  }
  return views;
}

void refine_poses(const Scene& scene, const RayBatch& batch, const StepLosses& losses, const PoseRates& rates,
                  PoseState* state) {
  PoseCorrections& corrections = state->corrections;
  const std::vector<double> gradient =
      gradient_of_corrections(scene, corrections, view_gradients(scene, batch, losses));
  if (!std::ranges::all_of(gradient, [](double g) { return std::isfinite(g); })) return;
  ++state->updates;
  const double bias1 = 1 - std::pow(kBeta1, static_cast<double>(state->updates)),
               bias2 = 1 - std::pow(kBeta2, static_cast<double>(state->updates));
  const std::size_t of_frames = corrections.at_camera(0), of_times = corrections.at_time(0);
  for (std::size_t i = 0; i < (rates.cameras ? corrections.size() : of_frames); ++i) {
    float &m = state->first_moment[i], &v = state->second_moment[i];
    m = static_cast<float>(kBeta1 * m + (1 - kBeta1) * gradient[i]);
    v = static_cast<float>(kBeta2 * v + (1 - kBeta2) * gradient[i] * gradient[i]);
    if (v == 0) continue;  // nothing ever said anything of it
    const double rate = i >= of_times ? rates.time_s : i % 6 < 3 ? rates.by_m : rates.turn_rad;
    float& value = corrections.values[i];
    const float most = bound_of(corrections, i);
    value = std::clamp(static_cast<float>(value * (1 - kDecay) - rate * (m / bias1) / std::sqrt(v / bias2)), -most, most);
  }
  fill_held_out(scene, &corrections);
}

std::string describe_corrections(const Scene& scene, const PoseCorrections& corrections) {
  const auto size_of = [&](std::size_t at) {
    double square = 0;
    for (int k = 0; k < 3; ++k) square += double(corrections.values[at + k]) * corrections.values[at + k];
    return square;
  };
  const auto at_bound = [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i)
      if (std::abs(corrections.values[i]) >= bound_of(corrections, i)) return "; WARNING: at its bound, see redrive align";
    return "";
  };
  double moved = 0, turned = 0;
  for (int f = 0; f < corrections.frames; ++f) {
    moved += size_of(corrections.at_frame(f));
    turned += size_of(corrections.at_frame(f) + 3);
  }
  constexpr double kDegree = M_PI / 180;
  char line[200];
  std::snprintf(line, sizeof line, "poses refined: frames moved %.1f cm, turned %.3f degrees RMS%s\n",
                100 * std::sqrt(moved / corrections.frames), std::sqrt(turned / corrections.frames) / kDegree,
                at_bound(0, corrections.at_camera(0)));
  std::string out = line;
  for (int c = 0; c < corrections.cameras; ++c) {
    const std::size_t at = corrections.at_camera(c), time = corrections.at_time(c);
    const char* warning = at_bound(at, at + 6);
    if (*warning == 0) warning = at_bound(time, time + 1);
    std::snprintf(line, sizeof line, "%s: moved %.1f cm, turned %.3f degrees, %+.1f ms%s\n", scene.rig[c].name.c_str(),
                  100 * std::sqrt(size_of(at)), std::sqrt(size_of(at + 3)) / kDegree,
                  1e3 * corrections.values[time], warning);
    out += line;
  }
  return out;
}

}  // namespace redrive

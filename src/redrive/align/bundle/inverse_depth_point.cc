// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/bundle/inverse_depth_point.h"

#include <cmath>
#include <memory>

#include <ceres/cost_function.h>
#include <Eigen/Cholesky>

namespace redrive {
namespace {

constexpr double kInverseDepths[] = {0, 0.015, 0.03, 0.06, 0.12, 0.25, 0.5, 1};  // 1/m
constexpr double kBehindInfinity = -0.01;  // 1/m: the noise of distant points may reach this value

using Terms = std::vector<std::unique_ptr<ceres::CostFunction>>;

struct Parameters {
  // one per observation; the last parameter is the point's
  std::vector<std::array<const double*, 7>> of;
};

Terms terms_of(const RigModel& model, const ExposureMotions& times, const Track& track,
               const InverseDepthPoint& point, const std::vector<double>& sigma_px,
               Parameters* parameters) {
  Terms terms;
  for (const Observation& seen : track.seen) {
    const LocalMotion motion = times.of(seen);
    const RigModelCamera& camera = model.cameras[seen.camera];
    terms.push_back(reprojection_cost(camera, motion, seen.pixel, sigma_px[seen.camera], point));
    parameters->of.push_back({model.corrections[motion.segment].data(),
                              model.corrections[motion.segment + 1].data(),
                              camera.extrinsics.data(), &camera.offset_s, &camera.readout_s,
                              camera.intrinsics.data(), nullptr});
  }
  return terms;
}

struct Normal {
  double cost = 0;
  Eigen::Matrix3d h = Eigen::Matrix3d::Zero();
  Eigen::Vector3d g = Eigen::Vector3d::Zero();
};

Normal evaluate(const Terms& terms, Parameters& parameters, const double* value,
                bool with_jacobians) {
  constexpr double kScale = 4;  // 2 sigma, squared
  Normal sum;
  for (std::size_t i = 0; i < terms.size(); ++i) {
    parameters.of[i].back() = value;
    Eigen::Vector2d r;
    Eigen::Matrix<double, 2, 3, Eigen::RowMajor> j;
    double* jacobians[7] = {nullptr, nullptr, nullptr, nullptr, nullptr, nullptr, j.data()};
    terms[i]->Evaluate(parameters.of[i].data(), r.data(), with_jacobians ? jacobians : nullptr);
    sum.cost += kScale * std::log1p(r.squaredNorm() / kScale);
    if (!with_jacobians) continue;
    const double weight = 1 / (1 + r.squaredNorm() / kScale);
    sum.h += weight * j.transpose() * j;
    sum.g += weight * j.transpose() * r;
  }
  return sum;
}

}  // namespace

ExposureMotions::ExposureMotions(const RigModel& model) : model_(model) {
  for (std::size_t c = 0; c < model.cameras.size(); ++c) {
    motions_.emplace_back();
    for (std::size_t f = 0; f < model.initial_frames.size(); ++f)
      motions_.back().push_back(model.image_motion(static_cast<int>(c), static_cast<int>(f)));
  }
}

LocalMotion ExposureMotions::of(const Observation& seen) const {
  if (model_.cameras[seen.camera].readout_s == 0) return motions_[seen.camera][seen.frame];
  return model_.pixel_motion(seen.camera, seen.frame, seen.pixel);
}

std::optional<InverseDepthPoint> fit_inverse_depth_point(const RigModel& model,
                                                         const ExposureMotions& times,
                                                         const Track& track,
                                                         const std::vector<double>& sigma_px) {
  const Observation& middle = track.seen[track.seen.size() / 2];
  const auto ray = model.camera(middle.camera).unproject(middle.pixel);
  if (!ray) return std::nullopt;
  const Rigid3d world_from_camera =
      model.corrected_pose(times.of(middle)) * model.body_from_sensor(middle.camera);
  InverseDepthPoint point;
  point.anchor = world_from_camera.translation();
  const Eigen::Vector3d direction = world_from_camera.linear() * *ray;
  point.axes.col(0) = direction.unitOrthogonal();
  point.axes.col(1) = direction.cross(point.axes.col(0));
  point.axes.col(2) = direction;

  Parameters parameters;
  const Terms terms = terms_of(model, times, track, point, sigma_px, &parameters);
  double best = std::numeric_limits<double>::infinity();
  for (const double inverse_distance : kInverseDepths) {
    const std::array<double, 3> start{0, 0, inverse_distance};
    const double cost = evaluate(terms, parameters, start.data(), false).cost;
    if (cost < best) {
      best = cost;
      point.value = start;
    }
  }
  double damping = 1e-3;
  for (int iteration = 0; iteration < 15; ++iteration) {
    const Normal normal = evaluate(terms, parameters, point.value.data(), true);
    Eigen::Matrix3d h = normal.h;
    h.diagonal() *= 1 + damping;
    h.diagonal().array() += 1e-12;
    const Eigen::Vector3d step = -h.ldlt().solve(normal.g);
    if (!step.allFinite()) return std::nullopt;
    std::array<double, 3> next = point.value;
    for (int k = 0; k < 3; ++k) next[k] += step[k];
    const double cost = evaluate(terms, parameters, next.data(), false).cost;
    if (cost <= best) {
      const bool settled = best - cost < 1e-6 * (1 + best);
      best = cost;
      point.value = next;
      damping *= 0.2;
      if (settled) break;
    } else {
      damping *= 10;
      if (damping > 1e6) break;
    }
  }
  if (!(point.value[2] > kBehindInfinity)) return std::nullopt;
  return point;
}

std::vector<Eigen::Vector2d> reprojection_errors(const RigModel& model,
                                                 const ExposureMotions& times, const Track& track,
                                                 const InverseDepthPoint& point) {
  Parameters parameters;
  const Terms terms = terms_of(model, times, track, point,
                               std::vector<double>(model.cameras.size(), 1.0), &parameters);
  std::vector<Eigen::Vector2d> errors(track.seen.size());
  for (std::size_t i = 0; i < terms.size(); ++i) {
    parameters.of[i].back() = point.value.data();
    terms[i]->Evaluate(parameters.of[i].data(), errors[i].data(), nullptr);
  }
  return errors;
}

}  // namespace redrive

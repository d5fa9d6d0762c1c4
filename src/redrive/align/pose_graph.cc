// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/pose_graph.h"

#include <algorithm>
#include <cmath>

#include <Eigen/SparseCholesky>

#include "redrive/base/error.h"

namespace redrive {
namespace {

constexpr double kMaxChi2 = 22.5;  // 99.9 % of chi^2 with 6 degrees of freedom
// Deviation of the prior that holds every knot, in deviations of the closures.
constexpr double kLoose = 10, kLeastLoose_m = 0.1, kLeastLoose_rad = 1e-3;
constexpr int kIterations = 40;
constexpr std::size_t kMostVariances = 400;  // variances of knots between them are interpolated

using Sparse = Eigen::SparseMatrix<double>;

/// A measured motion between two poses, weighted.
struct Edge {
  int from = 0, to = 0;
  Rigid3d from_to;
  Matrix6d information;
};

/// Difference of the relative motion of two poses from the measured one: translation in the axes of
/// the measured `to`, rotation in the axes of `to`.
Vector6d residual_of(const Rigid3d& from, const Rigid3d& to, const Rigid3d& from_to) {
  const Rigid3d difference =
      from_to.inverse(Eigen::Isometry) * (from.inverse(Eigen::Isometry) * to);
  Vector6d r;
  r << difference.translation(), so3_log(difference.linear());
  return r;
}

/// Derivatives of the residual, where it is small, with respect to the pose [exp(phi), rho] of
/// either end.
void derivatives(const Rigid3d& from, const Rigid3d& to, const Rigid3d& from_to, Matrix6d* by_from,
                 Matrix6d* by_to) {
  const Rigid3d relative = from.inverse(Eigen::Isometry) * to;
  const Eigen::Matrix3d back = from_to.linear().transpose();
  by_from->setZero();
  by_from->topLeftCorner<3, 3>() = -back;
  by_from->topRightCorner<3, 3>() = back * skew(relative.translation());
  by_from->bottomRightCorner<3, 3>() = -relative.linear().transpose();
  by_to->setZero();
  by_to->topLeftCorner<3, 3>() = back * relative.linear();
  by_to->bottomRightCorner<3, 3>().setIdentity();
}

Rigid3d changed(const Rigid3d& pose, const Vector6d& by) {
  Rigid3d change = Rigid3d::Identity();
  change.linear() = so3_exp(by.tail<3>());
  change.translation() = by.head<3>();
  return pose * change;
}

double squared(const Vector6d& r, const Matrix6d& information) { return r.dot(information * r); }

class Graph {
 public:
  Graph(const std::vector<Knot>& knots, const std::vector<LoopClosure>& closures)
      : weights_(closures.size(), 1) {
    for (const Knot& knot : knots) initial_.push_back(knot.world_from_body);
    poses_ = initial_;
    for (std::size_t k = 0; k + 1 < knots.size(); ++k) {
      const double way_m = std::max(knots[k + 1].way_m - knots[k].way_m, 1e-3);
      Vector6d variance = knots[k].variance + knots[k + 1].variance;
      variance.head<3>().array() += kDrift_m * kDrift_m * way_m;
      variance.tail<3>().array() += kDrift_rad * kDrift_rad * way_m;
      links_.push_back({static_cast<int>(k), static_cast<int>(k) + 1,
                        initial_[k].inverse(Eigen::Isometry) * initial_[k + 1],
                        variance.cwiseInverse().asDiagonal()});
    }
    for (const LoopClosure& closure : closures)
      measured_.push_back(
          {closure.from, closure.to, closure.from_to, closure.covariance.inverse()});
  }

  const std::vector<Rigid3d>& poses() const { return poses_; }
  Vector6d difference(std::size_t closure) const { return residual(measured_[closure]); }
  double chi2(std::size_t closure) const {
    return squared(difference(closure), measured_[closure].information);
  }
  void set_weight(std::size_t closure, double weight) { weights_[closure] = weight; }
  double weight(std::size_t closure) const { return weights_[closure]; }

  /// Weighted RMS residuals of closures, translation and rotation.
  Eigen::Vector2d rms() const {
    Eigen::Vector2d squares = Eigen::Vector2d::Zero();
    double sum = 0;
    for (std::size_t c = 0; c < measured_.size(); ++c) {
      const Vector6d r = difference(c);
      squares +=
          weights_[c] * Eigen::Vector2d(r.head<3>().squaredNorm(), r.tail<3>().squaredNorm());
      sum += weights_[c];
    }
    return sum > 0 ? Eigen::Vector2d((squares / sum).cwiseSqrt()) : squares;
  }

  void set_prior(const Eigen::Vector2d& rms) {
    const double m = kLoose * std::max(rms.x(), kLeastLoose_m),
                 rad = kLoose * std::max(rms.y(), kLeastLoose_rad);
    prior_ << 1 / (m * m), 1 / (m * m), 1 / (m * m), 1 / (rad * rad), 1 / (rad * rad),
        1 / (rad * rad);
  }

  /// A Gauss-Newton step. Returns the largest change of a position.
  double step() {
    factorise();
    const Eigen::VectorXd change = solver_.solve(-gradient_);
    double largest = 0;
    for (std::size_t k = 0; k < poses_.size(); ++k) {
      const Vector6d by = change.segment<6>(6 * static_cast<Eigen::Index>(k));
      largest = std::max(largest, by.head<3>().norm());
      poses_[k] = changed(poses_[k], by);
    }
    return largest;
  }

  /// Sum of squared residuals of links and accepted closures for each of these closures.
  double chi2_of_closure() const {
    double sum = 0, count = 0;
    for (const Edge& link : links_) sum += squared(residual(link), link.information);
    for (std::size_t c = 0; c < measured_.size(); ++c) {
      sum += weights_[c] * chi2(c);
      count += weights_[c];
    }
    return sum / count;
  }

  /// Variances of all knots, a rigid motion of the whole excluded, times `factor`.
  std::vector<Vector6d> variances(double factor) {
    factorise();
    const std::size_t n = poses_.size(), step = (n + kMostVariances - 1) / kMostVariances;
    std::vector<Matrix6d> effect, weighted, shared, covariance;
    Eigen::MatrixXd all(6 * static_cast<Eigen::Index>(n), 6);  // W B of all knots
    for (std::size_t k = 0; k < n; ++k) {
      effect.push_back(by_motion(poses_[k], poses_.front().translation()));
      weighted.emplace_back(motion_weights().asDiagonal() * effect.back());
      all.middleRows<6>(6 * static_cast<Eigen::Index>(k)) = weighted.back();
    }
    const Eigen::MatrixXd solved = solver_.solve(all);
    for (std::size_t k = 0; k < n; ++k)
      shared.emplace_back(solved.middleRows<6>(6 * static_cast<Eigen::Index>(k)));
    covariance.assign(n, Matrix6d::Zero());
    std::vector<std::size_t> computed;
    for (std::size_t k = 0; k < n; k = k + 1 < n ? std::min(k + step, n - 1) : n) {
      const auto at = 6 * static_cast<Eigen::Index>(k);
      Eigen::MatrixXd unit = Eigen::MatrixXd::Zero(all.rows(), 6);
      unit.middleRows<6>(at).setIdentity();
      covariance[k] = solver_.solve(unit).middleRows<6>(at);
      computed.push_back(k);
    }
    remove_common_motion(effect, weighted, shared, &covariance);
    std::vector<Vector6d> result(n);
    for (std::size_t i = 0; i < computed.size(); ++i) {
      const std::size_t begin = computed[i], end = computed[std::min(i + 1, computed.size() - 1)];
      const Vector6d a = covariance[begin].diagonal(), b = covariance[end].diagonal();
      for (std::size_t k = begin; k < std::max(end, begin + 1); ++k)
        result[k] =
            factor * (a + (b - a) * (end > begin ? double(k - begin) / double(end - begin) : 0.0))
                         .cwiseMax(0);
    }
    return result;
  }

 private:
  Vector6d residual(const Edge& edge) const {
    return residual_of(poses_[edge.from], poses_[edge.to], edge.from_to);
  }

  void add(const Edge& edge, double weight, std::vector<Eigen::Triplet<double>>* entries) {
    Matrix6d by_from, by_to;
    derivatives(poses_[edge.from], poses_[edge.to], edge.from_to, &by_from, &by_to);
    const Vector6d r = residual(edge);
    const Matrix6d w = weight * edge.information;
    const auto block = [&](int row, int column, const Matrix6d& of) {
      for (int i = 0; i < 6; ++i)
        for (int j = 0; j < 6; ++j)
          if (6 * row + i >= 6 * column + j)
            entries->emplace_back(6 * row + i, 6 * column + j, of(i, j));
    };
    block(edge.from, edge.from, by_from.transpose() * w * by_from);
    block(edge.to, edge.to, by_to.transpose() * w * by_to);
    if (edge.to > edge.from)
      block(edge.to, edge.from, by_to.transpose() * w * by_from);
    else
      block(edge.from, edge.to, by_from.transpose() * w * by_to);
    gradient_.segment<6>(6 * edge.from) += by_from.transpose() * w * r;
    gradient_.segment<6>(6 * edge.to) += by_to.transpose() * w * r;
  }

  /// Normal equations at the present poses, with the derivatives of small residuals.
  void factorise() {
    const auto n = 6 * static_cast<Eigen::Index>(poses_.size());
    gradient_.setZero(n);
    std::vector<Eigen::Triplet<double>> entries;
    for (const Edge& link : links_) add(link, 1, &entries);
    for (std::size_t c = 0; c < measured_.size(); ++c)
      if (weights_[c] > 0) add(measured_[c], weights_[c], &entries);
    for (std::size_t k = 0; k < poses_.size(); ++k) {
      const int at = 6 * static_cast<int>(k);
      const Vector6d moved = residual_of(initial_[k], poses_[k], Rigid3d::Identity());
      Vector6d r;
      r << poses_[k].linear().transpose() * initial_[k].linear() * moved.head<3>(), moved.tail<3>();
      gradient_.segment<6>(at) += prior_.cwiseProduct(r);
      for (int i = 0; i < 6; ++i) entries.emplace_back(at + i, at + i, prior_[i]);
    }
    Sparse normal(n, n);
    normal.setFromTriplets(entries.begin(), entries.end());
    solver_.compute(normal);
    REDRIVE_CHECK(solver_.info() == Eigen::Success);
  }

  std::vector<double> weights_;
  std::vector<Rigid3d> initial_, poses_;
  std::vector<Edge> links_, measured_;
  Vector6d prior_ = Vector6d::Zero();
  Eigen::VectorXd gradient_;
  Eigen::SimplicialLDLT<Sparse, Eigen::Lower> solver_;
};

/// Solves with the weights of Geman and McClure, whose scale falls until a closure as far off as
/// kMaxChi2 has the weight 1/4 (graduated non-convexity: Yang et al., "Graduated Non-Convexity for
/// Robust Spatial Perception", 2020).
void solve_robustly(std::size_t closures, Graph* graph) {
  double scale = 1;
  for (std::size_t c = 0; c < closures; ++c) scale = std::max(scale, 2 * graph->chi2(c) / kMaxChi2);
  for (int i = 0; i < kIterations; ++i) {
    for (std::size_t c = 0; c < closures; ++c)
      graph->set_weight(c, std::pow(1 + graph->chi2(c) / (scale * kMaxChi2), -2));
    const double moved = graph->step();
    if (scale == 1 && moved < 1e-4) return;
    scale = std::max(1.0, scale / 2);
  }
}

}  // namespace

double drift_m(double way_m) {
  return std::sqrt(kDrift_m * kDrift_m * way_m +
                   kDrift_rad * kDrift_rad * way_m * way_m * way_m / 3);
}

ClosedTrajectory close_trajectory(const std::vector<Knot>& knots,
                                  const std::vector<LoopClosure>& closures) {
  ClosedTrajectory closed;
  for (const Knot& knot : knots) closed.poses.push_back(knot.world_from_body);
  closed.variance.assign(knots.size(), Vector6d::Zero());
  closed.accepted.assign(closures.size(), false);
  if (closures.empty()) return closed;
  REDRIVE_CHECK_OP(knots.size(), >=, 2u);

  Graph graph(knots, closures);
  graph.set_prior(graph.rms());
  solve_robustly(closures.size(), &graph);
  bool any = false;
  for (std::size_t c = 0; c < closures.size(); ++c) {
    closed.accepted[c] = graph.chi2(c) <= kMaxChi2;
    any = any || closed.accepted[c];
  }
  if (!any) return closed;

  Graph accepted(knots, closures);
  for (std::size_t c = 0; c < closures.size(); ++c) accepted.set_weight(c, closed.accepted[c]);
  const Eigen::Vector2d before = accepted.rms();
  closed.before_m = before.x(), closed.before_rad = before.y();
  accepted.set_prior(before);
  for (int i = 0; i < kIterations && accepted.step() > 1e-6; ++i) {
  }
  const double chi2 = accepted.chi2_of_closure();
  if (chi2 > kMaxChi2) {  // no drift explains them
    closed.accepted.assign(closures.size(), false);
    closed.before_m = closed.before_rad = 0;
    return closed;
  }
  const Eigen::Vector2d after = accepted.rms();
  closed.after_m = after.x(), closed.after_rad = after.y();
  closed.poses = accepted.poses();
  closed.variance = accepted.variances(chi2 / 6);
  return closed;
}

}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/bundle/least_squares.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <numeric>
#include <utility>

#include "redrive/align/bundle/schur_system.h"
#include "redrive/base/error.h"

namespace redrive {
namespace {

constexpr std::size_t kTermsPerRange = 512;  // some 0.3 ms
constexpr double kInfinite = std::numeric_limits<double>::infinity();
// Ceres' defaults: initial, largest and smallest radius of the trust region, the part of the
// expected decrease that a step has to reach, and the part of the values below which it is nothing.
constexpr double kFirstRadius = 1e4, kMostRadius = 1e16, kLeastRadius = 1e-32, kLeastRatio = 1e-3,
                 kLeastStep = 1e-8;

}  // namespace

int LeastSquares::add_block(double* values, int size) {
  blocks_.push_back({values, size, columns_, now_.rig.size()});
  columns_ += size;
  now_.rig.insert(now_.rig.end(), values, values + size);
  return static_cast<int>(blocks_.size()) - 1;
}

void LeastSquares::hold(int block) {
  if (blocks_[block].column < 0) return;
  columns_ -= blocks_[block].size;
  for (std::size_t i = static_cast<std::size_t>(block) + 1; i < blocks_.size(); ++i)
    if (blocks_[i].column >= 0) blocks_[i].column -= blocks_[block].size;
  blocks_[block].column = -1;
}

int LeastSquares::add_landmark(const std::array<double, kLandmarkSize>& value) {
  now_.landmarks.push_back(value);
  return static_cast<int>(now_.landmarks.size()) - 1;
}

void LeastSquares::add(Term term) {
  const std::vector<int>& sizes = term.cost->parameter_block_sizes();
  REDRIVE_CHECK_OP(sizes.size(), <=, kMostBlocks);
  for (std::size_t k = 0; k < sizes.size(); ++k)
    REDRIVE_CHECK_OP(sizes[k], ==,
                     term.blocks[k] == kOwnLandmark ? kLandmarkSize : blocks_[term.blocks[k]].size);
  const int rows = term.cost->num_residuals(),
            columns = 1 + std::accumulate(sizes.begin(), sizes.end(), 0);
  terms_.push_back({std::move(term), rows, values_size_});
  values_size_ += static_cast<std::size_t>(rows) * static_cast<std::size_t>(columns);
}

std::optional<int> LeastSquares::column(int block) const {
  return blocks_[block].column < 0 ? std::nullopt : std::optional(blocks_[block].column);
}

int LeastSquares::columns() const { return columns_; }

double LeastSquares::evaluate_term(const State& at, std::size_t term, bool linearise) {
  constexpr int kMostRows = 6;
  const StoredTerm& stored = terms_[term];
  const Term& of = stored.term;
  const std::vector<int>& sizes = of.cost->parameter_block_sizes();
  std::array<double, kMostRows> own;
  REDRIVE_CHECK_OP(stored.rows, <=, kMostRows);
  double* const values = linearise ? values_.data() + stored.begin : own.data();
  std::array<const double*, kMostBlocks> parameters;
  std::array<double*, kMostBlocks> jacobians;
  std::size_t next = static_cast<std::size_t>(stored.rows);
  for (std::size_t k = 0; k < sizes.size(); ++k) {
    const int block = of.blocks[k];
    parameters[k] = block == kOwnLandmark
                        ? at.landmarks[static_cast<std::size_t>(of.landmark)].data()
                        : at.rig.data() + blocks_[block].offset;
    if (!linearise) continue;
    jacobians[k] = block != kOwnLandmark && blocks_[block].column < 0 ? nullptr : values + next;
    next += static_cast<std::size_t>(stored.rows * sizes[k]);
  }
  if (!of.cost->Evaluate(parameters.data(), values, linearise ? jacobians.data() : nullptr))
    return kInfinite;
  double square = 0;
  for (int row = 0; row < stored.rows; ++row) square += values[row] * values[row];
  if (linearise) squares_[term] = square;
  if (!of.loss) return square / 2;
  double rho[3];
  of.loss->Evaluate(square, rho);
  // The second derivative of the losses in use is never positive: Triggs' correction is this
  // weight.
  const double weight = std::sqrt(rho[1]);
  for (std::size_t i = 0; linearise && i < next; ++i) values[i] *= weight;
  return rho[0] / 2;
}

double LeastSquares::evaluate(const State& at, bool linearise) {
  if (linearise) {
    values_.resize(values_size_);
    squares_.resize(terms_.size());
  }
  std::vector<double> costs((terms_.size() + kTermsPerRange - 1) / kTermsPerRange);
  pool_.run_ranges(terms_.size(), kTermsPerRange, [&](std::size_t begin, std::size_t end) {
    double sum = 0;
    for (std::size_t i = begin; i < end; ++i) sum += evaluate_term(at, i, linearise);
    costs[begin / kTermsPerRange] = sum;
  });
  return std::accumulate(costs.begin(), costs.end(), 0.0);
}

double LeastSquares::linearise() {
  read_rig();
  return evaluate(now_, true);
}

void LeastSquares::read_rig() {
  for (const Block& block : blocks_)
    std::copy_n(block.values, block.size, now_.rig.data() + block.offset);
}

void LeastSquares::write_rig() {
  for (const Block& block : blocks_)
    std::copy_n(now_.rig.data() + block.offset, block.size, block.values);
}

LeastSquares::Summary LeastSquares::solve(int most_iterations, double tolerance) {
  const auto start = std::chrono::steady_clock::now();
  Summary summary;
  double cost = summary.initial_cost = linearise();
  SchurSystem system(*this, pool_);
  SchurSystem::Step step;
  double radius = kFirstRadius, shrink = 2;
  for (bool ended = !std::isfinite(cost); !ended && summary.iterations < most_iterations;
       ++summary.iterations) {
    double ratio = 0;
    if (system.solve(radius, &step)) {
      State next = now_;
      double square = 0;
      for (const Block& block : blocks_)
        for (int i = 0; block.column >= 0 && i < block.size; ++i) {
          square += std::pow(now_.rig[block.offset + i], 2);
          next.rig[block.offset + i] += step.rig[block.column + i];
        }
      for (std::size_t i = 0; i < now_.landmarks.size(); ++i)
        for (int k = 0; k < kLandmarkSize; ++k) {
          square += std::pow(now_.landmarks[i][k], 2);
          next.landmarks[i][k] += step.landmarks(k, static_cast<Eigen::Index>(i));
        }
      if (std::sqrt(step.square) <= kLeastStep * (std::sqrt(square) + kLeastStep)) break;
      const double next_cost = evaluate(next, false);
      ended = std::abs(cost - next_cost) <= tolerance * cost;
      if (step.decrease > 0) ratio = (cost - next_cost) / step.decrease;
      if (ratio > kLeastRatio || (ended && next_cost < cost)) {
        now_ = std::move(next);
        cost = next_cost;
        if (!ended) cost = evaluate(now_, true);
      }
    }
    if (ratio > kLeastRatio) {
      radius = std::min(kMostRadius, radius / std::max(1.0 / 3, 1 - std::pow(2 * ratio - 1, 3)));
      shrink = 2;
    } else {
      radius /= shrink;
      shrink *= 2;
      ended |= radius < kLeastRadius;
    }
  }
  write_rig();
  summary.final_cost = cost;
  summary.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return summary;
}

}  // namespace redrive

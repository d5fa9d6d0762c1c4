// SPDX-License-Identifier: Apache-2.0
#include "redrive/optim/proposal_loss.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include <ceres/jet.h>
#include <gtest/gtest.h>

#include "redrive/base/rng.h"

namespace redrive {
namespace {

constexpr double kOpacityWeight = 0.1;

double uniform(std::uint64_t stream, std::uint64_t i) {
  return random_unit(random_key(5, kStreamTest, stream), i);
}

/// A histogram over [1, 9], its inner edges multiples of 1/16, so that two histograms sometimes
/// share edges.
struct Histogram {
  std::vector<float> edges = {1, 9};
  std::vector<double> weights;

  Histogram(int n, double total, std::uint64_t seed) {
    for (int i = 1; i < n; ++i)
      edges.push_back(1 + std::floor(128 * static_cast<float>(uniform(seed, i))) / 16);
    std::sort(edges.begin(), edges.end());
    for (int i = 0; i < n; ++i) weights.push_back(2 * total / n * uniform(seed + 1000, i));
  }
  int n() const { return static_cast<int>(weights.size()); }
};

double loss_of(const Histogram& field, const Histogram& proposal,
               const std::vector<double>& proposal_weights, double scale,
               std::vector<double>* d_proposal) {
  return interlevel_loss(field.edges.data(), field.weights.data(), field.n(), proposal.edges.data(),
                         proposal_weights.data(), proposal.n(), scale, d_proposal->data());
}

TEST(InterlevelLoss, IsZeroForAnUpperEnvelope) {
  const Histogram field(24, 0.9, 1);
  std::vector<double> d(24, 0.5);
  // The same histogram; and one interval with all of the weight, or slightly more for the rounding
  // of the sum.
  EXPECT_EQ(loss_of(field, field, field.weights, 1.0, &d), 0);
  EXPECT_EQ(d, std::vector<double>(24, 0.5));
  Histogram coarse(1, 0, 2);
  for (const double w : field.weights) coarse.weights[0] += w;
  std::vector<double> d_coarse(1);
  EXPECT_EQ(loss_of(field, coarse, coarse.weights, 1.0, &d_coarse), 0);
  EXPECT_EQ(d_coarse[0], 0);
}

TEST(InterlevelLoss, HandComputed) {
  // [0, 1] of weight 1/2 lies under 1/8 + 1/8, [1, 4] of weight 1/4 under 1/8 + 1: 1/4 is lacking
  // of the first.
  const float edges[] = {0, 1, 4}, proposal_edges[] = {0, 0.5f, 2, 4};
  const double weights[] = {0.5, 0.25}, proposal[] = {0.125, 0.125, 1};
  double d[3] = {0, 0, 7};
  const double loss = interlevel_loss(edges, weights, 2, proposal_edges, proposal, 3, 10.0, d);
  EXPECT_NEAR(loss, 0.25 * 0.25 / (0.5 + 1e-7), 1e-15);
  for (int j = 0; j < 2; ++j) EXPECT_NEAR(d[j], -10 * 2 * 0.25 / (0.5 + 1e-7), 1e-13);
  EXPECT_EQ(d[2], 7);
}

TEST(InterlevelLoss, BoundIsTheSumOverIntervalsThatOverlap) {
  int lacking = 0;
  for (std::uint64_t seed = 0; seed < 50; ++seed) {
    const Histogram field(1 + seed % 24, 0.9, 10 + seed), proposal(1 + seed % 17, 0.7, 200 + seed);
    double expected = 0;
    for (int i = 0; i < field.n(); ++i) {
      if (field.edges[i] == field.edges[i + 1]) continue;  // overlaps nothing: not drawn below
      double bound = 0;
      for (int j = 0; j < proposal.n(); ++j)
        if (proposal.edges[j] < field.edges[i + 1] && proposal.edges[j + 1] > field.edges[i])
          bound += proposal.weights[j];
      const double missing = std::max(0.0, field.weights[i] - bound);
      expected += missing * missing / (field.weights[i] + 1e-7);
      lacking += missing > 0;
    }
    Histogram drawn = field;
    for (int i = 0; i < drawn.n(); ++i)
      if (drawn.edges[i] == drawn.edges[i + 1]) drawn.weights[i] = 0;
    std::vector<double> d(proposal.n());
    EXPECT_NEAR(loss_of(drawn, proposal, proposal.weights, 1.0, &d), expected, 1e-14) << seed;
  }
  EXPECT_GT(lacking, 100);
}

TEST(OpacityLoss, IsTheSquareOfTheDifference) {
  const double weights[] = {0.5, 0.25}, proposal[] = {0.25, 0.25, 0.5};
  double d[3] = {0, 0, 7};
  EXPECT_EQ(opacity_loss(weights, 2, proposal, 3, 10.0, d), 0.0625);
  EXPECT_EQ(d[0], 5);
  EXPECT_EQ(d[1], 5);
  EXPECT_EQ(d[2], 12);
}

TEST(ProposalLoss, LowersTheProposalWhereTheFieldIsEmpty) {
  const Histogram field(24, 0, 1), proposal(16, 0.5, 2);
  double sum = 0;
  for (const double w : proposal.weights) sum += w;
  std::vector<double> d(16);
  const double loss =
      proposal_loss(field.edges.data(), field.weights.data(), 24, proposal.edges.data(),
                    proposal.weights.data(), 16, kOpacityWeight, 1.0, d.data());
  EXPECT_GT(loss, 1e-3);
  EXPECT_NEAR(loss, kOpacityWeight * sum * sum, 1e-15);
  for (const double of_weight : d) EXPECT_NEAR(of_weight, 2 * kOpacityWeight * sum, 1e-15);
}

TEST(ProposalLoss, DerivativeAgreesWithJets) {
  constexpr int kProposal = 16;
  using Jet = ceres::Jet<double, kProposal>;
  for (std::uint64_t seed = 0; seed < 10; ++seed) {
    const Histogram field(24, 0.9, 400 + seed), proposal(kProposal, 0.6, 600 + seed);
    const double scale = 3;
    std::vector<double> d(kProposal, 0.25);
    proposal_loss(field.edges.data(), field.weights.data(), field.n(), proposal.edges.data(),
                  proposal.weights.data(), kProposal, kOpacityWeight, scale, d.data());
    std::vector<Jet> weights(kProposal), ignored(kProposal);
    for (int j = 0; j < kProposal; ++j) weights[j] = Jet(proposal.weights[j], j);
    const std::vector<Jet> of_field(field.weights.begin(), field.weights.end());
    const Jet loss =
        proposal_loss(field.edges.data(), of_field.data(), field.n(), proposal.edges.data(),
                      weights.data(), kProposal, kOpacityWeight, Jet(1), ignored.data());
    EXPECT_GT(loss.a, 1e-3);
    // At most 25 terms of at most 2 scale.
    for (int j = 0; j < kProposal; ++j)
      EXPECT_NEAR(d[j], 0.25 + scale * loss.v[j], 25 * 8 * 2 * scale * 0x1p-53) << j;
  }
}

}  // namespace
}  // namespace redrive

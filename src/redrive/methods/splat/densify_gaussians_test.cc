// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/splat/densify_gaussians.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <map>
#include <set>

#include <gtest/gtest.h>
#include <Eigen/Geometry>

#include "redrive/methods/splat/known_splats_testing.h"
#include "redrive/optim/packed_moments.h"

namespace redrive {
namespace {

constexpr std::size_t kTail = 5;
constexpr float kLeastLogit = -4.59512f;  // logit of an opacity of 0.01

/// n visible Gaussians of all shapes within 20 m. The red of each is its number, so that it is
/// recognised wherever it goes.
GaussianList random_list(std::size_t n) {
  GaussianList list;
  list.rows.resize(n * kGaussianRows);
  for (std::size_t i = 0; i < n; ++i) {
    float* const rows = &list.rows[i * kGaussianRows];
    for (int row = 0; row < kGaussianRows; ++row)
      rows[row] = known_splats::signed_random(1, i * kGaussianRows + row);
    for (int k = 0; k < 3; ++k) rows[kPositionRow + k] *= 20;
    for (int k = 0; k < 3; ++k) rows[kLogScaleRow + k] -= 2;
    rows[kColourRow] = static_cast<float>(i);
    rows[kDistanceRow] = 5;
  }
  return list;
}

struct State {
  std::size_t n;
  Buffer<float> numbers;
  Buffer<std::uint32_t> moments;
  Buffer<float> errors;

  /// Errors are 1, first moments the row's number, second moments the Gaussian's.
  explicit State(const GaussianList& list) : n(list.size()) {
    const std::size_t size = gaussian_blocks(n) * kBlockSize;
    numbers = Buffer<float>(size + kTail);
    for (std::size_t i = 0; i < kTail; ++i) numbers[size + i] = static_cast<float>(100 + i);
    moments = Buffer<std::uint32_t>(size);
    errors = Buffer<float>(size / kGaussianRows);
    std::fill_n(errors.data(), n, 1.0f);
    write_blocks({&list, 1}, {.world = n, .actor_ends = {}}, &numbers);
    for (std::size_t i = 0; i < n; ++i)
      for (int row = 0; row < kDistanceRow; ++row)
        moments[gaussian_slot(i, row)] = pack_moments(1.0f + row, id(i));
  }
  float row(std::size_t i, int row) const { return numbers[gaussian_slot(i, row)]; }
  float id(std::size_t i) const { return row(i, kColourRow); }
  void set_error(std::size_t i, float error) { errors[i] = error; }
  void densify(std::size_t target, std::uint64_t key = 7, int threads = 1, float replaced = 0) {
    ThreadPool pool(threads);
    GaussianLayout layout{.world = n, .actor_ends = {}};
    redrive::densify({.target = target, .replaced = replaced}, key, &layout, &numbers, &moments,
                     &errors, pool);
    n = layout.world;
  }
  /// Gaussians by their number.
  std::map<float, std::vector<std::size_t>> by_id() const {
    std::map<float, std::vector<std::size_t>> out;
    for (std::size_t i = 0; i < n; ++i) out[id(i)].push_back(i);
    return out;
  }
  void expect_whole() {
    const std::size_t size = gaussian_blocks(n) * kBlockSize;
    ASSERT_EQ(numbers.size(), size + kTail);
    ASSERT_EQ(moments.size(), size);
    for (std::size_t i = 0; i < kTail; ++i) EXPECT_EQ(numbers[size + i], 100 + i);
    ASSERT_EQ(errors.size(), size / kGaussianRows);
    EXPECT_TRUE(std::ranges::all_of(errors.span(), [](float error) { return error == 0; }));
    for (std::size_t i = n; i < gaussian_blocks(n) * kGaussianBlock; ++i) {
      EXPECT_LT(row(i, kOpacityRow), -10);
      EXPECT_GT(row(i, kDistanceRow), 0) << "its logarithm is taken";
      EXPECT_EQ(row(i, kQuaternionRow), 1) << "it is normalised";
      for (int row_ = 0; row_ < kGaussianRows; ++row_)
        EXPECT_EQ(moments[gaussian_slot(i, row_)], 0u);
    }
  }
};

/// Standard deviation of Gaussian i along its axis k times that axis, in the world.
Eigen::Vector3f axis_of(const State& state, std::size_t i, int k) {
  const Eigen::Quaternionf q(state.row(i, kQuaternionRow), state.row(i, kQuaternionRow + 1),
                             state.row(i, kQuaternionRow + 2), state.row(i, kQuaternionRow + 3));
  return q.normalized().toRotationMatrix().col(k) * std::exp(state.row(i, kLogScaleRow + k));
}
Eigen::Vector3f position_of(const State& state, std::size_t i) {
  return {state.row(i, 0), state.row(i, 1), state.row(i, 2)};
}
float mean_step(const State& state) {
  float sum = 0;
  for (std::size_t i = 1; i < state.n; ++i)
    sum += (position_of(state, i) - position_of(state, i - 1)).norm();
  return sum / static_cast<float>(state.n - 1);
}

TEST(WriteBlocks, KeepsEveryGaussianOnceAndNeighboursTogether) {
  const GaussianList list = random_list(1003);
  State state(list);
  std::set<float> ids;
  for (std::size_t i = 0; i < state.n; ++i) {
    ids.insert(state.id(i));
    const float* const rows = &list.rows[static_cast<std::size_t>(state.id(i)) * kGaussianRows];
    for (int row = 0; row < kGaussianRows; ++row) ASSERT_EQ(state.row(i, row), rows[row]);
    state.set_error(i, 0);
  }
  EXPECT_EQ(ids.size(), 1003u);
  state.expect_whole();
  // Two random points of a cube of 40 m are 26.5 m apart; 1000 of them have cells of 4 m.
  EXPECT_LT(mean_step(state), 9);
}

TEST(Densify, RemovesTransparentGaussians) {
  GaussianList list = random_list(100);
  for (std::size_t i = 0; i < 100; i += 4)
    list.rows[i * kGaussianRows + kOpacityRow] = kLeastLogit - 0.01f;
  list.rows[2 * kGaussianRows + kOpacityRow] = kLeastLogit + 0.01f;
  list.rows[3 * kGaussianRows + kOpacityRow] = NAN;
  State state(list);
  state.densify(0);
  EXPECT_EQ(state.n, 74u);
  for (std::size_t i = 0; i < state.n; ++i) {
    EXPECT_NE(std::fmod(state.id(i), 4.0f), 0);
    EXPECT_NE(state.id(i), 3);
  }
  state.expect_whole();

  for (std::size_t i = 0; i < state.n; ++i) state.numbers[gaussian_slot(i, kOpacityRow)] = -9;
  state.densify(1000);
  EXPECT_EQ(state.n, 0u);
  state.expect_whole();
}

TEST(Densify, SplitsAlongTheLongestAxisAndConservesMass) {
  const State before(random_list(96));
  State state(random_list(96));
  state.densify(116);
  EXPECT_EQ(state.n, 116u);
  state.expect_whole();
  const auto children = state.by_id();
  ASSERT_EQ(children.size(), 96u);
  int split = 0;
  for (std::size_t parent = 0; parent < 96; ++parent) {
    const std::vector<std::size_t>& now = children.at(before.id(parent));
    if (now.size() == 1) {
      for (int row = 0; row < kGaussianRows; ++row)
        EXPECT_EQ(state.row(now[0], row), before.row(parent, row));
      continue;
    }
    ASSERT_EQ(now.size(), 2u);
    ++split;
    int longest = 0;
    for (int k = 1; k < 3; ++k)
      if (before.row(parent, kLogScaleRow + k) > before.row(parent, kLogScaleRow + longest))
        longest = k;
    const Eigen::Vector3f along = axis_of(before, parent, longest),
                          a = position_of(state, now[0]) - position_of(before, parent),
                          b = position_of(state, now[1]) - position_of(before, parent);
    // Floats of 20 m resolve 2e-6 m.
    EXPECT_LT((a + b).norm(), 1e-5f) << "to either side";
    EXPECT_GT(a.norm(), 0.5f * along.norm());
    EXPECT_LT(a.norm(), along.norm());
    EXPECT_LT(a.cross(along.normalized()).norm(), 1e-5f);
    double mass = 0, second_moment = 0;  // relative to the parent's
    for (const std::size_t child : now) {
      double volume = 0.5;
      for (int k = 0; k < 3; ++k) {
        const double change =
            state.row(child, kLogScaleRow + k) - before.row(parent, kLogScaleRow + k);
        EXPECT_LT(change, 0);
        volume *= std::exp(change);
      }
      mass += 2 * volume;
      second_moment += 0.5 * (axis_of(state, child, longest).squaredNorm() + a.squaredNorm()) /
                       along.squaredNorm();
      for (int row = kQuaternionRow; row < kGaussianRows; ++row)
        EXPECT_EQ(state.row(child, row), before.row(parent, row));
    }
    EXPECT_NEAR(mass, 1, 0.1);
    EXPECT_NEAR(second_moment, 1, 0.15);
  }
  EXPECT_EQ(split, 20);
}

TEST(Densify, ParentsKeepTheirMomentsAndErrorsStartAgain) {
  State state(random_list(96));
  state.densify(110);
  for (const auto& [id, now] : state.by_id()) {
    int with_first_moments = 0;
    for (const std::size_t i : now) {
      const float first = unpacked_first(state.moments[gaussian_slot(i, 0)]);
      for (int row = 0; row < kDistanceRow; ++row)
        EXPECT_EQ(state.moments[gaussian_slot(i, row)],
                  pack_moments(first > 0 ? 1.0f + row : 0, id));
      with_first_moments += first > 0;
    }
    EXPECT_EQ(with_first_moments, 1);
  }
}

TEST(Densify, SplitsWhereTheErrorIs) {
  State state(random_list(400));
  const State before(random_list(400));
  for (std::size_t i = 0; i < 400; ++i)
    state.set_error(i, std::fmod(state.id(i), 2.0f) == 0 ? 0 : 1e-3f);
  for (const std::size_t i : {17, 200}) state.set_error(i, 100);
  const float first = before.id(17), second = before.id(200);
  state.densify(430);
  EXPECT_EQ(state.n, 430u);
  const auto now = state.by_id();
  for (const auto& [id, places] : now)
    if (places.size() == 2) {
      EXPECT_TRUE(std::fmod(id, 2.0f) == 1 || id == first || id == second) << id;
    }
  EXPECT_EQ(now.at(first).size(), 2u);
  EXPECT_EQ(now.at(second).size(), 2u);
}

TEST(Densify, ReplacesSeenGaussiansWithTheLeastErrors) {
  State state(random_list(400));
  std::set<float> removed;  // the 30 least of 300 errors from 1 to 399
  for (std::size_t i = 0; i < 400; ++i) {
    const bool seen = std::fmod(state.id(i), 4.0f) != 0;
    state.set_error(i, seen ? state.id(i) : 0);
    if (seen && state.id(i) < 40) removed.insert(state.id(i));
  }
  ASSERT_EQ(removed.size(), 30u);
  state.densify(400, 7, 1, 0.1f);
  EXPECT_EQ(state.n, 400u);
  state.expect_whole();
  const auto now = state.by_id();
  EXPECT_EQ(now.size(), 370u);
  for (const auto& [id, places] : now) {
    EXPECT_FALSE(removed.contains(id)) << id;
    if (std::fmod(id, 4.0f) == 0) {
      EXPECT_EQ(places.size(), 1u) << id;
    }
  }
}

TEST(Densify, ReplacesNoGaussianOfAnActor) {
  const std::array<GaussianList, 2> lists = {random_list(160), random_list(32)};
  GaussianLayout layout = layout_of(std::span<const GaussianList>(lists));
  const std::size_t size = layout.blocks() * kBlockSize;
  Buffer<float> numbers(size), errors(size / kGaussianRows);
  Buffer<std::uint32_t> moments(size);
  write_blocks(lists, layout, &numbers);
  for (std::size_t i = 0; i < 160; ++i) errors[i] = static_cast<float>(2 + i);
  for (std::size_t i = 160; i < 192; ++i) errors[i] = 1;
  ThreadPool pool(1);
  densify({.target = 192, .replaced = 0.1f}, 7, &layout, &numbers, &moments, &errors, pool);
  std::set<float> kept;
  for (std::size_t i = 0; i < layout.world; ++i) kept.insert(numbers[gaussian_slot(i, kColourRow)]);
  EXPECT_EQ(kept.size(), 144u);
  kept.clear();
  for (std::size_t i = layout.first_block(0) * kGaussianBlock;
       i < layout.first_block(1) * kGaussianBlock; ++i)
    if (numbers[gaussian_slot(i, kOpacityRow)] > kLeastLogit)
      kept.insert(numbers[gaussian_slot(i, kColourRow)]);
  EXPECT_EQ(kept.size(), 32u);
}

TEST(Densify, GrowsToTheTargetAtMost) {
  for (const std::size_t target : {0u, 96u, 97u, 101u}) {
    State state(random_list(96));
    state.densify(target);
    EXPECT_EQ(state.n, std::max<std::size_t>(target, 96));
  }
  State most(random_list(96));
  most.densify(1'000'000);
  EXPECT_GT(most.n, 110u);
  EXPECT_LE(most.n, 192u) << "each is split once at most";

  GaussianList small = random_list(96);  // an axis of 1 mm at 5 m is no longer split
  for (std::size_t i = 0; i < 96; ++i)
    for (int k = 0; k < 3; ++k) small.rows[i * kGaussianRows + kLogScaleRow + k] -= 6;
  State state(small);
  state.densify(120);
  EXPECT_EQ(state.n, 96u);
  for (std::size_t i = 0; i < 96; ++i) state.set_error(i, static_cast<float>(1 + i));
  state.densify(96, 7, 1, 0.5f);
  EXPECT_EQ(state.n, 96u) << "nothing is replaced where nothing can be split";
}

/// Expects which Gaussians of an actor with half sides of (2, 1, 0.8) m are kept, by position.
void expect_kept(float ahead_m, const std::vector<std::pair<Eigen::Vector3f, bool>>& cases) {
  const Eigen::Vector3f bound(2, 1, 0.8f);
  std::array<GaussianList, 2> lists = {random_list(16), random_list(cases.size())};
  for (std::size_t i = 0; i < cases.size(); ++i)
    for (int k = 0; k < 3; ++k)
      lists[1].rows[i * kGaussianRows + kPositionRow + k] = cases[i].first[k];
  GaussianLayout layout = layout_of(std::span<const GaussianList>(lists));
  const std::size_t size = layout.blocks() * kBlockSize;
  Buffer<float> numbers(size);
  Buffer<std::uint32_t> moments(size);
  Buffer<float> errors(size / kGaussianRows);
  write_blocks(lists, layout, &numbers);
  DensifyOptions options;
  options.actor_bounds = {&bound, 1};
  options.ahead_m = ahead_m;
  ThreadPool pool(1);
  densify(options, 7, &layout, &numbers, &moments, &errors, pool);
  EXPECT_EQ(layout.world, 16u);
  std::set<float> kept, expected;
  for (std::size_t i = layout.first_block(0) * kGaussianBlock;
       i < layout.first_block(1) * kGaussianBlock; ++i)
    if (numbers[gaussian_slot(i, kOpacityRow)] > kLeastLogit)
      kept.insert(numbers[gaussian_slot(i, kColourRow)]);
  for (std::size_t i = 0; i < cases.size(); ++i)
    if (cases[i].second) expected.insert(static_cast<float>(i));
  EXPECT_EQ(kept, expected);
}

TEST(Densify, KeepsOfAnActorWhatIsInItsBoxOrOnTheRoadBeside) {
  expect_kept(kShadow_m, {{{1.9f, -0.9f, 0.7f}, true},
                          {{2.1f, 0, 0}, false},
                          {{0, -1.1f, 0}, false},
                          {{0, 0, 0.9f}, false},
                          {{2.9f, 0, -0.5f}, true},
                          {{0, -1.9f, -0.7f}, true},
                          {{3.1f, 0, -0.5f}, false},
                          {{-2.9f, 0, -0.5f}, true},
                          {{-3.1f, 0, -0.5f}, false},
                          {{0, 2.1f, -0.5f}, false},
                          {{2.5f, 0, -0.3f}, false},
                          {{0, 0, -0.9f}, false},
                          {{2.5f, 1.5f, -0.9f}, false}});
}

TEST(Densify, KeepsOfAnActorWhatIsOnTheRoadAheadInTheDark) {
  expect_kept(kHeadlights_m, {{{9.9f, 0, -0.5f}, true},
                              {{10.1f, 0, -0.5f}, false},
                              {{-3.1f, 0, -0.5f}, false},
                              {{9, 1.9f, -0.5f}, true},
                              {{9, 2.1f, -0.5f}, false},
                              {{2.1f, 0, 0}, false}});
}

TEST(Densify, ThreadsChangeNoBit) {
  State a(random_list(50'000)), b(random_list(50'000));
  a.densify(60'000, 1, /*threads=*/1);
  b.densify(60'000, 1, /*threads=*/3);
  EXPECT_EQ(a.n, 60'000u);
  ASSERT_EQ(a.numbers.size(), b.numbers.size());
  EXPECT_EQ(std::memcmp(a.numbers.data(), b.numbers.data(), a.numbers.size() * sizeof(float)), 0);
  EXPECT_TRUE(std::ranges::equal(a.moments.span(), b.moments.span()));
  EXPECT_LT(mean_step(a), 3) << "in Morton order";
}

TEST(Densify, IsAFunctionOfTheKey) {
  State a(random_list(300)), b(random_list(300)), other(random_list(300));
  a.densify(330, 1);
  b.densify(330, 1);
  other.densify(330, 2);
  ASSERT_EQ(a.numbers.size(), b.numbers.size());
  EXPECT_EQ(std::memcmp(a.numbers.data(), b.numbers.data(), a.numbers.size() * sizeof(float)), 0);
  EXPECT_TRUE(std::ranges::equal(a.moments.span(), b.moments.span()));
  EXPECT_NE(std::memcmp(a.numbers.data(), other.numbers.data(), a.numbers.size() * sizeof(float)),
            0);
  EXPECT_LT(mean_step(a), 12) << "in Morton order";
}

}  // namespace
}  // namespace redrive

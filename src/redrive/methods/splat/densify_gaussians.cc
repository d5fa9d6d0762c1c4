// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/splat/densify_gaussians.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <tuple>
#include <utility>
#include <vector>

#include "redrive/base/rng.h"
#include "redrive/field/gaussian_blocks.h"
#include "redrive/optim/packed_moments.h"

namespace redrive {
namespace {

constexpr float kChildOffset = 0.75f;  // in standard deviations of the parent, to either side
constexpr std::size_t kGaussiansPerRange = 4096;
constexpr std::size_t kCandidatesPerSplit = 3;                 // a third is split at once, at most
constexpr float kChildScale = 0.6f, kChildOtherScale = 0.92f;  // along the axis, along the others

/// The source of a Gaussian: itself, or one of the halves of a split one.
struct Source {
  std::uint32_t part;  ///< 0: the world, from 1 on actors
  std::uint32_t key;   ///< on the Morton curve
  std::uint32_t from;
  std::int32_t half;  ///< 0: whole; 1, -1: halves along the longest axis
};

int longest_axis(const float* numbers, std::size_t i) {
  int axis = 0;
  for (int k = 1; k < 3; ++k)
    if (numbers[gaussian_slot(i, kLogScaleRow + k)] >
        numbers[gaussian_slot(i, kLogScaleRow + axis)])
      axis = k;
  return axis;
}

/// Direction of a Gaussian's axis in the world times its standard deviation.
std::array<float, 3> axis_of(const float* numbers, std::size_t i, int axis) {
  float q[4], norm = 0;
  for (int k = 0; k < 4; ++k) {
    q[k] = numbers[gaussian_slot(i, kQuaternionRow + k)];
    norm += q[k] * q[k];
  }
  for (float& x : q) x /= std::sqrt(norm);
  float r[3][3];
  rotation_from_quaternion<NumberMath<float>>(q, r);
  const float scale = std::exp(numbers[gaussian_slot(i, kLogScaleRow + axis)]);
  return {scale * r[0][axis], scale * r[1][axis], scale * r[2][axis]};
}

/// Whether a Gaussian is within the bounds of its part.
bool within_bounds(const DensifyOptions& options, std::size_t part, const float* numbers,
                   std::size_t i) {
  if (part == 0 || options.actor_bounds.empty()) return true;
  const Eigen::Vector3f& bound = options.actor_bounds[part - 1];
  const auto at = [&](int k) { return numbers[gaussian_slot(i, kPositionRow + k)]; };
  const float beside = at(2) <= kShadowHeight_m - bound.z() ? kShadow_m : 0;
  const float ahead = beside > 0 ? options.ahead_m : 0;
  return -at(0) <= bound.x() + beside && at(0) <= bound.x() + ahead &&
         std::fabs(at(1)) <= bound.y() + beside && std::fabs(at(2)) <= bound.z();
}

/// A Gaussian that may stay, and the time at which it is drawn for a split; infinite: never.
struct SplitCandidate {
  Source source;
  bool stays = false;
  float time = std::numeric_limits<float>::infinity();
};

/// Whether Gaussian i has an error and is large enough to be split.
bool can_split(const DensifyOptions& options, const float* numbers, std::span<const float> errors,
               std::size_t i) {
  const float scale = std::exp(numbers[gaussian_slot(i, kLogScaleRow + longest_axis(numbers, i))]);
  return errors[i] > 0 && scale > options.min_scale * numbers[gaussian_slot(i, kDistanceRow)];
}

/// Returns the error below which a Gaussian of the world is replaced. Gaussians without an error,
/// which no image saw lately, stay. Where few can be split, fewer are replaced. least_opacity: its
/// logit; Gaussians below it are removed anyhow.
float least_error(const DensifyOptions& options, const GaussianLayout& layout, float least_opacity,
                  const float* numbers, std::span<const float> errors) {
  if (options.replaced == 0) return 0;
  std::vector<float> seen;
  std::size_t alive = 0, candidates = 0;
  for (std::size_t i = 0; i < errors.size(); ++i) {
    if (!(numbers[gaussian_slot(i, kOpacityRow)] >= least_opacity)) continue;
    ++alive;
    candidates += can_split(options, numbers, errors, i);
    if (i < layout.world && errors[i] > 0) seen.push_back(errors[i]);
  }
  // Each that is replaced takes a split, as growth does, and may have been a candidate itself.
  const std::size_t grows = options.target - std::min(options.target, alive),
                    others = candidates - std::min(candidates, kCandidatesPerSplit * grows),
                    replaced = std::min(
                        static_cast<std::size_t>(double(options.replaced) * double(seen.size())),
                        others / (kCandidatesPerSplit + 1));
  if (replaced == 0) return 0;
  const auto least = seen.begin() + static_cast<std::ptrdiff_t>(replaced);
  std::nth_element(seen.begin(), least, seen.end());
  return *least;
}

/// Sorts by an order in which no two are equal.
template <class Less>
void sort_sources(const Less& less, ThreadPool& pool, std::vector<Source>* sources) {
  constexpr std::size_t kRun = 1 << 14;
  const auto at = [&](std::size_t i) { return sources->begin() + static_cast<std::ptrdiff_t>(i); };
  pool.run_ranges(sources->size(), kRun,
                  [&](std::size_t begin, std::size_t end) { std::sort(at(begin), at(end), less); });
  for (std::size_t run = kRun; run < sources->size(); run *= 2)
    pool.run_ranges(sources->size(), 2 * run, [&](std::size_t begin, std::size_t end) {
      if (end - begin > run) std::inplace_merge(at(begin), at(begin + run), at(end), less);
    });
}

/// Returns the sources of the Gaussians, ordered by part and Morton key.
std::vector<Source> choose_sources(const DensifyOptions& options, std::uint64_t key,
                                   const GaussianLayout& layout, const float* p,
                                   std::span<const float> errors, ThreadPool& pool) {
  const std::size_t parts = 1 + layout.actor_ends.size();
  const float least =
      std::max(std::log(options.min_opacity / (1 - options.min_opacity)), kUnusedOpacity + 1);
  const float least_of_world = least_error(options, layout, least, p, errors);
  std::vector<Source> sources;                              // whole ones at first
  std::vector<std::pair<float, std::uint32_t>> candidates;  // drawn in ascending order
  std::vector<SplitCandidate> of_part;
  for (std::uint32_t part = 0; part < parts; ++part) {
    const std::size_t first = first_of(layout, part), n = first_of(layout, part + 1) - first;
    of_part.assign(n, {});
    pool.run_ranges(n, kGaussiansPerRange, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = first + begin; i < first + end; ++i) {
        // Unused lanes are transparent.
        if (!(p[gaussian_slot(i, kOpacityRow)] >= least)) continue;
        if (!within_bounds(options, part, p, i)) continue;
        const float error = errors[i];
        if (part == 0 && error > 0 && error < least_of_world) continue;
        SplitCandidate& candidate = of_part[i - first];
        float position[3];
        for (int k = 0; k < 3; ++k) position[k] = p[gaussian_slot(i, kPositionRow + k)];
        candidate.stays = true;
        candidate.source = {part, morton_key(position), static_cast<std::uint32_t>(i), 0};
        if (can_split(options, p, errors, i))
          candidate.time = -std::log(std::max(random_unit(key, i), 1e-9f)) / error;
      }
    });
    for (const SplitCandidate& candidate : of_part) {
      if (!candidate.stays) continue;
      if (std::isfinite(candidate.time))
        candidates.emplace_back(candidate.time, static_cast<std::uint32_t>(sources.size()));
      sources.push_back(candidate.source);
    }
  }
  const std::size_t alive = sources.size(),
                    wanted = options.target > alive ? options.target - alive : 0,
                    split = std::min(wanted, candidates.size() / kCandidatesPerSplit);
  std::nth_element(candidates.begin(), candidates.begin() + static_cast<std::ptrdiff_t>(split),
                   candidates.end());
  candidates.resize(split);
  for (const auto& [time, which] : candidates) {
    sources[which].half = 1;
    sources.push_back(sources[which]);
    sources.back().half = -1;
  }
  const auto place = [](const Source& s) { return std::tuple(s.part, s.key, s.from, -s.half); };
  sort_sources([&](const Source& a, const Source& b) { return place(a) < place(b); }, pool,
               &sources);
  return sources;
}

}  // namespace

void densify(const DensifyOptions& options, std::uint64_t key, GaussianLayout* layout,
             Buffer<float>* numbers, Buffer<std::uint32_t>* moments, Buffer<float>* errors,
             ThreadPool& pool) {
  const float* const p = numbers->data();
  const std::vector<Source> sources = choose_sources(options, key, *layout, p, *errors, pool);
  std::vector<std::size_t> sizes(1 + layout->actor_ends.size());
  for (const Source& source : sources) ++sizes[source.part];
  const std::vector<std::size_t> filled = sizes;
  sizes[0] += options.spare;
  const std::size_t old_size = layout->blocks() * kBlockSize;
  *layout = layout_of(std::span<const std::size_t>(sizes));
  const std::size_t size = layout->blocks() * kBlockSize;
  // Calls body(source, slot) for each Gaussian.
  std::vector<std::size_t> ahead;  // first slot of a part less its first source
  for (std::size_t part = 0, first = 0; part < filled.size(); first += filled[part++])
    ahead.push_back(first_of(*layout, part) - first);
  const auto for_each = [&](const auto& body) {
    pool.run_ranges(sources.size(), kGaussiansPerRange, [&](std::size_t begin, std::size_t end) {
      for (std::size_t s = begin; s < end; ++s) body(sources[s], ahead[sources[s].part] + s);
    });
  };
  const auto moved = [&]<class T>(const Buffer<T>& before) {
    const std::size_t others = before.size() - old_size;
    Buffer<T> to(size + others);
    for_each([&](const Source& source, std::size_t i) {
      for (int row = 0; row < kGaussianRows; ++row)
        to[gaussian_slot(i, row)] = before[gaussian_slot(source.from, row)];
    });
    std::copy_n(before.data() + old_size, others, to.data() + size);
    return to;
  };
  // One by one, so that only one of them is in memory twice.
  *errors = Buffer<float>(size / kGaussianRows);
  *moments = moved(*moments);
  for_each([&](const Source& source, std::size_t i) {
    for (int row = 0; source.half < 0 && row < kDistanceRow; ++row) {
      std::uint32_t& packed = (*moments)[gaussian_slot(i, row)];
      packed = pack_moments(0, unpacked_second(packed));
    }
  });
  Buffer<float> to = moved(*numbers);
  for_each([&](const Source& source, std::size_t i) {
    if (source.half == 0) return;
    const int axis = longest_axis(p, source.from);
    const std::array<float, 3> along = axis_of(p, source.from, axis);
    for (int k = 0; k < 3; ++k) {
      to[gaussian_slot(i, kPositionRow + k)] +=
          kChildOffset * static_cast<float>(source.half) * along[k];
      to[gaussian_slot(i, kLogScaleRow + k)] +=
          std::log(k == axis ? kChildScale : kChildOtherScale);
    }
  });
  for (std::size_t part = 0; part < sizes.size(); ++part)
    clear_unused(first_of(*layout, part) + filled[part], first_of(*layout, part + 1), to.data());
  *numbers = std::move(to);
}

}  // namespace redrive

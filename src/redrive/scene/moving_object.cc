// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/moving_object.h"

#include <algorithm>

namespace redrive {
namespace {

constexpr std::int64_t kMaxGap_ns = 500'000'000;            // between keys that are interpolated
constexpr std::int64_t kMaxExtrapolation_ns = 100'000'000;  // a missing revolution or frame

}  // namespace

std::optional<Rigid3d> MovingObject::world_from_box(std::int64_t t_ns) const {
  for (const auto& [from_ns, to_ns] : hidden_ns)
    if (from_ns <= t_ns && t_ns <= to_ns) return std::nullopt;
  const auto after = std::ranges::lower_bound(keys, t_ns, {}, &Key::t_ns);
  if (after != keys.begin() && after != keys.end()) {
    const Key &a = *(after - 1), &b = *after;
    if (b.t_ns - a.t_ns <= kMaxGap_ns)
      return interpolate(a.world_from_box, b.world_from_box,
                         static_cast<double>(t_ns - a.t_ns) / static_cast<double>(b.t_ns - a.t_ns));
  }
  auto nearest = after;
  if (after == keys.end() ||
      (after != keys.begin() && t_ns - (after - 1)->t_ns < after->t_ns - t_ns))
    --nearest;
  const std::int64_t later_ns = t_ns - nearest->t_ns;
  if (std::abs(later_ns) > kMaxExtrapolation_ns) return std::nullopt;
  Rigid3d pose = nearest->world_from_box;
  pose.translation() += 1e-9 * static_cast<double>(later_ns) * nearest->velocity_in_world_m_per_s;
  return pose;
}

}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/moving_object.h"

#include <algorithm>
#include <cstdlib>

#include "redrive/recording/core/actor_kind.h"

namespace redrive {
namespace {

constexpr std::int64_t kMaxGap_ns = 500'000'000;  // largest gap between keys that is interpolated
constexpr std::int64_t kMaxExtrapolation_ns = 100'000'000;  // covers a missing scan or frame

}  // namespace

std::optional<KeyTime> MovingObject::key_time(std::int64_t t_ns) const {
  const auto next =
      static_cast<std::size_t>(std::ranges::upper_bound(keys, t_ns, {}, &Key::t_ns) - keys.begin());
  if (next > 0 && next < keys.size()) {
    const std::int64_t from_ns = keys[next - 1].t_ns, to_ns = keys[next].t_ns;
    if (to_ns - from_ns <= kMaxGap_ns)
      return KeyTime{next - 1, next,
                     static_cast<double>(t_ns - from_ns) / static_cast<double>(to_ns - from_ns)};
  }
  const bool is_later =
      next == keys.size() || (next > 0 && t_ns - keys[next - 1].t_ns < keys[next].t_ns - t_ns);
  const std::size_t nearest = is_later ? next - 1 : next;
  if (std::abs(t_ns - keys[nearest].t_ns) > kMaxExtrapolation_ns) return std::nullopt;
  return KeyTime{nearest, nearest, 0};
}

std::optional<Rigid3d> MovingObject::world_from_box(std::int64_t t_ns, Poses which) const {
  for (const auto& [from_ns, to_ns] : hidden_ns)
    if (from_ns <= t_ns && t_ns <= to_ns) return std::nullopt;
  const auto at = key_time(t_ns);
  if (!at) return std::nullopt;
  const Key& before = keys[at->before];
  Rigid3d pose = before.world_from_box;
  if (at->after != at->before)
    pose = kind_of(type).between(pose, keys[at->after].world_from_box, at->part);
  else
    pose.translation() +=
        1e-9 * static_cast<double>(t_ns - before.t_ns) * before.velocity_in_world_m_per_s;
  if (which == Poses::kRecorded || corrections.empty()) return pose;
  const auto six =
      interpolate_vector6(&corrections[6 * at->before], &corrections[6 * at->after], at->part);
  return pose * rigid_from_vector(six.data());
}

void MovingObject::apply_corrections() {
  for (std::size_t k = 0; 6 * k < corrections.size(); ++k)
    keys[k].world_from_box = keys[k].world_from_box * rigid_from_vector(&corrections[6 * k]);
  corrections.clear();
}

}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
// What batches are gathered from (kernels/gather/gather_pixels.h, gather_returns.h), on a device:
// pictures of 8 bits a channel, tables of rays, poses, or LiDAR returns, each in one piece of
// memory.
#pragma once

#include <cstddef>
#include <memory>
#include <span>
#include <vector>

#include "redrive/base/error.h"
#include "redrive/kernels/gather/gather_pixels.h"
#include "redrive/kernels/gather/gather_returns.h"

namespace redrive::kernels {

/// `from` with `place(span)` in place of each of its spans, the innermost first.
template <class Place>
PixelSpans with_relocated_spans(const PixelSpans& from, const Place& place) {
  std::vector<RayTableSpans> tables(from.tables.begin(), from.tables.end());
  for (RayTableSpans& table : tables) {
    table.pixel = place(table.pixel);
    table.direction = place(table.direction);
  }
  std::vector<TrainingImage> images(from.images.begin(), from.images.end());
  for (TrainingImage& image : images)
    for (auto* const bytes : {&image.rgb, &image.alpha, &image.used}) *bytes = place(*bytes);
  std::vector<PixelPool> pools(from.pools.begin(), from.pools.end());
  for (PixelPool& pool : pools) {
    pool.bits = place(pool.bits);
    pool.before = place(pool.before);
  }
  PixelSpans out = from;
  out.tables = place(std::span<const RayTableSpans>(tables));
  out.images = place(std::span<const TrainingImage>(images));
  out.pools = place(std::span<const PixelPool>(pools));
  out.offsets = place(from.offsets);
  out.poses = place(from.poses);
  out.cell_images = place(from.cell_images);
  out.cell_pixels = place(from.cell_pixels);
  return out;
}

template <class Place>
LidarSpans with_relocated_spans(const LidarSpans& from, const Place& place) {
  LidarSpans out = from;
  for (auto* const numbers : {&out.origin, &out.direction, &out.range_m})
    *numbers = place(*numbers);
  out.t_ns = place(from.t_ns);
  out.recorded = place(from.recorded);
  out.poses = place(from.poses);
  return out;
}

/// Bytes from one span's place to the next one's.
constexpr std::size_t aligned_size(std::size_t bytes) {
  return (bytes + 15) / 16 * 16;
}  // whatever is in it is aligned

template <class Spans>
struct ResidentSource {
  std::shared_ptr<void> memory;
  Spans there;
  int pose_version = 0;  ///< GatherSource's, as of the poses there
};

template <class Device, class Spans>
std::shared_ptr<ResidentSource<Spans>> copy_source_to_device(Device& device,
                                                             const GatherSource<Spans>& from) {
  std::size_t bytes = 0;
  with_relocated_spans(from, [&](auto span) {
    bytes += aligned_size(span.size_bytes());
    return span;
  });
  const auto kept = std::make_shared<ResidentSource<Spans>>();
  kept->memory = device.hold(bytes);
  std::size_t used = 0;
  kept->there = with_relocated_spans(from, [&](auto span) {
    std::byte* const place = static_cast<std::byte*>(kept->memory.get()) + used;
    if (!span.empty()) device.to_device(place, span.data(), span.size_bytes());
    used += aligned_size(span.size_bytes());
    return decltype(span)(reinterpret_cast<decltype(span.data())>(place), span.size());
  });
  REDRIVE_CHECK_OP(used, ==, bytes);
  kept->pose_version = from.pose_version;
  return kept;
}

/// Where `from` is kept, its poses as they are now.
template <class Device, class Spans>
const Spans& there(Device& device, const GatherSource<Spans>& from) {
  if (!from.resident) from.resident = copy_source_to_device(device, from);
  auto& kept = *static_cast<ResidentSource<Spans>*>(from.resident.get());
  if (kept.pose_version != from.pose_version) {
    REDRIVE_CHECK_OP(kept.there.poses.size(), ==, from.poses.size());
    const void* const poses = kept.there.poses.data();
    device.to_device(const_cast<void*>(poses), from.poses.data(), from.poses.size_bytes());
    kept.pose_version = from.pose_version;
  }
  return kept.there;
}

}  // namespace redrive::kernels

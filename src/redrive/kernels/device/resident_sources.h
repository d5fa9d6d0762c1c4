// SPDX-License-Identifier: Apache-2.0
// Sources of gathered batches (gather/gather_pixels.h, gather_returns.h) on a device: images of 8
// bits per channel, ray tables, poses, or LiDAR returns, each source in one block of memory.
#pragma once

#include <cstddef>
#include <memory>
#include <span>
#include <vector>

#include "redrive/base/error.h"
#include "redrive/kernels/gather/gather_pixels.h"
#include "redrive/kernels/gather/gather_returns.h"

namespace redrive::kernels {

/// Returns `from` with each span replaced by relocate(span), the innermost first.
template <class Relocate>
PixelSpans with_relocated_spans(const PixelSpans& from, const Relocate& relocate) {
  std::vector<RayTableSpans> tables(from.tables.begin(), from.tables.end());
  for (RayTableSpans& table : tables) {
    table.pixel = relocate(table.pixel);
    table.direction = relocate(table.direction);
  }
  std::vector<TrainingImage> images(from.images.begin(), from.images.end());
  for (TrainingImage& image : images)
    for (auto* const bytes : {&image.rgb, &image.alpha, &image.used}) *bytes = relocate(*bytes);
  std::vector<PixelPool> pools(from.pools.begin(), from.pools.end());
  for (PixelPool& pool : pools) {
    pool.bits = relocate(pool.bits);
    pool.before = relocate(pool.before);
  }
  PixelSpans out = from;
  out.tables = relocate(std::span<const RayTableSpans>(tables));
  out.images = relocate(std::span<const TrainingImage>(images));
  out.pools = relocate(std::span<const PixelPool>(pools));
  out.offsets = relocate(from.offsets);
  out.poses = relocate(from.poses);
  out.cell_images = relocate(from.cell_images);
  out.cell_pixels = relocate(from.cell_pixels);
  return out;
}

template <class Relocate>
LidarSpans with_relocated_spans(const LidarSpans& from, const Relocate& relocate) {
  LidarSpans out = from;
  for (auto* const numbers : {&out.origin, &out.direction, &out.range_m})
    *numbers = relocate(*numbers);
  out.t_ns = relocate(from.t_ns);
  out.recorded = relocate(from.recorded);
  out.poses = relocate(from.poses);
  return out;
}

/// Bytes from the start of one span to that of the next.
constexpr std::size_t aligned_size(std::size_t bytes) {
  return (bytes + 15) / 16 * 16;
}  // keeps numbers of any type aligned

template <class Spans>
struct ResidentSource {
  std::shared_ptr<void> memory;
  Spans spans;
  int pose_version = 0;  ///< GatherSource's, of the poses in `spans`
};

template <class Device, class Spans>
std::shared_ptr<ResidentSource<Spans>> copy_source_to_device(Device& device,
                                                             const GatherSource<Spans>& from) {
  std::size_t bytes = 0;
  with_relocated_spans(from, [&](auto span) {
    bytes += aligned_size(span.size_bytes());
    return span;
  });
  const auto resident = std::make_shared<ResidentSource<Spans>>();
  resident->memory = device.hold(bytes);
  std::size_t used = 0;
  resident->spans = with_relocated_spans(from, [&](auto span) {
    std::byte* const address = static_cast<std::byte*>(resident->memory.get()) + used;
    if (!span.empty()) device.to_device(address, span.data(), span.size_bytes());
    used += aligned_size(span.size_bytes());
    return decltype(span)(reinterpret_cast<decltype(span.data())>(address), span.size());
  });
  REDRIVE_CHECK_OP(used, ==, bytes);
  resident->pose_version = from.pose_version;
  return resident;
}

/// Returns the device's copy of `from` with its current poses. Makes the copy at the first call.
template <class Device, class Spans>
const Spans& resident_spans(Device& device, const GatherSource<Spans>& from) {
  if (!from.resident) from.resident = copy_source_to_device(device, from);
  auto& resident = *static_cast<ResidentSource<Spans>*>(from.resident.get());
  if (resident.pose_version != from.pose_version) {
    REDRIVE_CHECK_OP(resident.spans.poses.size(), ==, from.poses.size());
    const void* const poses = resident.spans.poses.data();
    device.to_device(const_cast<void*>(poses), from.poses.data(), from.poses.size_bytes());
    resident.pose_version = from.pose_version;
  }
  return resident.spans;
}

}  // namespace redrive::kernels

// SPDX-License-Identifier: Apache-2.0
// Stages of backend.h that draw training rays and update the error map, as functors for one ray.
// Their spans are on the device.
#pragma once

#include "redrive/kernels/device/device_math.h"
#include "redrive/kernels/gather/gather_pixels.h"
#include "redrive/kernels/gather/gather_returns.h"

namespace redrive::kernels {

struct GatherRays {
  PixelSpans from;
  PixelDraw draw;
  std::span<const float> errors;
  GatheredRays out;
  std::span<CellSample> drawn;  ///< of the rays drawn by the error map

  REDRIVE_HD void operator()(std::size_t i) const {
    const CellSample error_map_rays = gather_pixel(from, draw, errors, i, out);
    if (i >= static_cast<std::size_t>(draw.epoch_rays)) drawn[i - draw.epoch_rays] = error_map_rays;
  }
};

struct DrawnPixelSum {
  std::span<const CellSample> drawn;

  REDRIVE_HD double operator()(std::size_t i) const { return drawn[i].pixels; }
};
struct DrawnErrorSum {
  std::span<const CellSample> drawn;

  REDRIVE_HD double operator()(std::size_t i) const { return drawn[i].error; }
};

struct WeightRays {
  PixelDraw draw;
  std::span<const float> errors;
  std::span<const double> pixels, error;  ///< sums, one number each
  GatheredRays out;

  REDRIVE_HD void operator()(std::size_t i) const {
    write_ray_weight(draw, errors, pixels[0], error[0], i, out);
  }
};

struct GatherReturns {
  LidarSpans from;
  LidarDraw draw;
  GatheredReturns out;

  REDRIVE_HD void operator()(std::size_t i) const { gather_return(from, draw, i, out); }
};

/// Linked lists of the rays of each cell, in the order of the threads.
constexpr std::uint32_t kNoRay = ~0u;
struct CellRayLists {
  std::span<const std::uint32_t> cells;
  std::span<std::uint32_t> first, next;  ///< [all cells], set for cells with rays; [rays]
};
struct ClearRayLists {
  CellRayLists rays;

  REDRIVE_HD void operator()(std::size_t i) const { rays.first[rays.cells[i]] = kNoRay; }
};
struct LinkRays {
  CellRayLists rays;

  REDRIVE_HD void operator()(std::size_t i) const {
    rays.next[i] = atomic_exchange(&rays.first[rays.cells[i]], static_cast<std::uint32_t>(i));
  }
};
/// The ray at the head of its cell's list updates the cell by all its rays in ascending order.
/// Lists are short.
struct UpdateErrorMap {
  CellRayLists rays;
  std::span<const float> squares;
  std::span<float> errors;

  REDRIVE_HD void operator()(std::size_t i) const {
    const std::uint32_t cell = rays.cells[i], head = rays.first[cell];
    if (head != i) return;
    float error = errors[cell];
    for (std::uint32_t done = kNoRay;;) {  // kNoRay + 1 is 0
      std::uint32_t least = kNoRay;
      for (std::uint32_t ray = head; ray != kNoRay; ray = rays.next[ray])
        if (ray >= done + 1 && ray < least) least = ray;
      if (least == kNoRay) break;
      error = updated_error(error, squares[least]);
      done = least;
    }
    errors[cell] = error;
  }
};

}  // namespace redrive::kernels

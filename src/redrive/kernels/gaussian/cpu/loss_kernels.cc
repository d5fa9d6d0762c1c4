// SPDX-License-Identifier: Apache-2.0
// The loss of an image, row by row. Compiled once per instruction set: REDRIVE_ISA names the
// namespace.
#include "redrive/kernels/cpu/simd/lane_math.h"
#include "redrive/kernels/gaussian/cpu/tile_kernels.h"
#include "redrive/optim/ssim_gradient.h"

namespace redrive::kernels::REDRIVE_ISA {
namespace {

constexpr int kRadius = 5, kTaps = 2 * kRadius + 1;

/// Masks both images; writes the derivative of the L1 loss and the error of each pixel.
REDRIVE_INLINE void mask_row(const LossJob& job, std::size_t row, LossSums* sums) {
  Vf squares{}, absolute{};
  const Vf zero{}, scale = splat(job.l1_scale);
  for (std::size_t i = row; i < row + job.stride; i += kLanes) {
    const Vf mask = load(job.mask + i);
    Vf error{};
    for (int c = 0; c < 3; ++c) {
      const std::size_t at = c * job.plane + i;
      const Vf x = load(job.rgb + at) * load(job.gains + at) * mask,
               y = load(job.target + at) * mask, off = x - y, size = magnitude_of(off);
      store(job.masked + at, x);
      store(job.masked + 3 * job.plane + at, y);
      store(job.d_rgb + at, (off > zero ? scale : off < zero ? -scale : zero) * mask);
      squares += off * off;
      error += size;
    }
    absolute += error;
    store(job.error + i, error * splat(1.0f / 3));
  }
  sums->squares = static_cast<double>(sum(squares));
  sums->l1 = static_cast<double>(sum(absolute)) * static_cast<double>(job.l1_scale);
}

/// Copies a row between zeros, so that the window may reach beyond its ends.
REDRIVE_INLINE void pad_row(const float* from, std::size_t stride, float* to) {
  for (int i = 0; i < kRadius; ++i) to[i] = 0;
  for (std::size_t i = 0; i < stride; i += kLanes) store(to + kRadius + i, load(from + i));
  for (int i = 0; i < kRadius + kLanes; ++i) to[kRadius + stride + static_cast<std::size_t>(i)] = 0;
}

REDRIVE_INLINE void moments_along_row(const LossJob& job, std::size_t row, float* scratch) {
  float *const a = scratch, *const b = scratch + job.stride + 2 * kRadius + kLanes;
  for (int c = 0; c < 3; ++c) {
    pad_row(job.masked + c * job.plane + row, job.stride, a);
    pad_row(job.masked + (3 + c) * job.plane + row, job.stride, b);
    float* const out = job.moments + 5 * c * job.plane + row;
    for (std::size_t i = 0; i < job.stride; i += kLanes) {
      Vf m[5] = {};
      for (int j = 0; j < kTaps; ++j) {
        const Vf x = load(a + i + j), y = load(b + i + j), kx = splat(job.taps[j]) * x,
                 ky = splat(job.taps[j]) * y;
        m[0] += kx;
        m[1] += ky;
        m[2] += kx * x;
        m[3] += ky * y;
        m[4] += kx * y;
      }
      for (int k = 0; k < 5; ++k) store(out + k * job.plane + i, m[k]);
    }
  }
}

/// Rows of the window around row y that lie in the image.
struct WindowRows {
  int first, end;
};
REDRIVE_INLINE WindowRows window_rows(const LossJob& job, int y) {
  return {y < kRadius ? kRadius - y : 0,
          y + kRadius >= job.height ? job.height - y + kRadius : kTaps};
}

/// Filters kPlanes planes along their columns, at i of row y of the first one.
template <int kPlanes>
REDRIVE_INLINE void filter_along_columns(const LossJob& job, int y, const float* first,
                                         std::size_t i, Vf* out) {
  const WindowRows window = window_rows(job, y);
  for (int k = 0; k < kPlanes; ++k) out[k] = Vf{};
  for (int j = window.first; j < window.end; ++j) {
    const float* const in =
        first + i +
        static_cast<std::ptrdiff_t>(j - kRadius) * static_cast<std::ptrdiff_t>(job.stride);
    for (int k = 0; k < kPlanes; ++k) out[k] += splat(job.taps[j]) * load(in + k * job.plane);
  }
}

REDRIVE_INLINE void slopes_of_row(const LossJob& job, int y, std::size_t row, LossSums* sums) {
  Vf total{};
  for (int c = 0; c < 3; ++c)
    for (std::size_t i = row; i < row + job.stride; i += kLanes) {
      Vf m[5];
      filter_along_columns<5>(job, y, job.moments + 5 * c * job.plane, i, m);
      const SsimGradient<LaneMath> s = ssim_gradient<LaneMath>(m[0], m[1], m[2], m[3], m[4]);
      const Vf mask = load(job.mask + i), scale = mask * splat(-0.5f * job.ssim_scale);
      total += mask * (splat(1.0f) - s.ssim);
      float* const out = job.slopes + 3 * c * job.plane + i;
      store(out, s.by_x * scale);
      store(out + job.plane, s.by_xx * scale);
      store(out + 2 * job.plane, s.by_xy * scale);
    }
  sums->ssim = 0.5 * static_cast<double>(job.ssim_scale) * static_cast<double>(sum(total));
}

/// Filters the slopes into planes of moments, which are free again.
REDRIVE_INLINE void filter_slopes_along_row(const LossJob& job, std::size_t row, float* scratch) {
  for (int k = 0; k < 9; ++k) {
    pad_row(job.slopes + k * job.plane + row, job.stride, scratch);
    for (std::size_t i = 0; i < job.stride; i += kLanes) {
      Vf m{};
      for (int j = 0; j < kTaps; ++j) m += splat(job.taps[j]) * load(scratch + i + j);
      store(job.moments + k * job.plane + row + i, m);
    }
  }
}

REDRIVE_INLINE void finish_row(const LossJob& job, int y, std::size_t row) {
  for (int c = 0; c < 3; ++c)
    for (std::size_t i = row; i < row + job.stride; i += kLanes) {
      const std::size_t at = c * job.plane + i;
      const Vf mask = load(job.mask + i);
      Vf d = load(job.d_rgb + at);
      if (job.ssim_scale > 0) {
        Vf m[3];
        filter_along_columns<3>(job, y, job.moments + 3 * c * job.plane, i, m);
        const Vf x = load(job.masked + at), y_ = load(job.masked + 3 * job.plane + at);
        d += (m[0] + splat(2.0f) * x * m[1] + y_ * m[2]) * mask;
      }
      store(job.d_rgb + at, d * load(job.gains + at));
    }
}

}  // namespace

void loss_row(const LossJob& job, int pass, int y, float* scratch, LossSums* sums) {
  const std::size_t row = static_cast<std::size_t>(y) * job.stride;
  switch (pass) {
    case 0: return mask_row(job, row, sums);
    case 1: return moments_along_row(job, row, scratch);
    case 2: return slopes_of_row(job, y, row, sums);
    case 3: return filter_slopes_along_row(job, row, scratch);
    default: return finish_row(job, y, row);
  }
}

}  // namespace redrive::kernels::REDRIVE_ISA

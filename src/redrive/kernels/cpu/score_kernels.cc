// SPDX-License-Identifier: Apache-2.0
// Compiled once per instruction set: REDRIVE_ISA names the namespace.
#include "redrive/kernels/cpu/score_kernels.h"

#include "redrive/kernels/cpu/simd/lane_math.h"
#include "redrive/optim/ssim_gradient.h"

namespace redrive::kernels::REDRIVE_ISA {
namespace {

typedef float HalfOfVf __attribute__((vector_size(kLanes * 2)));
typedef HalfOfVf UnalignedHalf __attribute__((aligned(4)));
typedef double Vd __attribute__((vector_size(kLanes * 4)));

REDRIVE_INLINE Vd load_doubles(const float* p) {
  return __builtin_convertvector(*reinterpret_cast<const UnalignedHalf*>(p), Vd);
}
REDRIVE_INLINE double sum_of_doubles(Vd v) {
  double all = 0;
  for (int i = 0; i < kLanes / 2; ++i) all += v[i];
  return all;
}

REDRIVE_INLINE float* row_of(const ScoreJob& job, int image, int plane, int y) {
  return job.planes + (static_cast<std::size_t>(kScorePlanes * image + plane) *
                           static_cast<std::size_t>(job.height) +
                       static_cast<std::size_t>(y)) *
                          job.stride;
}
REDRIVE_INLINE bool counts(const ScoreJob& job, int x, int y) {
  return !job.mask || job.mask[static_cast<std::size_t>(y) * static_cast<std::size_t>(job.width) +
                               static_cast<std::size_t>(x)] != 0;
}

void fill_row(const ScoreJob& job, int y, ScoreSums* sums) {
  float* rows[2][kScorePlanes];
  for (int image = 0; image < 2; ++image)
    for (int plane = 0; plane < kScorePlanes; ++plane)
      rows[image][plane] = row_of(job, image, plane, y);
  const std::size_t first = static_cast<std::size_t>(y) * static_cast<std::size_t>(job.width);
  for (std::size_t x = 0; x < job.stride; ++x) {
    const bool used =
        x < static_cast<std::size_t>(job.width) && counts(job, static_cast<int>(x), y);
    sums->pixels += used;
    for (std::size_t c = 0; c < 3; ++c) {
      const std::size_t at = 3 * (first + x) + c;
      rows[0][c][x] = used ? job.rgb[at] : 0.0f;
      rows[1][c][x] = used ? static_cast<float>(job.ground_truth[at]) / 255.0f : 0.0f;
    }
  }
  Vd luma_squares{}, squares[3] = {};
  for (std::size_t x = 0; x < job.stride; x += kLanes / 2) {
    Vd all{};
    for (int c = 0; c < 3; ++c) {
      const Vd error = load_doubles(rows[0][c] + x) - load_doubles(rows[1][c] + x);
      squares[c] += error * error;
      all += error;
    }
    luma_squares += all * all / 9.0;
  }
  sums->luma_squares += sum_of_doubles(luma_squares);
  for (int c = 0; c < 3; ++c) sums->squares[c] += sum_of_doubles(squares[c]);
  for (float** const planes : {rows[0], rows[1]})
    for (std::size_t x = 0; x < job.stride; x += kLanes) {
      const Vf srgb[] = {load(planes[0] + x), load(planes[1] + x), load(planes[2] + x)};
      Vf opponent[3];
      flip_opponent<LaneMath>(srgb, opponent);
      for (int c = 0; c < 3; ++c) store(planes[3 + c] + x, opponent[c]);
    }
}

/// Row `row` of the scratch memory; it may be read up to kScoreRoom beyond both ends.
REDRIVE_INLINE float* scratch_row(const ScoreJob& job, float* scratch, int row) {
  return scratch + static_cast<std::size_t>(row) * (job.stride + 2 * kScoreRoom) + kScoreRoom;
}

/// Writes 1 for the pixels from `first` on that count, of `n` at most, and 0 beyond; returns their
/// number.
REDRIVE_INLINE int mask_row(const ScoreJob& job, int y, int first, int n, float* out) {
  int used = 0;
  for (int x = 0; x < static_cast<int>(job.stride); ++x) {
    const bool here = x < n && counts(job, first + x, y);
    out[x] = here ? 1.0f : 0.0f;
    used += here;
  }
  return used;
}

REDRIVE_INLINE void add_ssim(const ScoreJob& job, int y, float* scratch, ScoreSums* sums) {
  const int across = job.width - 2 * kSsimRadius;
  if (across < 1 || y < kSsimRadius || y >= job.height - kSsimRadius) return;
  float *const mask = scratch_row(job, scratch, 0), *columns[5];
  sums->windows += mask_row(job, y, kSsimRadius, across, mask);
  for (int k = 0; k < 5; ++k) columns[k] = scratch_row(job, scratch, 1 + k);
  Vf total{};
  for (int c = 0; c < 3; ++c) {
    const float *const a = row_of(job, 0, c, y - kSsimRadius), *const b = row_of(job, 1, c,
                                                                                 y - kSsimRadius);
    for (std::size_t x = 0; x < job.stride; x += kLanes) {
      Vf m[5] = {};
      for (std::size_t i = 0; i < kSsimTaps; ++i) {
        const Vf u = load(a + i * job.stride + x), v = load(b + i * job.stride + x),
                 tap = splat(job.taps[i]), tu = tap * u, tv = tap * v;
        m[0] += tu;
        m[1] += tv;
        m[2] += tu * u;
        m[3] += tv * v;
        m[4] += tu * v;
      }
      for (int k = 0; k < 5; ++k) store(columns[k] + x, m[k]);
    }
    for (std::size_t x = 0; x < job.stride; x += kLanes) {
      Vf m[5] = {};
      for (int i = 0; i < kSsimTaps; ++i)
        for (int k = 0; k < 5; ++k) m[k] += splat(job.taps[i]) * load(columns[k] + x + i);
      const Vf ssim = ssim_gradient<LaneMath>(m[0], m[1], m[2], m[3], m[4]).ssim;
      total += load(mask + x) > Vf{} ? ssim : Vf{};
    }
  }
  sums->ssim += static_cast<double>(sum(total));
}

/// Filters the columns of a plane at row y; its ends go on beyond the row's.
template <int kTaps>
REDRIVE_INLINE void filter_columns(const ScoreJob& job, const float* plane, int y,
                                   const float* taps, float* out) {
  const float* rows[kTaps];
  for (int i = 0; i < kTaps; ++i) {
    const int at = y + i - kTaps / 2, row = at < 0 ? 0 : at < job.height ? at : job.height - 1;
    rows[i] = plane + static_cast<std::size_t>(row) * job.stride;
  }
  for (std::size_t x = 0; x < job.stride; x += kLanes) {
    Vf all{};
    for (int i = 0; i < kTaps; ++i) all += splat(taps[i]) * load(rows[i] + x);
    store(out + x, all);
  }
  for (int i = 1; i <= kTaps / 2; ++i) out[-i] = out[0];
  for (std::size_t x = static_cast<std::size_t>(job.width); x < job.stride + kScoreRoom; ++x)
    out[x] = out[job.width - 1];
}
template <int kTaps>
REDRIVE_INLINE Vf filter_row(const float* row, const float* taps) {
  Vf all{};
  for (int i = 0; i < kTaps; ++i) all += splat(taps[i]) * load(row + i - kTaps / 2);
  return all;
}

/// Rows of an image after the filters along its columns.
struct FilteredColumns {
  float *colour[kFlipTerms], *smooth, *first, *second;
};

REDRIVE_INLINE FlipPixel<LaneMath> perceived(const FlipFilters& filters,
                                             const FilteredColumns& rows, std::size_t x) {
  Vf opponent[3] = {};
  for (int t = 0; t < kFlipTerms; ++t)
    opponent[filters.colour[t].channel] +=
        splat(filters.colour[t].weight) *
        filter_row<kFlipColourTaps>(rows.colour[t] + x, filters.colour[t].taps);
  FlipPixel<LaneMath> out;
  flip_lab<LaneMath>(opponent, out.lab);
  const auto feature = [&](const float* row, const float* taps) __attribute__((always_inline)) {
    return filter_row<kFlipFeatureTaps>(row + x, taps);
  };
  out.edges = flip_magnitude<LaneMath>(feature(rows.smooth, filters.first),
                                       feature(rows.first, filters.smooth));
  out.points = flip_magnitude<LaneMath>(feature(rows.smooth, filters.second),
                                        feature(rows.second, filters.smooth));
  return out;
}

REDRIVE_INLINE void add_flip(const ScoreJob& job, int y, float* scratch, ScoreSums* sums) {
  const FlipFilters& filters = *job.flip;
  float* const mask = scratch_row(job, scratch, 0);
  if (mask_row(job, y, 0, job.width, mask) == 0) return;
  FilteredColumns of[2];
  for (int image = 0; image < 2; ++image) {
    FilteredColumns& rows = of[image];
    int row = 1 + 7 * image;
    for (int t = 0; t < kFlipTerms; ++t) {
      rows.colour[t] = scratch_row(job, scratch, row++);
      filter_columns<kFlipColourTaps>(job, row_of(job, image, 3 + filters.colour[t].channel, 0), y,
                                      filters.colour[t].taps, rows.colour[t]);
    }
    const auto feature = [&](const float* taps) __attribute__((always_inline)) {
      float* const out = scratch_row(job, scratch, row++);
      filter_columns<kFlipFeatureTaps>(job, row_of(job, image, 3, 0), y, taps, out);
      return out;
    };
    rows.smooth = feature(filters.smooth);
    rows.first = feature(filters.first);
    rows.second = feature(filters.second);
  }
  Vf total{};
  for (std::size_t x = 0; x < job.stride; x += kLanes) {
    const Vf error = flip_difference<LaneMath>(filters.largest, perceived(filters, of[0], x),
                                               perceived(filters, of[1], x));
    total += load(mask + x) > Vf{} ? error : Vf{};
  }
  sums->flip += static_cast<double>(sum(total));
}

void score_row(const ScoreJob& job, int y, float* scratch, ScoreSums* sums) {
  add_ssim(job, y, scratch, sums);
  add_flip(job, y, scratch, sums);
}

}  // namespace

const ScoreKernels kScoreKernels = {fill_row, score_row};

}  // namespace redrive::kernels::REDRIVE_ISA

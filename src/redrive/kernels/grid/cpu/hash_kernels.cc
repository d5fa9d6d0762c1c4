// SPDX-License-Identifier: Apache-2.0
// Compiled once per instruction set: REDRIVE_ISA names the namespace. The eight rows of a cell are
// four pairs: the far vertex along x has the row after the near one's (field/hash_grid.h), so that
// both are one load. A pair wraps around if the near one's row is the last of a hashed level.
#include "redrive/kernels/grid/cpu/hash_kernels.h"

#include "redrive/field/constants.h"

namespace redrive::kernels::REDRIVE_ISA {
namespace {

/// The cells of kLanes points; lanes without a point are at the origin.
struct Cells {
  Vi corner[3];
  Vf fraction[3], level_weight;
  unsigned counts;  ///< bit j: the level has a weight above 0 for point j
  Vu row[4];        ///< rows of pair p: at y + (p & 1), z + (p >> 1)
  bool wraps;       ///< whether any pair wraps around
};

REDRIVE_INLINE Cells find_cells(const GridLevel& level, const GridPoints& points, std::size_t i) {
  const int count = points.n - i < kLanes ? static_cast<int>(points.n - i) : kLanes;
  const Vf one = splat(1.0f), resolution = splat(static_cast<float>(level.resolution));
  Cells out;
  for (int k = 0; k < 3; ++k) {
    Vf x = load_first(points.position + k * points.stride + i, count);
    x = x > Vf{} ? minimum(x, one) : Vf{};
    const Vf scaled = x * resolution + splat(0.5f);
    out.corner[k] = __builtin_convertvector(scaled, Vi);
    out.fraction[k] = scaled - __builtin_convertvector(out.corner[k], Vf);
  }
  const Vf weight =
               one /
               maximum(splat(2.0f) * resolution * load_first(points.footprint + i, count), one),
           above = maximum(weight - splat(level.min_weight), Vf{});
  out.level_weight = weight < one ? above / splat(1 - level.min_weight) : one;
  out.counts = lane_bits(out.level_weight > Vf{});
  // Unsigned: a hash may overflow.
  const std::uint32_t side = static_cast<std::uint32_t>(level.resolution) + 2;
  const Vu step_y = splat_unsigned(level.dense ? side : kHashPrimeY),
           step_z = splat_unsigned(level.dense ? side * side : kHashPrimeZ);
  const Vu x = reinterpret_cast<Vu>(out.corner[0]),
           y = reinterpret_cast<Vu>(out.corner[1]) * step_y,
           z = reinterpret_cast<Vu>(out.corner[2]) * step_z;
  if (level.dense) {
    for (int p = 0; p < 4; ++p)
      out.row[p] = x + (p & 1 ? y + step_y : y) + (p & 2 ? z + step_z : z);
    out.wraps = false;
  } else {
    const Vu mask = splat_unsigned(level.mask);
    Vi inside = Vi{} == Vi{};
    for (int p = 0; p < 4; ++p) {
      out.row[p] = (x + ((p & 1 ? y + step_y : y) ^ (p & 2 ? z + step_z : z))) & mask;
      inside &= out.row[p] != mask;
    }
    out.wraps = !all_lanes(inside);
  }
  return out;
}

/// A row of kFeatures numbers, and a pair of rows.
template <int kFeatures>
struct RowOf {
  typedef float Type __attribute__((vector_size(kFeatures * 4), aligned(4), may_alias));
  typedef float Pair __attribute__((vector_size(kFeatures * 8), aligned(4), may_alias));
};

template <int kFeatures>
REDRIVE_INLINE typename RowOf<kFeatures>::Pair join(typename RowOf<kFeatures>::Type a,
                                                    typename RowOf<kFeatures>::Type b) {
  if constexpr (kFeatures == 1)
    return typename RowOf<1>::Pair{a[0], b[0]};
  else if constexpr (kFeatures == 2)
    return __builtin_shufflevector(a, b, 0, 1, 2, 3);
  else if constexpr (kFeatures == 4)
    return __builtin_shufflevector(a, b, 0, 1, 2, 3, 4, 5, 6, 7);
  else
    return __builtin_shufflevector(a, b, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
}

template <int kFeatures>
REDRIVE_INLINE typename RowOf<kFeatures>::Type near_of(typename RowOf<kFeatures>::Pair p) {
  if constexpr (kFeatures == 1)
    return typename RowOf<1>::Type{p[0]};
  else if constexpr (kFeatures == 2)
    return __builtin_shufflevector(p, p, 0, 1);
  else if constexpr (kFeatures == 4)
    return __builtin_shufflevector(p, p, 0, 1, 2, 3);
  else
    return __builtin_shufflevector(p, p, 0, 1, 2, 3, 4, 5, 6, 7);
}
template <int kFeatures>
REDRIVE_INLINE typename RowOf<kFeatures>::Type far_of(typename RowOf<kFeatures>::Pair p) {
  if constexpr (kFeatures == 1)
    return typename RowOf<1>::Type{p[1]};
  else if constexpr (kFeatures == 2)
    return __builtin_shufflevector(p, p, 2, 3);
  else if constexpr (kFeatures == 4)
    return __builtin_shufflevector(p, p, 4, 5, 6, 7);
  else
    return __builtin_shufflevector(p, p, 8, 9, 10, 11, 12, 13, 14, 15);
}

template <int kFeatures>
REDRIVE_INLINE typename RowOf<kFeatures>::Type* row_at(float* rows, std::uint32_t row) {
  return reinterpret_cast<typename RowOf<kFeatures>::Type*>(rows + static_cast<std::size_t>(row) *
                                                                       kFeatures);
}
template <int kFeatures>
REDRIVE_INLINE const typename RowOf<kFeatures>::Type* row_at(const float* rows, std::uint32_t row) {
  return reinterpret_cast<const typename RowOf<kFeatures>::Type*>(
      rows + static_cast<std::size_t>(row) * kFeatures);
}

/// `wraps`: whether the pair may wrap around.
template <int kFeatures>
REDRIVE_INLINE typename RowOf<kFeatures>::Pair load_pair(const GridLevel& level, std::uint32_t row,
                                                         bool wraps) {
  if (wraps && row == level.mask)
    return join<kFeatures>(*row_at<kFeatures>(level.rows, row), *row_at<kFeatures>(level.rows, 0));
  return *reinterpret_cast<const typename RowOf<kFeatures>::Pair*>(
      row_at<kFeatures>(level.rows, row));
}

template <int kFeatures>
REDRIVE_INLINE void add_pair(float* rows, std::uint32_t mask, std::uint32_t row, bool wraps,
                             typename RowOf<kFeatures>::Pair pair) {
  if (wraps && row == mask) {
    *row_at<kFeatures>(rows, row) += near_of<kFeatures>(pair);
    *row_at<kFeatures>(rows, 0) += far_of<kFeatures>(pair);
  } else {
    *reinterpret_cast<typename RowOf<kFeatures>::Pair*>(row_at<kFeatures>(rows, row)) += pair;
  }
}

/// The part of Cells for loops over single points.
struct StoredCells {
  alignas(64) std::uint32_t row[4][kLanes];
  /// for each pair: interpolation weights along y and z times the level's weight
  alignas(64) float weight[4][kLanes];
  alignas(64) float x[kLanes];  ///< interpolation weight of a pair's far vertex
};

REDRIVE_INLINE void store_cells(const Cells& cells, StoredCells* out) {
  const Vf one = splat(1.0f), y[2] = {one - cells.fraction[1], cells.fraction[1]},
           z[2] = {(one - cells.fraction[2]) * cells.level_weight,
                   cells.fraction[2] * cells.level_weight};
  for (int p = 0; p < 4; ++p) {
    std::memcpy(out->row[p], &cells.row[p], sizeof cells.row[p]);
    store(out->weight[p], y[p & 1] * z[p >> 1]);
  }
  store(out->x, cells.fraction[0]);
}

template <int kFeatures>
REDRIVE_INLINE void encode_point(const GridLevel& level, const StoredCells& cells, int j,
                                 bool wraps, float* out) {
  // Multiply-adds with one possible rounding: a point's features do not depend on whether another
  // pair of its vector wraps.
  typename RowOf<kFeatures>::Pair sum{};
#pragma GCC unroll 4
  for (int p = 0; p < 4; ++p)
    sum += cells.weight[p][j] * load_pair<kFeatures>(level, cells.row[p][j], wraps);
  const typename RowOf<kFeatures>::Type near = near_of<kFeatures>(sum),
                                        step = far_of<kFeatures>(sum) - near;
  *row_at<kFeatures>(out, static_cast<std::uint32_t>(j)) = near + cells.x[j] * step;
}

template <int kFeatures>
void encode_rows(const GridLevel& level, const GridPoints& points, float* out) {
  StoredCells stored;
  for (std::size_t i = 0; i < points.n; i += kLanes, out += kLanes * kFeatures) {
    const Cells cells = find_cells(level, points, i);
    store_cells(cells, &stored);
    const int count = points.n - i < kLanes ? static_cast<int>(points.n - i) : kLanes;
    const auto encode_all = [&](bool wraps) __attribute__((always_inline)) {
      for (int j = 0; j < count; ++j)
        if (cells.counts >> j & 1)
          encode_point<kFeatures>(level, stored, j, wraps, out);
        else
          *row_at<kFeatures>(out, static_cast<std::uint32_t>(j)) =
              typename RowOf<kFeatures>::Type{};
    };
    if (cells.wraps)
      encode_all(true);
    else
      encode_all(false);
  }
}

/// Bit j: point j is in the same cell as point j - 1, for which the level has a weight. `before`:
/// the cells of the vector before; `counted`: whether the level has a weight for its last point.
/// Both are updated.
REDRIVE_INLINE unsigned in_same_cell(const Cells& cells, Vi before[3], bool* counted) {
  constexpr auto shift = [](int i) { return i == 0 ? 2 * kLanes - 1 : i - 1; };
  Vi same = Vi{} == Vi{};
  for (int k = 0; k < 3; ++k) {
    same &= cells.corner[k] == shuffle(cells.corner[k], before[k], shift);
    before[k] = cells.corner[k];
  }
  const unsigned counted_before = cells.counts << 1 | *counted;
  *counted = cells.counts >> (kLanes - 1) & 1;
  return lane_bits(same) & counted_before;
}

/// Sums consecutive points in one cell, which are common along a ray, before adding to its rows.
template <int kFeatures>
void encode_rows_backward(const GridLevel& level, const GridPoints& points, const float* d_out,
                          float* d_rows) {
  typedef typename RowOf<kFeatures>::Type Row;
  typedef typename RowOf<kFeatures>::Pair Pair;
  StoredCells stored;
  Vi before[3] = {splat_int(-1), splat_int(-1), splat_int(-1)};
  Pair sum[4]{};  // sums over a run of points in one cell; adds zeros to rows 0 and 1 at the start
  std::uint32_t row[4]{};
  bool wraps = false, counted = false;
  for (std::size_t i = 0; i < points.n; i += kLanes, d_out += kLanes * kFeatures) {
    const Cells cells = find_cells(level, points, i);
    store_cells(cells, &stored);
    const int count = points.n - i < kLanes ? static_cast<int>(points.n - i) : kLanes;
    const unsigned same = in_same_cell(cells, before, &counted);
    for (int j = 0; j < count; ++j) {
      if (!(cells.counts >> j & 1)) continue;
      const Row d = *row_at<kFeatures>(d_out, static_cast<std::uint32_t>(j)), far = stored.x[j] * d;
      const Pair both = join<kFeatures>(d - far, far);
      if (same >> j & 1) {
#pragma GCC unroll 4
        for (int p = 0; p < 4; ++p) sum[p] += stored.weight[p][j] * both;
      } else {
#pragma GCC unroll 4
        for (int p = 0; p < 4; ++p) {
          add_pair<kFeatures>(d_rows, level.mask, row[p], wraps, sum[p]);
          row[p] = stored.row[p][j];
          sum[p] = stored.weight[p][j] * both;
        }
        wraps = cells.wraps;
      }
    }
  }
  for (int p = 0; p < 4; ++p) add_pair<kFeatures>(d_rows, level.mask, row[p], wraps, sum[p]);
}

template <int kFeatures>
void encode_position_backward(const GridLevel& level, const GridPoints& points, const float* d_out,
                              float* d_position) {
  typedef typename RowOf<kFeatures>::Type Row;
  StoredCells stored;
  alignas(64) float y[kLanes], z[kLanes], scale[kLanes];
  for (std::size_t i = 0; i < points.n; i += kLanes) {
    const Cells cells = find_cells(level, points, i);
    store_cells(cells, &stored);
    store(y, cells.fraction[1]);
    store(z, cells.fraction[2]);
    store(scale, cells.level_weight * splat(static_cast<float>(level.resolution)));
    const int count = points.n - i < kLanes ? static_cast<int>(points.n - i) : kLanes;
    for (int j = 0; j < count; ++j) {
      if (!(cells.counts >> j & 1)) continue;
      const Row d = *row_at<kFeatures>(d_out, static_cast<std::uint32_t>(i + j));
      const float x[2] = {1.0f - stored.x[j], stored.x[j]}, in_y[2] = {1.0f - y[j], y[j]},
                  in_z[2] = {1.0f - z[j], z[j]};
      float slope[3]{};
      for (int p = 0; p < 4; ++p) {
        const auto pair =
            load_pair<kFeatures>(level, stored.row[p][j], cells.wraps) * join<kFeatures>(d, d);
        float near = 0, far = 0;
        for (int f = 0; f < kFeatures; ++f) {
          near += pair[f];
          far += pair[kFeatures + f];
        }
        const float along = x[0] * near + x[1] * far;
        slope[0] += (far - near) * in_y[p & 1] * in_z[p >> 1];
        slope[1] += (p & 1 ? along : -along) * in_z[p >> 1];
        slope[2] += (p & 2 ? along : -along) * in_y[p & 1];
      }
      for (int k = 0; k < 3; ++k) d_position[k * points.stride + i + j] += slope[k] * scale[j];
    }
  }
}

typedef float V4 __attribute__((vector_size(16), may_alias));

/// Pairs of kWidth numbers each from the low (kHigh = 0) or high halves of a's and b's 128-bit
/// parts, a's first.
template <int kWidth, int kHigh>
REDRIVE_INLINE Vf interleave(Vf a, Vf b) {
  return shuffle(a, b, [](int i) {
    const int of_b = i / kWidth % 2, at = i % 4 / (2 * kWidth) * kWidth + i % kWidth + 2 * kHigh;
    return of_b * kLanes + i / 4 * 4 + at;
  });
}

/// Element m of point 4 q + e moves from lane 4 q + e of v[m] to lane 4 q + m of v[e]. Its own
/// inverse.
REDRIVE_INLINE void transpose_fours(Vf v[4]) {
  const Vf a = interleave<1, 0>(v[0], v[1]), b = interleave<1, 0>(v[2], v[3]),
           c = interleave<1, 1>(v[0], v[1]), d = interleave<1, 1>(v[2], v[3]);
  v[0] = interleave<2, 0>(a, b);
  v[1] = interleave<2, 1>(a, b);
  v[2] = interleave<2, 0>(c, d);
  v[3] = interleave<2, 1>(c, d);
}

/// Loads two pairs of single features; a pair that may wrap around is loaded element by element.
REDRIVE_INLINE V4 load_pairs(const GridLevel& level, std::uint32_t first, std::uint32_t second,
                             bool wraps) {
  const float* const rows = level.rows;
  if (wraps)
    return V4{rows[first], rows[(first + 1) & level.mask], rows[second],
              rows[(second + 1) & level.mask]};
  const __m128 low = _mm_loadl_pi(_mm_setzero_ps(), reinterpret_cast<const __m64*>(rows + first));
  return reinterpret_cast<V4>(_mm_loadh_pi(low, reinterpret_cast<const __m64*>(rows + second)));
}

REDRIVE_INLINE void add_single_pairs(float* rows, std::uint32_t mask, std::uint32_t first,
                                     std::uint32_t second, bool wraps, V4 sum) {
  if (wraps) {
    rows[first] += sum[0];
    rows[(first + 1) & mask] += sum[1];
    rows[second] += sum[2];
    rows[(second + 1) & mask] += sum[3];
    return;
  }
  // One after the other: the pairs may overlap.
  __m64* const low = reinterpret_cast<__m64*>(rows + first);
  const __m128 addend = reinterpret_cast<__m128>(sum);
  _mm_storel_pi(low, _mm_add_ps(_mm_loadl_pi(_mm_setzero_ps(), low), addend));
  __m64* const high = reinterpret_cast<__m64*>(rows + second);
  _mm_storeh_pi(high, _mm_add_ps(_mm_loadh_pi(_mm_setzero_ps(), high), addend));
}

/// Cells of single features: interpolated along z point by point, then along y and x in vectors.
struct StoredSingles {
  alignas(64) std::uint32_t row[4][kLanes];
  alignas(64) float z[kLanes];         ///< interpolation weight of the far pairs
  alignas(64) float plane[4][kLanes];  ///< as transpose_fours leaves them

  float* plane_of(int j) { return &plane[j % 4][j / 4 * 4]; }
};

REDRIVE_INLINE void store_singles(const Cells& cells, StoredSingles* out) {
  for (int p = 0; p < 4; ++p) std::memcpy(out->row[p], &cells.row[p], sizeof cells.row[p]);
  store(out->z, cells.fraction[2]);
}

REDRIVE_INLINE void mix_along_z(const GridLevel& level, bool wraps, StoredSingles* s) {
  for (int j = 0; j < kLanes; ++j) {
    const V4 near = load_pairs(level, s->row[0][j], s->row[1][j], wraps),
             far = load_pairs(level, s->row[2][j], s->row[3][j], wraps);
    *reinterpret_cast<V4*>(s->plane_of(j)) = near + s->z[j] * (far - near);
  }
}

void encode_singles_backward(const GridLevel& level, const GridPoints& points, const float* d_out,
                             float* d_rows) {
  StoredSingles s;
  Vi before[3] = {splat_int(-1), splat_int(-1), splat_int(-1)};
  V4 near{}, far{};
  std::uint32_t row[4]{};
  bool wraps = false, counted = false;
  const auto add = [&]() __attribute__((always_inline)) {
    add_single_pairs(d_rows, level.mask, row[0], row[1], wraps, near);
    add_single_pairs(d_rows, level.mask, row[2], row[3], wraps, far);
  };
  for (std::size_t i = 0; i < points.n; i += kLanes) {
    const int count = points.n - i < kLanes ? static_cast<int>(points.n - i) : kLanes;
    const Cells cells = find_cells(level, points, i);
    store_singles(cells, &s);
    const Vf d = load_first(d_out + i, count) * cells.level_weight, far_y = d * cells.fraction[1],
             near_y = d - far_y;
    Vf plane[4] = {near_y - near_y * cells.fraction[0], near_y * cells.fraction[0],
                   far_y - far_y * cells.fraction[0], far_y * cells.fraction[0]};
    transpose_fours(plane);
    for (int k = 0; k < 4; ++k) store(s.plane[k], plane[k]);
    const unsigned same = in_same_cell(cells, before, &counted);
    for (int j = 0; j < count; ++j) {
      if (!(cells.counts >> j & 1)) continue;
      const V4 of_plane = *reinterpret_cast<const V4*>(s.plane_of(j)), of_far = s.z[j] * of_plane;
      if (same >> j & 1) {
        near += of_plane - of_far;
        far += of_far;
      } else {
        add();
        for (int p = 0; p < 4; ++p) row[p] = s.row[p][j];
        near = of_plane - of_far;
        far = of_far;
        wraps = cells.wraps;
      }
    }
  }
  add();
}

template <int kFeatures>
void backward_of(const GridLevel& level, const GridPoints& points, const float* d_out,
                 float* d_rows, float* d_position) {
  if (d_rows) {
    if constexpr (kFeatures == 1)
      encode_singles_backward(level, points, d_out, d_rows);
    else
      encode_rows_backward<kFeatures>(level, points, d_out, d_rows);
  }
  if (d_position) encode_position_backward<kFeatures>(level, points, d_out, d_position);
}

}  // namespace

void encode(int features, const GridLevel& level, const GridPoints& points, float* out) {
  switch (features) {
    case 1: return encode_rows<1>(level, points, out);
    case 2: return encode_rows<2>(level, points, out);
    case 4: return encode_rows<4>(level, points, out);
    default: return encode_rows<8>(level, points, out);
  }
}

void encode_backward(int features, const GridLevel& level, const GridPoints& points,
                     const float* d_out, float* d_rows, float* d_position) {
  switch (features) {
    case 1: return backward_of<1>(level, points, d_out, d_rows, d_position);
    case 2: return backward_of<2>(level, points, d_out, d_rows, d_position);
    case 4: return backward_of<4>(level, points, d_out, d_rows, d_position);
    default: return backward_of<8>(level, points, d_out, d_rows, d_position);
  }
}

void density(const GridLevel* levels, int n_levels, float scale, const GridPoints& points,
             float* density) {
  StoredSingles s;
  for (int l = 0; l < n_levels; ++l)  // one level's table at a time is in the L2 cache
    for (std::size_t i = 0; i < points.n; i += kLanes) {
      const int count = points.n - i < kLanes ? static_cast<int>(points.n - i) : kLanes;
      const Cells cells = find_cells(levels[l], points, i);
      store_singles(cells, &s);
      if (cells.wraps)
        mix_along_z(levels[l], true, &s);
      else
        mix_along_z(levels[l], false, &s);
      Vf plane[4];
      for (int k = 0; k < 4; ++k) plane[k] = load(s.plane[k]);
      transpose_fours(plane);
      const Vf x = cells.fraction[0], y = cells.fraction[1], near_x = splat(1.0f) - x,
               of_level = (splat(1.0f) - y) * (near_x * plane[0] + x * plane[1]) +
                          y * (near_x * plane[2] + x * plane[3]);
      const Vf sum =
          cells.level_weight * of_level + (l == 0 ? Vf{} : load_first(density + i, count));
      store_first(density + i,
                  l + 1 < n_levels
                      ? sum
                      : splat(scale) * exponential(minimum(splat(kMaxLogDensity), sum)).value,
                  count);
    }
}

}  // namespace redrive::kernels::REDRIVE_ISA

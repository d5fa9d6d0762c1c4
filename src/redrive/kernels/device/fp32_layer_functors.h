// SPDX-License-Identifier: Apache-2.0
// A linear layer of a network on a batch of samples, y = W x + b, forward and backward in fp32. A
// thread computes a tile of kTile x kTile sums, so that each number that it reads is used kTile
// times. Sums have a fixed order: the same bits each time.
#pragma once

#include <cstddef>

#include "redrive/base/host_device.h"
#include "redrive/field/activation.h"
#include "redrive/kernels/device/device_math.h"

namespace redrive::kernels {

/// A matrix of samples: number `c` of sample `s` is data[s * sample + c * number].
template <class T>
struct SampleMatrix {
  T* data = nullptr;
  std::size_t sample = 0, number = 1;

  REDRIVE_HD T& at(std::size_t s, std::size_t c) const { return data[s * sample + c * number]; }
};
inline SampleMatrix<const float> read_only(const SampleMatrix<float>& x) {
  return {x.data, x.sample, x.number};
}

constexpr std::size_t kTile = 4;  // 16 sums and 8 operands in registers, each for four products

REDRIVE_HD constexpr std::size_t tiles_of(std::size_t n) { return (n + kTile - 1) / kTile; }

/// Offsets of a tile along one side. Beyond the end they repeat the last one, and those sums are
/// not stored.
struct TileSide {
  std::size_t at[kTile], count;

  REDRIVE_HD TileSide(std::size_t tile, std::size_t size) {
    const std::size_t first = tile * kTile, left = size - first;
    count = left < kTile ? left : kTile;
    for (std::size_t i = 0; i < kTile; ++i) at[i] = first + (i < count ? i : count - 1);
  }
};

/// y = W x + b, then ReLU if the layer has one. weight [outputs, inputs], bias [outputs] or null.
struct LayerForward {
  std::size_t samples, outputs, inputs;
  const float *weight, *bias;
  bool has_relu;
  SampleMatrix<const float> x;
  SampleMatrix<float> y;

  std::size_t tiles() const { return tiles_of(samples) * tiles_of(outputs); }

  REDRIVE_HD void operator()(std::size_t tile) const {
    const std::size_t across = tiles_of(outputs);
    const TileSide s(tile / across, samples), o(tile % across, outputs);
    float sum[kTile][kTile];
    for (std::size_t a = 0; a < kTile; ++a)
      for (std::size_t b = 0; b < kTile; ++b) sum[a][b] = bias ? bias[o.at[b]] : 0.0f;
    for (std::size_t k = 0; k < inputs; ++k) {
      float row[kTile];
      for (std::size_t b = 0; b < kTile; ++b) row[b] = weight[o.at[b] * inputs + k];
      for (std::size_t a = 0; a < kTile; ++a) {
        const float input = x.at(s.at[a], k);
        for (std::size_t b = 0; b < kTile; ++b) sum[a][b] = multiply_add(input, row[b], sum[a][b]);
      }
    }
    for (std::size_t a = 0; a < s.count; ++a)
      for (std::size_t b = 0; b < o.count; ++b)
        y.at(s.at[a], o.at[b]) = has_relu ? relu(sum[a][b]) : sum[a][b];
  }
};

/// d_x = W^T d_y for `columns` of the inputs. `weight` begins at the first of them; its rows are
/// `inputs` apart. Adds to d_x where `adds`. Then sets it to 0 where the ReLU that returned
/// `opened` (x itself), unless null, is closed.
struct LayerInputBackward {
  std::size_t samples, outputs, inputs, columns;
  const float* weight;
  bool adds;
  SampleMatrix<const float> d_y, opened;
  SampleMatrix<float> d_x;

  std::size_t tiles() const { return tiles_of(samples) * tiles_of(columns); }

  REDRIVE_HD void operator()(std::size_t tile) const {
    const std::size_t across = tiles_of(columns);
    const TileSide s(tile / across, samples), c(tile % across, columns);
    float sum[kTile][kTile];
    for (std::size_t a = 0; a < kTile; ++a)
      for (std::size_t b = 0; b < kTile; ++b) sum[a][b] = adds ? d_x.at(s.at[a], c.at[b]) : 0.0f;
    for (std::size_t o = 0; o < outputs; ++o) {
      float row[kTile];
      for (std::size_t b = 0; b < kTile; ++b) row[b] = weight[o * inputs + c.at[b]];
      for (std::size_t a = 0; a < kTile; ++a) {
        const float d = d_y.at(s.at[a], o);
        for (std::size_t b = 0; b < kTile; ++b) sum[a][b] = multiply_add(d, row[b], sum[a][b]);
      }
    }
    for (std::size_t a = 0; a < s.count; ++a)
      for (std::size_t b = 0; b < c.count; ++b)
        d_x.at(s.at[a], c.at[b]) =
            opened.data && opened.at(s.at[a], c.at[b]) <= 0 ? 0.0f : sum[a][b];
  }
};

constexpr std::size_t kSamplesPerSlice =
    512;  // 2^15 samples have slices enough to occupy a device even for the smallest layer

REDRIVE_HD constexpr std::size_t slices_of(std::size_t samples) {
  return (samples + kSamplesPerSlice - 1) / kSamplesPerSlice;
}

/// Sums over a slice of the samples: partial[slice][size()] = d_y x^T [outputs, inputs], followed
/// by the sums of d_y [outputs] if there is a bias, as in the buffer of all parameters.
struct LayerWeightBackward {
  std::size_t samples, outputs, inputs;
  bool has_bias;
  SampleMatrix<const float> d_y, x;
  float* partial;

  REDRIVE_HD std::size_t size() const { return outputs * (inputs + (has_bias ? 1 : 0)); }
  std::size_t tiles() const { return slices_of(samples) * tiles_of(outputs) * tiles_of(inputs); }

  REDRIVE_HD void operator()(std::size_t tile) const {
    const std::size_t across = tiles_of(inputs), of_slice = across * tiles_of(outputs),
                      slice = tile / of_slice;
    const TileSide o(tile % of_slice / across, outputs), i(tile % across, inputs);
    const std::size_t begin = slice * kSamplesPerSlice, left = samples - begin,
                      end = begin + (left < kSamplesPerSlice ? left : kSamplesPerSlice);
    float sum[kTile][kTile]{}, of_bias[kTile]{};
    for (std::size_t s = begin; s < end; ++s) {
      float input[kTile];
      for (std::size_t b = 0; b < kTile; ++b) input[b] = x.at(s, i.at[b]);
      for (std::size_t a = 0; a < kTile; ++a) {
        const float d = d_y.at(s, o.at[a]);
        of_bias[a] += d;
        for (std::size_t b = 0; b < kTile; ++b) sum[a][b] = multiply_add(d, input[b], sum[a][b]);
      }
    }
    float* const out = partial + slice * size();
    for (std::size_t a = 0; a < o.count; ++a) {
      for (std::size_t b = 0; b < i.count; ++b) out[o.at[a] * inputs + i.at[b]] = sum[a][b];
      if (has_bias && tile % across == 0) out[outputs * inputs + o.at[a]] = of_bias[a];
    }
  }
};

constexpr std::size_t kSlicesPerGroup = 32;  ///< sums that one thread adds up in order

/// Adds up the sums of a group of slices in order and stores the total in its first slice.
struct ReduceSliceGroups {
  std::size_t slices, size;
  float* partial;

  std::size_t groups() const { return (slices + kSlicesPerGroup - 1) / kSlicesPerGroup; }

  REDRIVE_HD void operator()(std::size_t i) const {
    const std::size_t first = i / size * kSlicesPerGroup, left = slices - first;
    float* const sum = partial + first * size + i % size;
    for (std::size_t slice = 1; slice < (left < kSlicesPerGroup ? left : kSlicesPerGroup); ++slice)
      *sum += sum[slice * size];
  }
};

/// gradients[i] += the slices' sums, in order. `apart`: distance between slices that hold sums.
struct ReduceSlices {
  std::size_t slices, size;
  const float* partial;
  float* gradients;
  std::size_t apart = 1;

  REDRIVE_HD void operator()(std::size_t i) const {
    float sum = 0;
    for (std::size_t slice = 0; slice < slices; slice += apart) sum += partial[slice * size + i];
    gradients[i] += sum;
  }
};

}  // namespace redrive::kernels

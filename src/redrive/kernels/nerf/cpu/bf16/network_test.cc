// SPDX-License-Identifier: Apache-2.0
// Compares the network with plain loops (reference_network_testing.h): outputs bit for bit,
// gradients up to their sums in fp32.
#include <cmath>
#include <cstring>

#include <gtest/gtest.h>

#include "redrive/base/rng.h"
#include "redrive/field/positional_encoding.h"
#include "redrive/kernels/nerf/cpu/bf16/bf16_testing.h"
#include "redrive/kernels/nerf/cpu/bf16/network.h"
#include "redrive/kernels/nerf/cpu/bf16/reference_network_testing.h"

namespace redrive::kernels::bf16 {
namespace {

/// Norm of the error of n-term sums in fp32 relative to their norm: every addition rounds a partial
/// sum of about sqrt(k) terms by 2^-25 of it, together sqrt(n) 2^-24 / 2.4 for terms of random
/// sign; ten times that.
double sum_tolerance(int n) { return 4 * std::sqrt(n) * 0x1p-24; }

struct Tile {
  int n_rays = 0, per_ray = 0;
  std::vector<float> position, direction, d_raw;
  int samples() const { return n_rays * per_ray; }
  NerfTile view() const { return {n_rays, per_ray, position.data(), direction.data()}; }
};

std::vector<float> random_parameters(const NerfConfig& config) {
  std::vector<float> parameters(nerf_parameter_count(config));
  for (int i = 0; i < kNerfLayers; ++i) {
    const NerfLayerShape shape = nerf_layer(config, i);
    const float scale = std::sqrt(
        6.0f / static_cast<float>(shape.inputs));  // uniform, variance 2 / inputs: He et al. 2015
    for (int k = 0; k < shape.outputs * shape.inputs; ++k) {
      parameters[shape.weight + k] =
          scale * (2 * random_unit(random_key(3, kStreamTest, i), k) - 1);
    }
    for (int k = 0; k < shape.outputs; ++k) {
      parameters[shape.bias + k] = 0.2f * (2 * random_unit(random_key(4, kStreamTest, i), k) - 1);
    }
  }
  return parameters;
}

Tile random_tile(int n_rays, int per_ray, std::uint64_t seed) {
  const int samples = n_rays * per_ray;
  Tile tile{n_rays, per_ray, std::vector<float>(3 * samples), std::vector<float>(3 * n_rays),
            std::vector<float>(4 * samples)};
  for (std::size_t i = 0; i < tile.position.size(); ++i)
    tile.position[i] = 2 * random_unit(random_key(seed, 1), i) - 1;
  for (std::size_t i = 0; i < tile.direction.size(); ++i)
    tile.direction[i] = 2 * random_unit(random_key(seed, 2), i) - 1;
  for (std::size_t i = 0; i < tile.d_raw.size(); ++i)
    tile.d_raw[i] = 2 * random_unit(random_key(seed, 3), i) - 1;
  return tile;
}

double relative_error(std::span<const double> expected, std::span<const float> got) {
  double error = 0, norm = 0;
  for (std::size_t i = 0; i < expected.size(); ++i) {
    error += (got[i] - expected[i]) * (got[i] - expected[i]);
    norm += expected[i] * expected[i];
  }
  EXPECT_GT(norm, 0);
  return std::sqrt(error / norm);  // NaN fails the comparisons below
}

/// Returns the reference's raw outputs [4, samples] from the engine's own encodings; adds its
/// gradients and writes d_position [3, samples].
std::vector<float> run_reference(const ReferenceNetwork& reference, const NerfConfig& config,
                                 const ChunkMemory& memory, const Tile& tile,
                                 std::span<double> gradients, std::span<double> d_position) {
  const int samples = tile.samples(), blocks = make_plan(config).position_blocks;
  std::vector<float> raw(4 * samples);
  for (int i = 0; i < samples; ++i) {
    std::vector<float> gamma_x, gamma_d;
    for (int f = 0; f < encoded_size(config.position_octaves); ++f) {
      gamma_x.push_back(from_bf16(memory.position_next[(i / 32 * blocks + f / 32) * kBlockSize +
                                                       pair_form(f % 32, i % 32)]));
    }
    for (int f = 0; f < encoded_size(config.direction_octaves); ++f) {
      gamma_d.push_back(
          from_bf16(memory.direction_next[i / 32 * kBlockSize + pair_form(f, i % 32)]));
    }
    const ReferenceNetwork::Trace trace = reference.forward(gamma_x, gamma_d);
    float d_raw[4];
    for (int k = 0; k < 4; ++k) {
      raw[k * samples + i] = trace.raw[k];
      d_raw[k] = tile.d_raw[k * samples + i];
    }
    const std::vector<double> d_gamma = reference.backward(trace, d_raw, gradients),
                              gamma(gamma_x.begin(), gamma_x.end());
    double d_x[3];
    positional_encoding_adjoint(gamma.data(), config.position_octaves, d_gamma.data(), d_x);
    for (int k = 0; k < 3; ++k) d_position[k * samples + i] = d_x[k];
  }
  return raw;
}

struct NetworkCase {
  NerfConfig config;
  int n_rays, per_ray;
};
void PrintTo(const NetworkCase& c, std::ostream* out) { *out << c.config.width; }

class NetworkTest : public testing::TestWithParam<NetworkCase> {};

TEST_P(NetworkTest, ForwardAndBackwardAgreeWithPlainLoops) {
  const auto& [config, n_rays, per_ray] = GetParam();
  SKIP_WITHOUT_BF16();
  const std::vector<float> parameters = random_parameters(config);
  const ReferenceNetwork reference(config, parameters);
  ThreadPool pool(2);
  Network network(config);
  network.pack(parameters, pool);

  // Chunk 0 runs two tiles (the second smaller), chunk 1 one, chunk 2 none; the gradients are added
  // to the previous values.
  const Tile tiles[] = {random_tile(n_rays, per_ray, 10), random_tile(1, per_ray, 11),
                        random_tile(1, 33, 12)};
  std::vector<std::unique_ptr<NerfChunk>> chunks;
  for (int i = 0; i < 3; ++i) chunks.push_back(network.make_chunk(std::max(n_rays * per_ray, 33)));
  std::vector<double> expected(reference.gradient_size(), 0.0);
  for (auto& chunk : chunks) chunk->clear_gradients();
  int n_samples = 0;
  for (int t = 0; t < 3; ++t) {
    const Tile& tile = tiles[t];
    auto& chunk = static_cast<Chunk&>(*chunks[t / 2]);
    std::vector<float> raw(4 * tile.samples()), without_keep(4 * tile.samples()),
        d_position(3 * tile.samples());
    std::vector<double> expected_d_position(d_position.size());
    chunk.forward(tile.view(), false, without_keep.data(), tile.samples());
    chunk.forward(tile.view(), true, raw.data(), tile.samples());
    chunk.backward(tile.d_raw.data(), tile.samples(), d_position.data());
    EXPECT_EQ(raw, without_keep);
    const std::vector<float> expected_raw =
        run_reference(reference, config, chunk.memory(), tile, expected, expected_d_position);
    // Sums of 63 terms behind products that are equal bit for bit.
    EXPECT_LT(relative_error(expected_d_position, d_position), sum_tolerance(63));
    for (int i = 0; i < 4 * tile.samples(); ++i)
      ASSERT_EQ(raw[i], expected_raw[i]) << "tile " << t << ", number " << i;
    n_samples += tile.samples();
  }
  reference.unfold(expected);
  std::vector<float> gradients(parameters.size());
  network.reduce(chunks, gradients, pool);
  for (const NerfTensor& tensor : nerf_tensors(config)) {
    const auto size = static_cast<std::size_t>(tensor.rows) * tensor.columns;
    EXPECT_LT(relative_error(std::span<const double>(expected).subspan(tensor.offset, size),
                             std::span<const float>(gradients).subspan(tensor.offset, size)),
              sum_tolerance(n_samples + config.width))  // feature, colour: unfolded over the width
        << tensor.name;
  }

  std::vector<float> twice = gradients;
  network.reduce(chunks, twice, pool);
  for (std::size_t i = 0; i < twice.size(); ++i) ASSERT_EQ(twice[i], 2 * gradients[i]);
}

TEST_P(NetworkTest, EqualRunsAreBitEqual) {
  const auto& [config, n_rays, per_ray] = GetParam();
  SKIP_WITHOUT_BF16();
  const std::vector<float> parameters = random_parameters(config);
  const Tile tile = random_tile(n_rays, per_ray, 20);
  std::vector<float> results[2];
  for (int run = 0; run < 2; ++run) {
    ThreadPool pool(1 + run);
    const auto network = make_nerf_avx512_bf16(config);
    network->pack(parameters, pool);
    std::vector<std::unique_ptr<NerfChunk>> chunks;
    for (int i = 0; i < 2; ++i) chunks.push_back(network->make_chunk(tile.samples()));
    std::vector<float> raw(4 * tile.samples()), gradients(parameters.size());
    pool.run(2, [&](int i) {
      std::vector<float> chunk_raw(4 * tile.samples());
      for (int batch = 0; batch < 2; ++batch) {  // a batch must not affect the next
        chunks[i]->clear_gradients();
        chunks[i]->forward(tile.view(), true, chunk_raw.data(), tile.samples());
        chunks[i]->backward(tile.d_raw.data(), tile.samples(), nullptr);
      }
      if (i == 1) raw = chunk_raw;
    });
    network->reduce(chunks, gradients, pool);
    results[run] = raw;
    results[run].insert(results[run].end(), gradients.begin(), gradients.end());
  }
  ASSERT_EQ(results[0].size(), results[1].size());
  EXPECT_EQ(std::memcmp(results[0].data(), results[1].data(), results[0].size() * sizeof(float)),
            0);
}

// Width 32 has a colour width of 16 and three chunks of dW (539 samples), width 96 one of 48.
INSTANTIATE_TEST_SUITE_P(
    Networks, NetworkTest,
    testing::Values(NetworkCase{{.width = 32}, 7, 77}, NetworkCase{{.width = 64}, 1, 1},
                    NetworkCase{
                        {.width = 96, .position_octaves = 5, .direction_octaves = 2}, 5, 19},
                    NetworkCase{{.width = 128}, 13, 11}, NetworkCase{{.width = 256}, 3, 21},
                    NetworkCase{{.width = 512}, 2, 5}),
    [](const auto& test) { return "width" + std::to_string(test.param.config.width); });

/// Padded samples and outputs past the tile must not be written, nor read from d_raw.
TEST(NetworkStrideTest, TouchesOnlyTheTilesSamples) {
  SKIP_WITHOUT_BF16();
  const NerfConfig config{.width = 32};
  const std::vector<float> parameters = random_parameters(config);
  ThreadPool pool(1);
  const auto network = make_nerf_avx512_bf16(config);
  network->pack(parameters, pool);
  const int samples = 37, stride = 64;
  std::vector<float> position(3 * samples, 0.3f), direction = {1, 0, 0}, raw(4 * stride, -7.0f),
                                                  gradients[2];
  for (int run = 0; run < 2; ++run) {
    std::vector<std::unique_ptr<NerfChunk>> chunks;
    chunks.push_back(network->make_chunk(samples));
    chunks[0]->clear_gradients();
    chunks[0]->forward({1, samples, position.data(), direction.data()}, true, raw.data(), stride);
    std::vector<float> d_raw(4 * stride, run == 0 ? 0.0f : NAN);
    for (int k = 0; k < 4; ++k) {
      for (int i = 0; i < samples; ++i) d_raw[k * stride + i] = 1.0f;
      for (int i = samples; i < stride; ++i) EXPECT_EQ(raw[k * stride + i], -7.0f);
    }
    chunks[0]->backward(d_raw.data(), stride, nullptr);
    gradients[run].resize(parameters.size());
    network->reduce(chunks, gradients[run], pool);
  }
  EXPECT_EQ(gradients[0], gradients[1]);
}

}  // namespace
}  // namespace redrive::kernels::bf16

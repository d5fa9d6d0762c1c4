// SPDX-License-Identifier: Apache-2.0
// The fp32 network of each instruction set against the oracle in double.
#include <cmath>
#include <vector>

#include <gtest/gtest.h>

#include "redrive/base/cpu_features.h"
#include "redrive/base/rng.h"
#include "redrive/kernels/nerf/cpu/fp32/fp32_kernels.h"
#include "redrive/kernels/nerf/cpu/nerf_tile.h"
#include "redrive/kernels/nerf/ref/nerf_network.h"

namespace redrive::kernels {
namespace {

double uniform(std::uint64_t stream, std::uint64_t i) {
  return 2.0 * random_unit(random_key(31, kStreamTest, stream), i) - 1;
}

struct Case {
  NerfConfig config;
  int n_rays, per_ray;
};

/// Points, parameters and output adjoints of a batch, and the oracle's answer.
struct Problem {
  Case shape;
  int samples;
  std::vector<float> position, direction, parameters, d_raw;
  std::vector<double> raw, gradients, d_position;

  explicit Problem(const Case& c)
      : shape(c), samples(c.n_rays * c.per_ray), parameters(nerf_parameter_count(c.config)) {
    for (int i = 0; i < 3 * samples; ++i) position.push_back(static_cast<float>(uniform(1, i)));
    for (int i = 0; i < 3 * c.n_rays; ++i) direction.push_back(static_cast<float>(uniform(2, i)));
    for (int i = 0; i < 4 * samples; ++i) d_raw.push_back(static_cast<float>(uniform(3, i)));
    nerf_initialize(c.config, 9, parameters);
    for (std::size_t i = 0; i < parameters.size(); ++i)
      if (parameters[i] == 0)
        parameters[i] = static_cast<float>(0.2 * uniform(4, i));  // the biases
    raw.resize(4 * static_cast<std::size_t>(samples));
    gradients.resize(parameters.size());
    d_position.resize(3 * static_cast<std::size_t>(samples));
    const std::vector<double> p(parameters.begin(), parameters.end());
    ref::NerfActivations<double> activations;
    for (int i = 0; i < samples; ++i) {
      double x[3], d[3], out[4], d_out[4], d_x[3];
      for (int k = 0; k < 3; ++k)
        x[k] = position[k * samples + i], d[k] = direction[k * c.n_rays + i / c.per_ray];
      for (int k = 0; k < 4; ++k) d_out[k] = d_raw[k * samples + i];
      ref::nerf_sample_forward(c.config, p.data(), x, d, &activations, out);
      ref::nerf_sample_adjoint(c.config, p.data(), activations, d_out, gradients.data(), d_x);
      for (int k = 0; k < 3; ++k) d_position[k * samples + i] = d_x[k];
      for (int k = 0; k < 4; ++k) raw[k * samples + i] = out[k];
    }
  }

  /// Rays [first, first + n) as a tile; the arrays it points into.
  struct Part {
    std::vector<float> position, direction, d_raw;
    NerfTile tile;
  };
  Part part(int first, int n) const {
    Part p;
    const int begin = first * shape.per_ray, count = n * shape.per_ray;
    for (int k = 0; k < 3; ++k) {
      p.position.insert(p.position.end(), &position[k * samples + begin],
                        &position[k * samples + begin] + count);
      p.direction.insert(p.direction.end(), &direction[k * shape.n_rays + first],
                         &direction[k * shape.n_rays + first] + n);
    }
    for (int k = 0; k < 4; ++k)
      p.d_raw.insert(p.d_raw.end(), &d_raw[k * samples + begin],
                     &d_raw[k * samples + begin] + count);
    p.tile = {n, shape.per_ray, p.position.data(), p.direction.data()};
    return p;
  }
};

/// |a - b| / |b| over [first, first + size), 2-norms.
double relative_error(const float* a, const double* b, std::size_t size) {
  double error = 0, norm = 0;
  for (std::size_t i = 0; i < size; ++i) {
    error += (a[i] - b[i]) * (a[i] - b[i]);
    norm += b[i] * b[i];
  }
  return std::sqrt(error / norm);
}

// The encoding is wrong by up to 4e-6, each of 11 products by sqrt(K) 2^-24 of its norm (K <= 576,
// random signs): 1.6e-5; together, and with a factor of 4 for amplification by the following
// layers: 8e-5.
constexpr double kTolerance = 8e-5;

using Maker = std::unique_ptr<NerfNetwork> (*)(const NerfConfig&);
class Fp32NetworkTest : public testing::TestWithParam<std::pair<Isa, Maker>> {
 protected:
  void SetUp() override {
    if (const auto obstacle = isa_obstacle(GetParam().first)) GTEST_SKIP() << *obstacle;
  }
};

TEST_P(Fp32NetworkTest, MatchesTheOracle) {
  // Tiles that fill whole panels, parts of vectors, one sample; rays that end inside a vector;
  // every padding.
  const Case cases[] = {{{32, 10, 4}, 6, 48}, {{64, 3, 2}, 7, 13},   {{96, 10, 4}, 41, 1},
                        {{160, 6, 1}, 1, 1},  {{256, 10, 4}, 2, 40}, {{32, 1, 1}, 3, 70},
                        {{512, 10, 4}, 1, 21}};
  ThreadPool pool(2);
  for (const Case& c : cases) {
    SCOPED_TRACE(testing::Message()
                 << "width " << c.config.width << " octaves " << c.config.position_octaves
                 << " rays " << c.n_rays << " x " << c.per_ray);
    const Problem problem(c);
    const auto network = GetParam().second(c.config);
    network->pack(problem.parameters, pool);
    network->pack(problem.parameters, pool);  // independent of the previous parameters
    std::vector<std::unique_ptr<NerfChunk>> chunks;
    for (int i = 0; i < 2; ++i) chunks.push_back(network->make_chunk(problem.samples));
    for (auto& chunk : chunks) chunk->clear_gradients();

    std::vector<float> raw(4 * problem.samples, NAN), exact(raw);
    const Problem::Part all = problem.part(0, c.n_rays);
    chunks[0]->forward(all.tile, false, raw.data(), problem.samples);
    EXPECT_LT(relative_error(raw.data(), problem.raw.data(), raw.size()), kTolerance);

    // Repeats it in two tiles of unequal size on two chunks, and with the larger one before the
    // smaller on one chunk.
    const int cut = c.n_rays > 1 ? c.n_rays - 1 : 1;
    for (int first = 0; first < c.n_rays; first += cut) {
      const Problem::Part part = problem.part(first, std::min(cut, c.n_rays - first));
      NerfChunk& chunk = *chunks[first == 0 ? 0 : 1];
      std::vector<float> part_raw(4 * part.tile.samples());
      chunk.forward(part.tile, true, part_raw.data(), part.tile.samples());
      for (int k = 0; k < 4; ++k)
        for (int i = 0; i < part.tile.samples(); ++i)
          EXPECT_NEAR(
              part_raw[k * part.tile.samples() + i],
              raw[k * problem.samples + first * c.per_ray + i],
              kTolerance * (1 + std::abs(raw[k * problem.samples + first * c.per_ray + i])));
      const int n = part.tile.samples();
      std::vector<float> d_position(3 * n, NAN);
      chunk.backward(part.d_raw.data(), n, d_position.data());
      for (int k = 0; k < 3; ++k)
        EXPECT_LT(relative_error(&d_position[k * n],
                                 &problem.d_position[k * problem.samples + first * c.per_ray], n),
                  kTolerance)
            << "coordinate " << k;
    }
    std::vector<float> gradients(problem.parameters.size(), 0.0f);
    network->reduce(chunks, gradients, pool);
    for (const NerfTensor& tensor : nerf_tensors(c.config))
      EXPECT_LT(relative_error(&gradients[tensor.offset], &problem.gradients[tensor.offset],
                               static_cast<std::size_t>(tensor.rows) * tensor.columns),
                kTolerance)
          << tensor.name;
  }
}

TEST_P(Fp32NetworkTest, GradientsAreAddedAndCleared) {
  const Problem problem({{32, 2, 1}, 2, 9});
  ThreadPool pool(1);
  const auto network = GetParam().second(problem.shape.config);
  network->pack(problem.parameters, pool);
  std::vector<std::unique_ptr<NerfChunk>> chunks;
  chunks.push_back(network->make_chunk(problem.samples));
  const Problem::Part all = problem.part(0, 2);
  std::vector<float> raw(4 * problem.samples), once(problem.parameters.size(), 0.0f),
      again(once.size(), 1.0f);
  for (std::vector<float>* gradients : {&once, &again}) {
    chunks[0]->clear_gradients();
    chunks[0]->forward(all.tile, true, raw.data(), problem.samples);
    chunks[0]->backward(all.d_raw.data(), problem.samples, nullptr);
    network->reduce(chunks, *gradients, pool);
  }
  for (std::size_t i = 0; i < once.size(); ++i) {
    // Up to 128 additions in another order, each rounding a number of at most 1 + |g| by 2^-24.
    ASSERT_NEAR(again[i], 1.0f + once[i], 128 * 0x1p-24 * (1 + std::abs(once[i]))) << i;
  }
}

TEST_P(Fp32NetworkTest, PropagatesNaN) {
  Problem problem({{32, 2, 1}, 1, 5});
  ThreadPool pool(1);
  const auto network = GetParam().second(problem.shape.config);
  problem.parameters[nerf_layer(problem.shape.config, 0).weight] =
      NAN;  // in every sample's first hidden unit
  network->pack(problem.parameters, pool);
  const auto chunk = network->make_chunk(problem.samples);
  std::vector<float> raw(4 * problem.samples, 0.0f);
  chunk->forward(problem.part(0, 1).tile, false, raw.data(), problem.samples);
  for (const float x : raw) EXPECT_TRUE(std::isnan(x));
}

// gamma(p) from exact arguments: the error is the doubling's alone, far outside the unit cube too.
TEST_P(Fp32NetworkTest, EncodingIsExactFarOutsideTheUnitCube) {
  const Fp32Kernels& kernels =
      GetParam().first == Isa::kAvx2 ? avx2::kFp32Kernels : avx512::kFp32Kernels;
  const float values[] = {0.0f, -0.0f, 1.0f,      -1.0f, 0.25f,      0.3f, -0.77f, 1e-20f,
                          3.1f, -1e3f, 123456.7f, 5e6f,  8388609.0f, 3e7f, -1e30f};
  constexpr int kCount = 15, kOctaves = 10, kRows = 64, kSamples = 16;
  std::vector<float> point(3 * kCount), out(kRows * kSamples);
  for (int d = 0; d < 3; ++d)
    for (int i = 0; i < kCount; ++i) point[d * kCount + i] = values[(i + d) % kCount];
  kernels.encode(point.data(), kCount, kCount, kOctaves, kRows, kSamples, out.data());
  const double pi = std::acos(-1.0);
  for (int d = 0; d < 3; ++d)
    for (int i = 0; i < kCount; ++i)
      for (int l = 0; l < kOctaves; ++l) {
        // kSamples is one panel: row r of sample i at r * kSamples + i.
        const double turn =
            std::fmod(std::ldexp(static_cast<double>(point[d * kCount + i]), l), 2.0);
        const int row = 3 + 2 * (d * kOctaves + l);
        EXPECT_NEAR(out[row * kSamples + i], std::sin(pi * turn), 4e-6)
            << point[d * kCount + i] << " octave " << l;
        EXPECT_NEAR(out[(row + 1) * kSamples + i], std::cos(pi * turn), 4e-6)
            << point[d * kCount + i] << " octave " << l;
      }
  for (int i = 0; i < kSamples; ++i) EXPECT_EQ(out[63 * kSamples + i], 0.0f);
}

INSTANTIATE_TEST_SUITE_P(Isa, Fp32NetworkTest,
                         testing::Values(std::pair<Isa, Maker>{Isa::kAvx2, make_nerf_avx2},
                                         std::pair<Isa, Maker>{Isa::kAvx512, make_nerf_avx512}),
                         [](const auto& info) {
                           return info.param.first == Isa::kAvx2 ? "avx2" : "avx512";
                         });

}  // namespace
}  // namespace redrive::kernels

// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/self_test.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <functional>
#include <utility>
#include <vector>

#include "redrive/base/error.h"
#include "redrive/base/rng.h"
#include "redrive/kernels/grid_stages.h"
#include "redrive/kernels/nerf_stages.h"

namespace redrive::kernels {
namespace {

using Numbers = std::vector<float>;

// Neither the last tile of 16 samples nor the last warp is full.
constexpr int kRays = 37, kPerRay = 21, kSamples = kRays * kPerRay;

constexpr double kFp32 = 1e-4;  // some ten roundings, and sums of up to 10^3 in another order
// bf16 rounds both operands of a product, by at most 2^-9 each. The relative error of a
// layer's outputs is the sum.
constexpr double after_products(int n) { return n * 2 * 0x1p-9; }
// Rounding changes the sign of an equal fraction of the pre-activations. Their ReLUs then pass no
// derivative instead of all of it, or vice versa, so the relative 2-norm of the error is the square
// root of the fraction.
inline double behind_relus(int n) { return std::sqrt(after_products(n)); }

Numbers random_numbers(std::size_t size, std::uint64_t stream, double low, double high) {
  Numbers out(size);
  for (std::size_t i = 0; i < size; ++i)
    out[i] =
        static_cast<float>(low + (high - low) * random_unit(random_key(7, kStreamTest, stream), i));
  return out;
}

/// Input of the stages: rays from one origin, samples of ascending distance.
struct TestBatch {
  Numbers origin = Numbers(3 * kRays, 0.1f), direction = random_numbers(3 * kRays, 1, -1, 1),
          t = Numbers(kSamples), dt = Numbers(kSamples, 0.1f),
          raw = random_numbers(4 * kSamples, 2, -1, 2),
          d_raw = random_numbers(4 * kSamples, 3, -1, 1),
          d_rgb = random_numbers(3 * kRays, 4, -1, 1);

  TestBatch() {
    for (int ray = 0; ray < kRays; ++ray) {
      double square = 0;
      for (int k = 0; k < 3; ++k) square += std::pow(direction[k * kRays + ray], 2);
      for (int k = 0; k < 3; ++k)
        direction[k * kRays + ray] /= static_cast<float>(std::sqrt(square));
      for (int i = 0; i < kPerRay; ++i) t[ray * kPerRay + i] = 0.1f * static_cast<float>(i + 1);
    }
  }
  Rays rays() const { return {kRays, origin, direction}; }
  Samples samples() const { return {kPerRay, t, dt}; }
};

class SelfTest {
 public:
  explicit SelfTest(Backend& backend) : backend_(backend) {}

  std::optional<std::string> run() {
    memory();
    rays();
    hash_grid();
    grid_networks();
    nerf();
    score();
    return failure_;
  }

 private:
  /// Compares the arrays that `run` returns with both backends: each must agree within a relative
  /// 2-norm of `tolerance`.
  void compare(const char* stage, double tolerance,
               const std::function<std::vector<Numbers>(Backend&)>& run) {
    if (failure_) return;
    const std::vector<Numbers> expected = run(*ref_), got = run(backend_);
    for (std::size_t a = 0; a < expected.size(); ++a) {
      double off = 0, length = 0;
      for (std::size_t i = 0; i < expected[a].size(); ++i) {
        off += std::pow(double(got[a][i]) - expected[a][i], 2);
        length += std::pow(double(expected[a][i]), 2);
      }
      const double relative = std::sqrt(off / length);
      if (relative <= tolerance) continue;  // false for NaN
      char text[160];
      if (std::isnan(relative))
        std::snprintf(text, sizeof text, "%s returns NaN", stage);
      else
        std::snprintf(text, sizeof text, "%s differs by %.3g (relative 2-norm), %.2g is allowed",
                      stage, relative, tolerance);
      failure_ = text;
      return;
    }
  }

  void memory() {
    compare("memory", 0, [](Backend& backend) -> std::vector<Numbers> {
      Buffer<float> resident(1000);
      make_resident(backend, resident);
      backend.fill(resident.span().first(600), 2);
      resident[700] = 3;
      backend.upload(resident.span().subspan(700, 1));
      double mean = 0;
      backend.mean(resident, &mean);
      backend.download(resident);
      return {Numbers(resident.data(), resident.data() + resident.size()),
              {static_cast<float>(mean)}};
    });
  }

  void rays() {
    compare("sample_stratified", kFp32, [](Backend& backend) -> std::vector<Numbers> {
      Numbers t(kSamples), dt(kSamples);
      backend.nerf().sample_stratified(kRays, {kPerRay, 1, 5, true, 9}, t, dt);
      return {t};
    });
    compare("live_rays", 0, [this](Backend& backend) -> std::vector<Numbers> {
      std::vector<std::uint32_t> live(kRays);
      Numbers list(kRays, -1);
      const auto weights = std::span(batch_.raw).first(kSamples);  // they sum up to about ten a ray
      std::copy_n(live.begin(), backend.grid().compact_rays(kRays, kPerRay, weights, {10}, live),
                  list.begin());
      return {list};
    });
    compare("composite", kFp32, [this](Backend& backend) -> std::vector<Numbers> {
      Numbers rgb(3 * kRays), depth(kRays), opacity(kRays), d_raw(4 * kSamples);
      backend.composite_forward(kRays, batch_.samples(), batch_.raw, {}, {rgb, depth, opacity, {}});
      backend.composite_backward(kRays, batch_.samples(), batch_.raw, {}, {batch_.d_rgb, {}},
                                 d_raw);
      return {rgb, depth, opacity, d_raw};
    });
    compare("adam", kFp32, [this](Backend& backend) -> std::vector<Numbers> {
      Numbers parameters = batch_.raw, gradients = batch_.d_raw, first(4 * kSamples),
              second(4 * kSamples);
      backend.adam(adam_step(0.1, 1), gradients, parameters, first, second);
      return {parameters, first, second};
    });
  }

  void hash_grid() {
    const HashGridConfig config{8, 4, 16, 64, 10};  // dense levels and hashed ones
    const Numbers table = random_numbers(hash_grid_size(config), 5, -1, 1),
                  position = random_numbers(3 * kSamples, 6, 0, 1),
                  footprint = random_numbers(kSamples, 7, 0, 0.02),
                  d_features = random_numbers(32 * kSamples, 8, -1, 1);
    compare("encode", kFp32, [&](Backend& backend) -> std::vector<Numbers> {
      Numbers features(32 * kSamples), d_table(table.size());
      const UnitPoints points{kSamples, position, footprint};
      backend.grid().encode({config, table}, points, features);
      backend.grid().encode_backward({config, table}, points, d_features, d_table, {});
      return {features, d_table};
    });
  }

  void grid_networks() {
    for (const auto& [width, colour_layers] :
         {std::pair(32, 1), std::pair(64, 2)}) {  // sizes of street scenes and of objects
      GridFieldConfig config{{8, 4, 16, 64, 10}, width, colour_layers};
      Numbers weights(grid_network_size(config));
      grid_network_initialize(config, 3, weights);
      const Numbers features = random_numbers(32 * kSamples, 9, -1, 1),
                    harmonics = random_numbers(kHarmonics * kRays, 10, -1, 1);
      const GridNetwork network{config, 0.5f, weights};
      compare("grid network, forward", after_products(3 + colour_layers),
              [&](Backend& backend) -> std::vector<Numbers> {
                Numbers raw(4 * kSamples);
                backend.grid().network_forward(network, kRays, kPerRay, features, harmonics, raw);
                return {raw};
              });
      compare("grid network, backward", behind_relus(2 + colour_layers),
              [&](Backend& backend) -> std::vector<Numbers> {
                Numbers d_weights(weights.size()), d_features(features.size());
                backend.grid().network_backward(network, kRays, kPerRay, features, harmonics,
                                                batch_.d_raw, d_weights, d_features);
                return {d_weights, d_features};
              });
    }
  }

  void nerf() {
    const NerfConfig config{64};
    Numbers parameters(nerf_parameter_count(config));
    nerf_initialize(config, random_key(7, kStreamInit), parameters);
    const NerfField field{config, {{0, 0, 0}, 0.3f}, parameters};
    compare("nerf network, forward", after_products(10),
            [&](Backend& backend) -> std::vector<Numbers> {
              Numbers raw(4 * kSamples);
              backend.nerf().network_forward(field, batch_.rays(), batch_.samples(), raw);
              return {raw};
            });
    compare("nerf network, backward", behind_relus(9),
            [&](Backend& backend) -> std::vector<Numbers> {
              Numbers gradients(parameters.size());
              backend.nerf().network_backward(field, batch_.rays(), batch_.samples(), batch_.d_raw,
                                              gradients, {});
              return {gradients};
            });
  }

  void score() {
    constexpr int kWidth = 31, kHeight = 26;
    const Numbers rgb = random_numbers(3 * kWidth * kHeight, 11, 0, 1),
                  other = random_numbers(rgb.size(), 12, 0, 255);
    const std::vector<std::uint8_t> ground_truth(other.begin(), other.end());
    compare("score", kFp32, [&](Backend& backend) -> std::vector<Numbers> {
      const ImageScore score = backend.score({kWidth, kHeight, rgb, ground_truth, {}});
      return {{static_cast<float>(score.psnr_db)},
              {static_cast<float>(score.ssim)},
              {static_cast<float>(score.flip)}};
    });
  }

  Backend& backend_;
  const std::unique_ptr<Backend> ref_ = make_ref_backend();
  const TestBatch batch_;
  std::optional<std::string> failure_;
};

}  // namespace

std::optional<std::string> self_test(Backend& backend) {
  try {
    return SelfTest(backend).run();
  } catch (const std::exception& error) {
    return error.what();
  }
}

std::unique_ptr<Backend> make_if_self_test_passes(
    const std::function<std::unique_ptr<Backend>()>& make) {
  std::string failure;
  try {
    auto backend = make();
    const auto stage = self_test(*backend);
    if (!stage) return backend;
    failure = *stage;
  } catch (const DeviceError& error) {
    failure = error.what();
  }
  std::fprintf(stderr, "redrive: the GPU is not used, its self-test failed: %s\n", failure.c_str());
  return nullptr;
}

}  // namespace redrive::kernels

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

// Neither fills the last tile of 16 samples or the last warp.
constexpr int kRays = 37, kPerRay = 21, kSamples = kRays * kPerRay;

constexpr double kFp32 = 1e-4;  // some ten roundings, and sums of up to 10^3 in another order
// bf16 rounds both operands of a product, by 2^-9 at most. So do the layers' outputs differ:
constexpr double after_products(int n) { return n * 2 * 0x1p-9; }
// On the way back a neuron counts or not by the sign of what came to it: of those a share as large
// is on the other side of 0 and off by all of its derivative, which is the square root of that in
// the length of all.
inline double behind_relus(int n) { return std::sqrt(after_products(n)); }

Numbers random_numbers(std::size_t size, std::uint64_t stream, double low, double high) {
  Numbers out(size);
  for (std::size_t i = 0; i < size; ++i)
    out[i] =
        static_cast<float>(low + (high - low) * random_unit(random_key(7, kStreamTest, stream), i));
  return out;
}

/// What the stages are given: rays from one place, samples of ascending distance.
struct Given {
  Numbers origin = Numbers(3 * kRays, 0.1f), direction = random_numbers(3 * kRays, 1, -1, 1),
          t = Numbers(kSamples), dt = Numbers(kSamples, 0.1f),
          raw = random_numbers(4 * kSamples, 2, -1, 2),
          d_raw = random_numbers(4 * kSamples, 3, -1, 1),
          d_rgb = random_numbers(3 * kRays, 4, -1, 1);

  Given() {
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
  /// What `run` gives of both has to agree, each of its arrays within a share of its length
  /// (2-norm).
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
      const double share = std::sqrt(off / length);
      if (share <= tolerance) continue;  // not so for NaN
      char text[160];
      if (std::isnan(share))
        std::snprintf(text, sizeof text, "%s gives what is not a number", stage);
      else
        std::snprintf(text, sizeof text, "%s is off by %.3g of its length, %.2g is allowed", stage,
                      share, tolerance);
      failure_ = text;
      return;
    }
  }

  void memory() {
    compare("memory", 0, [](Backend& backend) -> std::vector<Numbers> {
      Buffer<float> kept(1000);
      make_resident(backend, kept);
      backend.fill(kept.span().first(600), 2);
      kept[700] = 3;
      backend.upload(kept.span().subspan(700, 1));
      double mean = 0;
      backend.mean(kept, &mean);
      backend.download(kept);
      return {Numbers(kept.data(), kept.data() + kept.size()), {static_cast<float>(mean)}};
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
      const auto weights = std::span(given_.raw).first(kSamples);  // about ten a ray
      std::copy_n(live.begin(), backend.grid().compact_rays(kRays, kPerRay, weights, {10}, live),
                  list.begin());
      return {list};
    });
    compare("composite", kFp32, [this](Backend& backend) -> std::vector<Numbers> {
      Numbers rgb(3 * kRays), depth(kRays), opacity(kRays), d_raw(4 * kSamples);
      backend.composite_forward(kRays, given_.samples(), given_.raw, {}, {rgb, depth, opacity, {}});
      backend.composite_backward(kRays, given_.samples(), given_.raw, {}, {given_.d_rgb, {}},
                                 d_raw);
      return {rgb, depth, opacity, d_raw};
    });
    compare("adam", kFp32, [this](Backend& backend) -> std::vector<Numbers> {
      Numbers parameters = given_.raw, gradients = given_.d_raw, first(4 * kSamples),
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
         {std::pair(32, 1), std::pair(64, 2)}) {  // a street's and an object's
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
                                                given_.d_raw, d_weights, d_features);
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
              backend.nerf().network_forward(field, given_.rays(), given_.samples(), raw);
              return {raw};
            });
    compare("nerf network, backward", behind_relus(9),
            [&](Backend& backend) -> std::vector<Numbers> {
              Numbers gradients(parameters.size());
              backend.nerf().network_backward(field, given_.rays(), given_.samples(), given_.d_raw,
                                              gradients, {});
              return {gradients};
            });
  }

  void score() {
    constexpr int kWidth = 31, kHeight = 26;
    const Numbers rgb = random_numbers(3 * kWidth * kHeight, 11, 0, 1),
                  other = random_numbers(rgb.size(), 12, 0, 255);
    const std::vector<std::uint8_t> truth(other.begin(), other.end());
    compare("score", kFp32, [&](Backend& backend) -> std::vector<Numbers> {
      const ImageScore score = backend.score({kWidth, kHeight, rgb, truth, {}});
      return {{static_cast<float>(score.psnr_db)},
              {static_cast<float>(score.ssim)},
              {static_cast<float>(score.flip)}};
    });
  }

  Backend& backend_;
  const std::unique_ptr<Backend> ref_ = make_ref_backend();
  const Given given_;
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
  std::fprintf(stderr, "redrive: the GPU is not taken, its self-test failed: %s\n",
               failure.c_str());
  return nullptr;
}

}  // namespace redrive::kernels

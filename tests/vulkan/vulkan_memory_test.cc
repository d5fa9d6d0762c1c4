// SPDX-License-Identifier: Apache-2.0
// What crosses from the host to the first Vulkan device, and memory that grows.
#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/base/processes/interruption.h"
#include "redrive/kernels/backend.h"
#include "redrive/kernels/self_test_scene.h"
#include "redrive/kernels/vulkan/vulkan_queue.h"
#include "tests/vulkan/wrapped_api.h"

namespace redrive::kernels {
namespace {

using WrappedApi = vulkan::testing::WrappedApi;

class VulkanMemory : public ::testing::Test {
 protected:
  void SetUp() override {
    try {
      make_vulkan_backend("0", 1);
    } catch (const UsageError& error) {
      GTEST_SKIP() << error.what();
    }
  }
};

/// Windows of images of 90 x 80 pixels, at their lower right.
struct Windows {
  static constexpr int kWidth = 90, kHeight = 80, kImages = 3;
  RasterSize size = raster_size(70, 43);
  std::vector<float> rgb = std::vector<float>(3 * size.plane(), 0.4f), d_rgb = rgb,
                     error = std::vector<float>(size.plane());
  std::vector<std::uint8_t> bytes[kImages], used;

  Windows() {
    for (int i = 0; i < kImages; ++i)
      for (int k = 0; k < 3 * kWidth * kHeight; ++k)
        bytes[i].push_back(static_cast<std::uint8_t>((7 + i) * k % 251));
    for (int k = 0; k < kWidth * kHeight; ++k) used.push_back(k % 13 != 0);
  }
  /// Returns the derivatives.
  std::vector<float> loss(GaussianStages& stages, int image, std::uint64_t set) {
    ImageLossInput input;
    input.size = size;
    input.rgb = rgb;
    input.target = {.width = kWidth,
                    .x = kWidth - size.width,
                    .y = kHeight - size.height,
                    .rgb = bytes[image],
                    .used = used,
                    .set = set,
                    .index = image};
    stages.image_loss(input, d_rgb, error);
    return d_rgb;
  }
};

TEST_F(VulkanMemory, KeepsTargetsWhileThereIsRoom) {
  WrappedApi api;
  const auto backend = make_vulkan_backend("0", 1);
  GaussianStages& stages = backend->gaussians();
  Windows windows;
  std::vector<std::vector<float>> expected;
  std::uint64_t sent = 0;
  const auto uploaded = [&](int image, std::uint64_t set) {
    api.uploaded = 0;
    const std::vector<float> found = windows.loss(stages, image, set);
    EXPECT_EQ(found, expected[image]) << "image " << image << " of set " << set;
    return api.uploaded;
  };
  for (int i = 0; i < Windows::kImages; ++i) {
    expected.emplace_back();
    expected.back() = windows.loss(stages, i, 0);
    sent = uploaded(i, 0);
  }
  EXPECT_NE(expected[0], expected[1]);
  const std::uint64_t window = 4 * 43 * Windows::kWidth,
                      whole = 4 * Windows::kHeight * Windows::kWidth;
  EXPECT_EQ(uploaded(0, 1), sent) << "nothing is kept at first";
  stages.keep_targets(2 * whole + 64);
  for (const std::uint64_t set : {2, 3})
    for (int round = 0; round < 2; ++round) {
      SCOPED_TRACE("round " + std::to_string(round) + " of set " + std::to_string(set));
      EXPECT_EQ(uploaded(0, set), sent - window + (round == 0 ? whole : 0));
      EXPECT_EQ(uploaded(1, set), sent - window + (round == 0 ? whole : 0));
      EXPECT_EQ(uploaded(2, set), sent) << "there is no room";
      EXPECT_EQ(uploaded(0, 0), sent) << "an image of no set";
    }
}

TEST_F(VulkanMemory, RangesOfSomePixelsAreThoseOfTheirPlane) {
  WrappedApi api;
  const auto backend = make_vulkan_backend("0", 1);
  const SelfTestScene scene;
  std::vector<float> plane(scene.size().plane(), kNoRange);
  std::vector<std::uint32_t> ranged;
  for (std::uint32_t i = 3; i < plane.size(); i += 41) {
    ranged.push_back(i);
    plane[i] = 1 + 1e-3f * static_cast<float>(i % 500);
  }
  std::vector<float> errors[2];
  std::uint64_t uploaded[2];
  for (const int some : {0, 1}) {
    RasterOptions options;
    options.log_range = plane;
    if (some) options.ranged = ranged;
    api.uploaded = 0;
    const Raster raster =
        backend->gaussians().rasterise(scene.view(), {scene.kCount, scene.numbers}, options);
    const Buffer<float>& error = raster.image().range_error;
    errors[some].assign(error.data(), error.data() + plane.size());
    uploaded[some] = api.uploaded;
  }
  EXPECT_EQ(errors[1], errors[0]);
  EXPECT_EQ(uploaded[0] - uploaded[1], 4 * plane.size() - 8 * ranged.size());
}

/// Sets what Ctrl-C sets, while it lives.
class Interruption {
 public:
  Interruption() { request_stop(); }
  ~Interruption() { const InterruptibleCall clears; }
};

TEST_F(VulkanMemory, AnInterruptedPassLeavesNothingBehind) {
  const auto backend = make_vulkan_backend("0", 1);
  const SelfTestScene scene;
  const RasterSize size = scene.size();
  std::vector<float> u, v;
  for (int y = 0; y < size.rows; ++y)
    for (int x = 0; x < size.stride; ++x) {
      u.push_back(static_cast<float>(x));
      v.push_back(static_cast<float>(y));
    }
  GaussianCamera camera = scene.view();
  camera.centres = {u, v};
  const auto rendered = [&] {
    const Raster raster = backend->gaussians().rasterise(camera, {scene.kCount, scene.numbers}, {});
    const Buffer<float>& rgb = raster.image().rgb;
    return std::vector<float>(rgb.data(), rgb.data() + 3 * size.plane());
  };
  {
    const Interruption interruption;
    EXPECT_THROW(rendered(), Interrupted);
  }
  const std::vector<float> after = rendered();
  EXPECT_EQ(after, rendered());
  EXPECT_GT(std::ranges::max(after), 0.1f);
}

TEST_F(VulkanMemory, CopiesAreNotInterrupted) {
  constexpr std::size_t kBytes = 5 << 20;
  const auto device = vulkan::Device::open("0");
  ThreadPool pool(2);
  const auto queue = vulkan::Queue::make(device.get(), &pool);
  const vulkan::DeviceBuffer buffer = queue->allocate(kBytes);
  const std::vector<std::uint8_t> sent(kBytes, 7);
  std::vector<std::uint8_t> received(kBytes);
  const Interruption interruption;
  queue->upload(buffer, 0, sent.data(), kBytes);
  queue->download(buffer, 0, received.data(), kBytes);
  queue->finish();
  EXPECT_TRUE(received == sent);
}

TEST_F(VulkanMemory, StagingGrows) {
  const auto device = vulkan::Device::open("0");
  ThreadPool pool(1);
  const auto queue = vulkan::Queue::make(device.get(), &pool);
  // Chunks have 16 MiB; the sizes fill one, need their own, and end one.
  const std::size_t bytes[] = {9 << 20, 9 << 20, 20 << 20, 1, 7 << 20};
  for (int round = 0; round < 2; ++round) {
    std::vector<vulkan::DeviceBuffer> buffers;
    std::vector<std::vector<std::uint8_t>> sent, received;
    for (const std::size_t n : bytes) {
      buffers.push_back(queue->allocate(n));
      sent.emplace_back(n);
      for (std::size_t i = 0; i < n; i += 4093)
        sent.back()[i] = static_cast<std::uint8_t>(i / 4093 + sent.size() + 7 * round);
      received.emplace_back(n);
    }
    for (std::size_t k = 0; k < sent.size(); ++k)
      queue->upload(buffers[k], 0, sent[k].data(), sent[k].size());
    for (std::size_t k = 0; k < sent.size(); ++k)
      queue->download(buffers[k], 0, received[k].data(), received[k].size());
    queue->finish();
    for (std::size_t k = 0; k < sent.size(); ++k) EXPECT_TRUE(received[k] == sent[k]) << k;
  }
}

TEST_F(VulkanMemory, MorePairsThanTheirMemoryHolds) {
  constexpr std::size_t kFirst = 1 << 16;  // pairs for which there is memory at first
  SelfTestScene scene;
  scene.camera.width = 384;
  scene.camera.height = 256;
  scene.camera.cx = 191.5f;
  scene.camera.cy = 127.5f;
  for (std::size_t i = 0; i < scene.kCount; ++i) {
    scene.numbers[gaussian_slot(i, kOpacityRow)] = 3;  // few hide the others
    for (int k = 0; k < 3; ++k) scene.numbers[gaussian_slot(i, kLogScaleRow + k)] = 2.5f;
  }
  const std::vector<std::uint8_t> target(3 * 384 * 256, 99);
  struct Found {
    RasterCounts counts;
    double loss = 0;
    std::vector<float> rgb, gradients;
  };
  const auto run = [&](Backend& backend, bool counts_first) {
    Found out;
    Raster raster = backend.gaussians().rasterise(scene.view(), {scene.kCount, scene.numbers}, {});
    if (!counts_first) {  // backward() finds the overflow
      out.gradients.resize(scene.numbers.size());
      std::vector<float> errors(scene.numbers.size() / kGaussianRows);
      ImageLossInput input;
      input.target = {.width = 384, .rgb = target};
      out.loss = raster
                     .backward(input, {.transmittance = 0.02f},
                               {.gradients = out.gradients, .errors = errors}, {})
                     .l1;
    }
    out.counts = raster.counts();
    const Buffer<float>& rgb = raster.image().rgb;
    out.rgb.assign(rgb.data(), rgb.data() + 3 * scene.size().plane());
    return out;
  };
  const auto processor = make_backend({.name = "cpu", .threads = 2});
  const Found expected = run(*processor, false), a = run(*make_vulkan_backend("0", 1), false),
              b = run(*make_vulkan_backend("0", 1), true);
  EXPECT_GT(a.counts.pairs, kFirst);
  EXPECT_EQ(a.counts.visible, expected.counts.visible);
  EXPECT_NEAR(a.loss, expected.loss, 1e-3 * expected.loss);
  double of_gradients = 0, off = 0;
  for (std::size_t i = 0; i < a.gradients.size(); ++i) {
    of_gradients += std::pow(static_cast<double>(expected.gradients[i]), 2);
    off += std::pow(static_cast<double>(a.gradients[i] - expected.gradients[i]), 2);
  }
  EXPECT_GT(of_gradients, 0);
  EXPECT_LT(off, 1e-4 * of_gradients);
  EXPECT_EQ(a.rgb, b.rgb);
  EXPECT_EQ(a.counts.pairs, b.counts.pairs);
  for (std::size_t i = 0; i < a.rgb.size(); ++i) ASSERT_NEAR(a.rgb[i], expected.rgb[i], 2e-3f);
}

}  // namespace
}  // namespace redrive::kernels

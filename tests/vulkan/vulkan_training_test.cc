// SPDX-License-Identifier: Apache-2.0
// Training on Vulkan devices in software, each in a process of its own, since drivers read their
// settings from the environment.
#include <bit>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <memory>
#include <sstream>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/kernels/backend.h"
#include "redrive/kernels/self_test_scene.h"
#include "tests/support/program.h"
#include "tests/vulkan/wrapped_api.h"

namespace redrive::kernels {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;
using Environment = std::map<std::string, std::string>;

constexpr const char* kIsChild = "REDRIVE_TRAINS_ON_VULKAN";
constexpr const char* kLavapipe = "/usr/share/vulkan/icd.d/lvp_icd.x86_64.json";
constexpr const char* kSwiftShader = "/usr/lib/chromium/vk_swiftshader_icd.json";
constexpr const char* kValidation =
    "/usr/share/vulkan/explicit_layer.d/VkLayer_khronos_validation.json";

/// The self-test's Gaussians learn an image of stripes.
struct Training : SelfTestScene {
  static constexpr std::uint64_t kVersion = 1;
  std::vector<float> errors = std::vector<float>(numbers.size() / kGaussianRows);
  std::vector<std::uint32_t> moments = std::vector<std::uint32_t>(numbers.size());
  std::vector<std::uint8_t> target;

  Training() {
    for (int i = 0; i < camera.width * camera.height; ++i)
      for (int c = 0; c < 3; ++c)
        target.push_back(static_cast<std::uint8_t>(i % camera.width / 7 % 2 ? 40 * c + 90 : 200));
  }

  double step(Backend& backend, int number) {
    Raster raster = backend.gaussians().rasterise(view(), {kCount, numbers, kVersion}, {});
    ImageLossInput input;
    input.target = {.width = camera.width, .rgb = target};
    GaussianUpdate update;
    update.step = adam_step(0, number + 1);
    update.step.epsilon = 1e-15f;
    for (float& rate : update.rates) rate = 0.02f;
    update.version = kVersion;
    update.numbers = numbers;
    update.moments = moments;
    update.errors = errors;
    const ImageLossOutput loss =
        raster.backward(input, {.transmittance = 0.02f}, {.update = &update}, {});
    return loss.l1 + loss.dssim;
  }

  std::uint64_t bits() const {
    std::uint64_t hash = 14695981039346656037u;  // FNV-1a
    const auto add = [&](std::uint32_t word) { hash = (hash ^ word) * 1099511628211u; };
    for (const float x : numbers) add(std::bit_cast<std::uint32_t>(x));
    for (const std::uint32_t word : moments) add(word);
    for (const float x : errors) add(std::bit_cast<std::uint32_t>(x));
    return hash;
  }
};

/// What the child prints.
struct Trained {
  std::string bits;
  double first = 0, last = 0;  ///< losses
};

/// Trains on the first device, in the process that the other tests start.
TEST(VulkanChild, Trains) {
  const char* const steps = std::getenv(kIsChild);
  if (!steps) return;
  const auto backend = make_vulkan_backend("0", 1);
  Training training;
  double first = 0, last = 0;
  for (int i = 0; i < std::atoi(steps); ++i) {
    last = training.step(*backend, i);
    if (i == 0) first = last;
  }
  backend->gaussians().fetch();
  std::printf("trained %016llx %.9g %.9g\n", static_cast<unsigned long long>(training.bits()),
              first, last);
}

class VulkanTraining : public ::testing::Test {
 protected:
  /// Runs VulkanChild with these variables.
  static testing::ProgramResult run(Environment environment, int steps = 15) {
    environment[kIsChild] = std::to_string(steps);
    for (const auto& [name, value] : environment) setenv(name.c_str(), value.c_str(), 1);
    const testing::ProgramResult result =
        testing::Program("/proc/self/exe", {"--gtest_filter=VulkanChild.Trains"}).wait();
    for (const auto& [name, value] : environment) unsetenv(name.c_str());
    return result;
  }
  static Trained trained(const testing::ProgramResult& result) {
    Trained out;
    EXPECT_EQ(result.exit_code, 0) << result.out << result.err;
    const auto at = result.out.find("trained ");
    EXPECT_NE(at, std::string::npos) << result.out << result.err;
    if (at != std::string::npos)
      std::istringstream(result.out.substr(at + 8)) >> out.bits >> out.first >> out.last;
    return out;
  }
};
#define REDRIVE_NEEDS(file, package) \
  if (!std::filesystem::exists(file)) GTEST_SKIP() << package " is not installed"

TEST_F(VulkanTraining, ThreadsAndVectorWidthsChangeNoBit) {
  REDRIVE_NEEDS(kLavapipe, "mesa-vulkan-drivers");
  const auto train = [](const char* threads, const char* width) {
    return trained(run({{"VK_ICD_FILENAMES", kLavapipe},
                        {"LP_NUM_THREADS", threads},
                        {"LP_NATIVE_VECTOR_WIDTH", width}},
                       100));
  };
  const Trained one = train("1", "256");
  EXPECT_LT(one.last, 0.5 * one.first);
  EXPECT_EQ(train("2", "256").bits, one.bits);
  EXPECT_EQ(train("3", "512").bits, one.bits);
  EXPECT_EQ(train("2", "128").bits, one.bits);
}

TEST_F(VulkanTraining, GroupsInRowsChangeNoBit) {
  std::uint64_t bits[2];
  vulkan::testing::WrappedApi api;
  for (const std::uint32_t groups_of_row : {0u, 3u}) {
    api.groups_of_row = groups_of_row;
    std::unique_ptr<Backend> backend;
    try {
      backend = make_vulkan_backend("0", 1);
    } catch (const UsageError& error) {
      GTEST_SKIP() << error.what();
    }
    Training training;
    for (int i = 0; i < 2; ++i) training.step(*backend, i);
    backend->gaussians().fetch();
    bits[groups_of_row > 0] = training.bits();
  }
  EXPECT_EQ(bits[1], bits[0]);
}

TEST_F(VulkanTraining, AnotherDriverTrainsAlike) {
  REDRIVE_NEEDS(kLavapipe, "mesa-vulkan-drivers");
  REDRIVE_NEEDS(kSwiftShader, "chromium");
  const Trained a = trained(run({{"VK_ICD_FILENAMES", kLavapipe}})),
                b = trained(run({{"VK_ICD_FILENAMES", kSwiftShader}}));
  EXPECT_NE(a.bits, b.bits) << "it is another driver";
  EXPECT_NEAR(a.first, b.first, 1e-5 * a.first);
  EXPECT_NEAR(a.last, b.last, 0.02 * a.last);
  EXPECT_EQ(trained(run({{"VK_ICD_FILENAMES", kSwiftShader}})).bits, b.bits);
}

TEST_F(VulkanTraining, ValidationFindsNothing) {
  REDRIVE_NEEDS(kLavapipe, "mesa-vulkan-drivers");
  REDRIVE_NEEDS(kValidation, "vulkan-validationlayers");
  const testing::ProgramResult result =
      run({{"VK_ICD_FILENAMES", kLavapipe},
           {"VK_INSTANCE_LAYERS", "VK_LAYER_KHRONOS_validation"},
           {"VK_LAYER_ENABLES", "VK_VALIDATION_FEATURE_ENABLE_SYNCHRONIZATION_VALIDATION_EXT"},
           {"VK_LOADER_DEBUG", "layer"}});
  trained(result);
  EXPECT_THAT(result.err, HasSubstr("VkLayer_khronos_validation")) << "the layer is loaded";
  for (const char* sign : {"VUID", "SYNC-HAZARD", "UNASSIGNED", "Validation Error"})
    EXPECT_THAT(result.out, Not(HasSubstr(sign)));
}

}  // namespace
}  // namespace redrive::kernels

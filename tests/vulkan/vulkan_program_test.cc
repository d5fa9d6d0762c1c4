// SPDX-License-Identifier: Apache-2.0
// The program as users meet it, on lavapipe.
#include <cstdlib>
#include <filesystem>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "redrive/base/files/temporary_folder_testing.h"
#include "tests/e2e/same_end.h"

namespace redrive::testing {
namespace {

using ::testing::HasSubstr;

class VulkanProgram : public ::testing::Test {
 protected:
  static constexpr const char* kLavapipe = "/usr/share/vulkan/icd.d/lvp_icd.x86_64.json";
  void SetUp() override {
    if (!fs::exists(kLavapipe)) GTEST_SKIP() << "mesa-vulkan-drivers is not installed";
    setenv("VK_ICD_FILENAMES", kLavapipe, 1);
  }
  void TearDown() override {
    for (const char* name :
         {"VK_ICD_FILENAMES", "VK_LAYER_PATH", "VK_INSTANCE_LAYERS", "REDRIVE_LOSES_DEVICE_AT"})
      unsetenv(name);
  }
  static ProgramResult redrive(const std::vector<std::string>& arguments) {
    return Program(REDRIVE_BINARY, arguments).wait();
  }
  const TemporaryFolder folder_;
};

TEST_F(VulkanProgram, TrainsTheStreetAsTheProcessorDoes) {
  const auto arguments = [&](const char* name, const std::vector<std::string>& backend) {
    std::vector<std::string> all = {"train",
                                    REDRIVE_SAMPLES "/street",
                                    "--truth-poses",
                                    "--frames",
                                    "1000:1015",
                                    "--downscale",
                                    "8",
                                    "--holdout-every",
                                    "8",
                                    "--set",
                                    "scan.first=8",
                                    "--max-steps",
                                    "60",
                                    "--max-seconds",
                                    "0",
                                    "--checkpoint-every",
                                    "10",
                                    "--out",
                                    (folder_.path / name).string()};
    all.insert(all.end(), backend.begin(), backend.end());
    return all;
  };
  const std::vector<std::string> gpu = {"--device", "llvmpipe"};
  for (const char* name : {"gpu", "cpu"}) {
    const bool on_gpu = std::string(name) == "gpu";
    const ProgramResult ended =
        redrive(arguments(name, on_gpu ? gpu : std::vector<std::string>{"--backend", "cpu"}));
    ASSERT_EQ(ended.exit_code, kExitOk) << ended.err;
    EXPECT_THAT(ended.out, HasSubstr(on_gpu ? "backend=vulkan" : "backend=cpu"));
  }
  const auto psnr_db = [&](const char* name) {
    const ProgramResult scored =
        redrive({"eval", (folder_.path / name).string(), "--backend", "cpu", "--json"});
    EXPECT_EQ(scored.exit_code, kExitOk) << scored.err;
    double sum = 0;
    const nlohmann::json cameras = nlohmann::json::parse(scored.out).at("cameras");
    for (const nlohmann::json& camera : cameras) sum += camera.at("psnr_db").get<double>();
    return sum / static_cast<double>(cameras.size());
  };
  const double of_cpu = psnr_db("cpu");
  EXPECT_GT(of_cpu, 20);
  EXPECT_NEAR(psnr_db("gpu"), of_cpu, 0.1);

  const fs::path parts = folder_.path / "parts";
  expect_same_end_when_killed(folder_.path / "gpu", parts, arguments("parts", gpu), {1});
  setenv("VK_LAYER_PATH", REDRIVE_LAYERS, 1);
  setenv("VK_INSTANCE_LAYERS", "VK_LAYER_REDRIVE_failing", 1);
  setenv("REDRIVE_LOSES_DEVICE_AT", "100", 1);
  const ProgramResult lost = redrive(arguments("lost", gpu));
  unsetenv("VK_INSTANCE_LAYERS");
  EXPECT_EQ(lost.exit_code, kExitDevice) << lost.err;
  EXPECT_THAT(lost.err, HasSubstr("device lost"));
  const std::string run = (folder_.path / "lost").string();
  const std::int64_t step = load_checkpoint(folder_.path / "lost/checkpoint.safetensors").step;
  EXPECT_GE(step, 10);
  EXPECT_LT(step, 60);
  const ProgramResult resumed = redrive({"resume", run, "--device", "llvmpipe"});
  EXPECT_EQ(resumed.exit_code, kExitOk) << resumed.err;
  expect_same_end(folder_.path / "gpu", run);
  const ProgramResult elsewhere =
      redrive({"resume", parts.string(), "--backend", "cpu", "--max-steps", "61"});
  EXPECT_EQ(elsewhere.exit_code, kExitOk) << elsewhere.err;
  EXPECT_THAT(elsewhere.out, HasSubstr("backend=cpu"));
}

TEST_F(VulkanProgram, DevicesThatAreNotThereAreNamed) {
  const ProgramResult none = redrive({"bench", "--device", "nothing"});
  EXPECT_EQ(none.exit_code, kExitUsage);
  EXPECT_THAT(none.err, HasSubstr("--device nothing"));
  const ProgramResult other = redrive({"bench", "--backend", "cpu", "--device", "llvmpipe"});
  EXPECT_EQ(other.exit_code, kExitUsage);
  EXPECT_THAT(other.err, HasSubstr("--device llvmpipe: chooses a GPU"));
}

}  // namespace
}  // namespace redrive::testing

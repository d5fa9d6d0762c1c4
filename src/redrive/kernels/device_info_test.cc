// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/device_info.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"

namespace redrive::kernels {
namespace {

using ::testing::HasSubstr;

TEST(DeviceInfo, SaysWhatHidesAnNvidiaGpu) {
  const std::vector<DeviceInfo> software = {{.name = "llvmpipe", .driver = "llvmpipe Mesa 22.3.6"}},
                                nvidia = {{.name = "RTX", .driver = "NVIDIA 580.65"}};
  EXPECT_EQ(hidden_nvidia(false, "compute,utility", software), "");
  EXPECT_EQ(hidden_nvidia(true, "compute,utility", nvidia), "");
  EXPECT_THAT(hidden_nvidia(true, "compute,utility", software),
              HasSubstr("NVIDIA_DRIVER_CAPABILITIES=all or compute,utility,graphics"));
  EXPECT_THAT(hidden_nvidia(true, "", {}), HasSubstr("=all or graphics"));
  for (const char* capabilities : {"all", "graphics,utility", static_cast<const char*>(nullptr)})
    EXPECT_THAT(hidden_nvidia(true, capabilities, {}), HasSubstr("nvidia-vulkan-icd"));
}

TEST(DeviceInfo, ProcessesHaveADeviceEach) {
  using ::testing::ElementsAre;
  const std::vector<DeviceInfo> devices = {{.name = "A"},
                                           {.name = "software", .is_cpu = true},
                                           {.name = "old", .missing = {"atomics"}},
                                           {.name = "B"}};
  EXPECT_THAT(devices_of_processes(devices, "", 3), ElementsAre("0", "3", "0"));
  EXPECT_THAT(devices_of_processes(devices, "", 1), ElementsAre(""));
  EXPECT_THAT(devices_of_processes({devices[0]}, "", 2), ElementsAre("", ""));
  EXPECT_THAT(devices_of_processes(devices, "B", 2), ElementsAre("B", "B"));
  EXPECT_THAT(devices_of_processes(devices, "B,0,B", 2), ElementsAre("B", "0"));
  EXPECT_THAT(devices_of_processes(devices, "1,1", 2), ElementsAre("1", "1"));
  EXPECT_THAT(devices_of_processes(devices, "a, b", 1), ElementsAre("a, b")) << "one name";
  try {
    devices_of_processes(devices, "0,3", 3);
    ADD_FAILURE();
  } catch (const UsageError& error) {
    EXPECT_THAT(error.what(), HasSubstr("--device"));
    EXPECT_THAT(error.what(), HasSubstr("names 2 devices for 3 processes"));
  }
}

TEST(DeviceInfo, ListsDevicesOrSaysWhyThereAreNone) {
  std::string reason;
  const std::vector<DeviceInfo> devices = list_devices(&reason);
  EXPECT_EQ(devices.empty(), !reason.empty());
  for (const DeviceInfo& device : devices) {
    EXPECT_FALSE(device.name.empty());
    EXPECT_FALSE(device.driver.empty()) << device.name;
    EXPECT_THAT(device.api, ::testing::MatchesRegex("[0-9]+\\.[0-9]+\\.[0-9]+")) << device.name;
    EXPECT_GT(device.memory, 1u << 20) << device.name;
  }
}

}  // namespace
}  // namespace redrive::kernels

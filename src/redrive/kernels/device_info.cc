// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/device_info.h"

#include <algorithm>
#include <cctype>
#include <sstream>

#include "redrive/base/error.h"

namespace redrive::kernels {
namespace {

std::string lower(std::string text) {
  for (char& c : text) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return text;
}

}  // namespace

std::string joined(const std::vector<std::string>& parts) {
  std::string all;
  for (const std::string& part : parts) all += (all.empty() ? "" : ", ") + part;
  return all;
}

std::size_t choose_device(const std::vector<DeviceInfo>& devices, const std::string& which) {
  if (which.empty()) {
    for (std::size_t i = 0; i < devices.size(); ++i)
      if (!devices[i].is_cpu && devices[i].missing.empty()) return i;
    throw UsageError("--backend", "vulkan",
                     "no GPU that it can use was found; \"redrive doctor\" lists the devices, and "
                     "--device NAME takes a software one");
  }
  const bool number = std::ranges::all_of(
      which, [](char c) { return std::isdigit(static_cast<unsigned char>(c)); });
  std::string names;
  for (std::size_t i = 0; i < devices.size(); ++i) {
    const bool found = number ? std::to_string(i) == which
                              : lower(devices[i].name).find(lower(which)) != std::string::npos;
    if (!found) {
      names += (i ? ", " : "") + std::to_string(i) + ": " + devices[i].name;
      continue;
    }
    if (!devices[i].missing.empty())
      throw UsageError("--device", which, devices[i].name + " lacks " + joined(devices[i].missing));
    return i;
  }
  throw UsageError("--device", which, "must be one of " + names);
}

std::vector<std::string> devices_of_processes(const std::vector<DeviceInfo>& devices,
                                              const std::string& which, int n) {
  std::vector<std::string> all;
  if (which.empty()) {
    for (std::size_t i = 0; i < devices.size(); ++i)
      if (!devices[i].is_cpu && devices[i].missing.empty()) all.push_back(std::to_string(i));
  } else {
    std::istringstream text(which);
    for (std::string one; std::getline(text, one, ',');) all.push_back(one);
  }
  const std::size_t given = all.size(), wanted = static_cast<std::size_t>(n);
  if (!which.empty() && given > 1 && given < wanted)
    throw UsageError("--device", which,
                     "names " + std::to_string(given) + " devices for " + std::to_string(n) +
                         " processes of a machine; a device may be named twice");
  if (wanted == 1 || given < 2) return std::vector<std::string>(wanted, which);
  std::vector<std::string> out;
  for (std::size_t i = 0; i < wanted; ++i) out.push_back(all[i % given]);
  return out;
}

std::string hidden_nvidia(bool has_nvidia, const char* capabilities,
                          const std::vector<DeviceInfo>& devices) {
  const auto is_nvidia = [](const DeviceInfo& device) {
    return device.driver.find("NVIDIA") != std::string::npos;
  };
  if (!has_nvidia || std::ranges::any_of(devices, is_nvidia)) return "";
  const std::string given = capabilities ? capabilities : "";
  if (capabilities && given.find("all") == std::string::npos &&
      given.find("graphics") == std::string::npos)
    return "an NVIDIA GPU is there, but this container has no Vulkan driver for it: start it with "
           "NVIDIA_DRIVER_CAPABILITIES=all or " +
           given + (given.empty() ? "" : ",") + "graphics";
  return "an NVIDIA GPU is there, but no Vulkan driver for it (Debian: nvidia-vulkan-icd; a "
         "container needs NVIDIA_DRIVER_CAPABILITIES=all)";
}

}  // namespace redrive::kernels

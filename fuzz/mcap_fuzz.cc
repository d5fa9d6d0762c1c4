// SPDX-License-Identifier: Apache-2.0
// MCAP files: opens any bytes and reads the messages, or throws an InputError.
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>

#include "redrive/base/error.h"
#include "redrive/recording/formats/rosbag/mcap.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace redrive;
  std::string bytes(reinterpret_cast<const char*>(data), size);
  try {
    const auto file = rosbag::open_mcap(std::make_unique<StringBytes>(std::move(bytes)), "a.mcap");
    std::size_t read = 0;
    constexpr std::size_t kMost = 32;
    for (const rosbag::Topic& topic : file->topics())
      for (const rosbag::Message& message : topic.messages)
        for (const std::size_t most : {std::size_t{16}, rosbag::kAllBytes}) {
          if (++read > kMost) return 0;
          try {
            file->read(std::span(&message, 1), most, [&](std::size_t, std::string_view found) {
              if (found.size() > most) __builtin_trap();
            });
          } catch (const InputError&) {
          }
        }
  } catch (const InputError&) {
  }
  return 0;
}

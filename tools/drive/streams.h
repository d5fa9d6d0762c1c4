// SPDX-License-Identifier: Apache-2.0
// Purposes of random numbers of a made drive (redrive/base/rng.h).
#pragma once

#include <cstdint>

namespace redrive::drive {

enum DriveStream : std::uint64_t {
  kStreamRoad = 1000,
  kStreamHouses,
  kStreamTrees,
  kStreamCars,
  kStreamLamps,
  kStreamClutter,
  kStreamPoses,     ///< errors of the egomotion; counter = frame
  kStreamExposure,  ///< counter = frame
  kStreamLidar      ///< noise of ranges; counter = firing
};

}  // namespace redrive::drive

// SPDX-License-Identifier: Apache-2.0
// The sensors of a drive as components of an NCore sequence.
#pragma once

#include <atomic>
#include <cstddef>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/export/drive.h"
#include "redrive/export/ncore/ncore_sequence.h"

namespace redrive::ncore {

/// Whether a time is more than 0.2 s before the first or after the last pose. In between the motion
/// at the ends continues, as in recording/core/trajectory.h.
inline bool is_beyond_poses(const Recording& drive, std::int64_t t_ns) {
  constexpr std::int64_t kBeyond_ns = 200'000'000;
  return t_ns < drive.frames.front().t_ns - kBeyond_ns ||
         t_ns > drive.frames.back().t_ns + kBeyond_ns;
}

/// A sensor that was written.
struct WrittenSensor {
  std::string id;
  Rigid3d rig_from_sensor;
  Json model;       ///< {"type", "parameters"}; a LiDAR's may be null
  std::string ego;  ///< PNG, white where all of a camera's images are masked; empty: nowhere
};

/// Writes the images of a camera. Throws as write_kitti360.
WrittenSensor write_camera(const RecordedCamera& camera, const std::vector<FramePose>& frames,
                           ThreadPool& pool, const std::atomic<bool>& stop, Sequence* sequence,
                           DriveNotes* notes);

/// Writes the revolutions of a LiDAR. Throws as write_kitti360.
WrittenSensor write_lidar(const Recording& drive, std::size_t lidar, ThreadPool& pool,
                          const std::atomic<bool>& stop, Sequence* sequence, DriveNotes* notes);

/// Calls make(i) on the threads of the pool and use(result) for one i after the other; as many
/// results as threads are in memory.
template <class Make, class Use>
void make_in_order(ThreadPool& pool, std::size_t n, const Make& make, const Use& use) {
  using Made = std::invoke_result_t<Make, std::size_t>;
  const auto threads = static_cast<std::size_t>(pool.threads());
  for (std::size_t begin = 0; begin < n; begin += threads) {
    std::vector<Made> made(std::min(threads, n - begin));
    pool.run(static_cast<int>(made.size()), [&](int i) {
      const auto k = static_cast<std::size_t>(i);
      made[k] = make(begin + k);
    });
    for (Made& one : made) use(one);
  }
}

}  // namespace redrive::ncore

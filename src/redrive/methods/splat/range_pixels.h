// SPDX-License-Identifier: Apache-2.0
// LiDAR returns as pixels of an image.
#pragma once

#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "redrive/model/trainee.h"

namespace redrive {

/// A LiDAR return in an image of full size.
struct RangePixel {
  std::uint16_t x, y;
  float log_range;  ///< logarithm of its distance from the camera, metres
};

/// A LiDAR return that an image shows, in the axes of the body when the image's middle row was
/// exposed, metres.
using ShownReturn = Eigen::Vector3f;

/// Finds the returns near a time without reading all of them: they come scan by scan, so
/// neighbouring returns have similar times.
class ReturnTimes {
 public:
  using Range = std::pair<std::size_t, std::size_t>;  ///< indices from `first` to `second` - 1

  explicit ReturnTimes(const LidarReturns& lidar);
  /// Returns ranges, ascending, that hold all returns of these times, and others.
  std::vector<Range> ranges(std::int64_t first_ns, std::int64_t last_ns) const;

 private:
  struct Chunk {
    std::int64_t first_ns, last_ns;
  };
  std::size_t n_;
  std::vector<Chunk> chunks_;
};

/// Returns the LiDAR returns that a view's image shows: returns near the time of its exposure, so
/// that what moves is where it was, and not behind nearer ones. A pixel has only the first of its
/// returns. `times`: times of data.lidar. Poses are as recorded, so that the result does not depend
/// on when it is found. Returns on moving objects are where the object is by then.
std::vector<ShownReturn> find_shown_returns(const TrainingSet& data, const ReturnTimes& times,
                                            std::size_t of_view);

/// Returns the pixels of a view's returns by the poses as they are now, in their order, without
/// returns that have left the image. LiDAR and camera ride on one body, so what refinement changes
/// of them is the camera's extrinsics and the motion during a readout.
std::vector<RangePixel> range_pixels(const Scene& scene, const View& view,
                                     std::span<const ShownReturn> returns, ThreadPool& pool);

/// Estimates the bytes of the shown returns of all training views for this many returns.
std::uint64_t shown_return_bytes(const Scene& scene, std::uint64_t returns);

}  // namespace redrive

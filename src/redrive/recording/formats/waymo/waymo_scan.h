// SPDX-License-Identifier: Apache-2.0
// Range images of the Waymo Open Dataset as points: rows are beams from the highest to the lowest,
// columns azimuths from behind, clockwise (waymo_open_dataset/utils/range_image_utils.py).
#pragma once

#include <cstddef>
#include <vector>

#include "redrive/recording/core/lidar_point.h"
#include "redrive/recording/formats/waymo/waymo_frame.h"

namespace redrive::waymo {

/// Begin and end of a revolution of the laser on the roof.
struct Revolution {
  std::int64_t begin_ns = 0, end_ns = 0;
  Rigid3d world_from_body;  ///< the frame's pose, at begin_ns
};

/// Returns the first returns. In a range image with poses each lies where its pose puts it, and is
/// timed when the car was nearest to that pose on its way, or by its column where the car hardly
/// moves; in others it lies where the frame's pose puts it, at the frame's time. `poses`: the
/// body's. `left_out`: as RecordingReader::read_lidar. InputError for a damaged image.
std::vector<LidarPoint> read_scan(const ByteSource& bytes, const RangeImage& image,
                                  const LaserContext& laser, const Revolution& revolution,
                                  const std::vector<FramePose>& poses,
                                  const std::filesystem::path& file, std::size_t* left_out);

}  // namespace redrive::waymo

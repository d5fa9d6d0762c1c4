// SPDX-License-Identifier: Apache-2.0
// Overlays of an image: lines and LiDAR points, projected through the camera's real lens, and
// masked pixels.
#pragma once

#include <list>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "redrive/perception/line_pen.h"
#include "redrive/perception/masks.h"
#include "redrive/view/rendered_scans.h"
#include "redrive/view/view_renderer.h"

namespace redrive::view {

/// A line in an image: "trajectory", "frustum", "box", "object" or "handle". Points are u, v: from
/// 0 at the left and upper edge to 1 at the others.
using OverlayLine = ImageLine;

class Overlay {
 public:
  explicit Overlay(const Run& run);  ///< `run` must outlive it

  /// Lines are broken where the lens sees nothing. InputError for a damaged box file.
  std::vector<OverlayLine> lines(const Placement& placement, const Overlays& which) const;

  /// Returns the LiDAR points that no surface of the image hides, 6 bytes each: u and v in 1/65535
  /// of the image (16 bits, little-endian), colour (range_colour, or the rendered scan's), kind: 0
  /// for the cloud, 1 for the frame's scan, 2 for the rendered one, which may be null. At most
  /// kPointsOfImage come from the cloud, and as many from the rendered scan. InputError for a
  /// damaged LiDAR file.
  std::string points(const RenderJob& job, const Overlays& which,
                     const RenderedScan* rendered = nullptr);

  /// Reads the next scan of the run's frames into the cloud. Returns whether there was one.
  /// InputError for a damaged file, which the next call skips.
  bool read_cloud();
  /// Number of scans that read_cloud has read.
  std::size_t cloud_revolutions() const { return cloud_read_; }

  static constexpr std::size_t kCloudPoints = 200000, kPointsOfImage = 40000;

 private:
  using Points = std::vector<Eigen::Vector3f>;
  Points read(const FrameFile& file) const;
  std::shared_ptr<const Points> revolution(std::int64_t frame);

  const Run& run_;
  std::vector<const FrameFile*> cloud_files_;
  std::size_t cloud_read_ = 0;
  Points cloud_;
  std::list<std::pair<std::int64_t, std::shared_ptr<const Points>>> revolutions_;  ///< latest first
};

/// Returns the box of a moving object at the placement's time ("object"), and a line on the road
/// from its middle to the point that turns it ("handle"), where there is one; nothing where the
/// object does not exist.
std::vector<OverlayLine> object_lines(const Placement& placement, const MovingObject& object);

/// Returns the lengths of the runs of used and masked pixels in turn, row by row, starting with
/// used pixels: 7 bits a byte, low ones first, the eighth bit set where more follow.
std::string mask_runs(const Mask& mask);

}  // namespace redrive::view

// SPDX-License-Identifier: Apache-2.0
// The made street under a sun that casts shadows, and what rays see of it. Surfaces are matt, so
// that a point looks the same from everywhere.
#pragma once

#include <span>

#include "redrive/camera/camera.h"
#include "redrive/image/image.h"
#include "tools/drive/caster.h"
#include "tools/drive/road.h"

namespace redrive::drive {

class World {
 public:
  /// The street along first_m <= s <= last_m of the road, with fields around it.
  World(unsigned seed, double first_m, double last_m, double loop_m = 0);

  const Road& road() const { return road_; }
  const Caster& caster() const { return caster_; }

  /// Distance along a unit direction, infinity in the sky, and the reflectance there, 0..1.
  struct Return {
    double distance_m = 0;
    float reflectance = 0;
  };
  Return range(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction) const;

  /// Mean linear RGB of rays of the angle footprint_rad. Where all of them hit one surface, the
  /// first and the last one say whether the sun reaches it.
  Eigen::Vector3f radiance(const Eigen::Vector3d& origin,
                           std::span<const Eigen::Vector3d> directions, double footprint_rad) const;

 private:
  /// The nearest surface, fields included; for a field `primitive` is -1 and the distance finite.
  Hit nearest(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction) const;

  Road road_;
  Caster caster_;
};

/// The rays of a camera's pixels: four samples of each.
class CameraRays {
 public:
  static constexpr int kSamples = 4;
  explicit CameraRays(const Camera& camera);

  int width() const { return width_; }
  int height() const { return height_; }
  /// Unit directions in camera axes, [height * width * kSamples], and the directions of the pixels'
  /// centres [height * width]; zero outside the valid region of the lens.
  const std::vector<Eigen::Vector3f>& samples() const { return samples_; }
  const std::vector<Eigen::Vector3d>& centres() const { return centres_; }
  /// Angle between neighbouring samples in the middle of the image.
  double footprint_rad() const { return footprint_rad_; }

 private:
  int width_, height_;
  double footprint_rad_;
  std::vector<Eigen::Vector3f> samples_;
  std::vector<Eigen::Vector3d> centres_;
};

/// Draws what a camera sees, in sRGB; radiance is multiplied by `gain` first. Black outside the
/// valid region of the lens.
Image8 draw(const World& world, const CameraRays& rays, const Rigid3d& world_from_camera,
            double gain);

/// Millimetres along the ray of each pixel's centre; 0 for the sky and outside the valid region,
/// 65535 from there on.
Image16 draw_depth(const World& world, const CameraRays& rays, const Rigid3d& world_from_camera);

}  // namespace redrive::drive

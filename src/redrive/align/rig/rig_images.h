// SPDX-License-Identifier: Apache-2.0
// The images of a recording as features are looked for in them: brightness alone, held-out frames
// too, and what is left out.
#pragma once

#include <filesystem>
#include <optional>
#include <vector>

#include <opencv2/core.hpp>

#include "redrive/base/parallel.h"
#include "redrive/scene/moving_objects.h"
#include "redrive/scene/scene.h"

namespace redrive {

struct RigImages {
  Scene scene;  ///< all cameras and frames at full size: its indices are the recording's
  /// Of each camera: the images here are averaged by this factor, and all pixels are of the small
  /// image.
  std::vector<int> factor;
  std::vector<Camera> model;  ///< of the small images
  /// [camera][frame]; empty where there is no image. [height, width] 8 bits, the square root of
  /// brightness: noise as strong in the dark as in the light.
  std::vector<std::vector<cv::Mat>> grey;
  std::vector<std::vector<cv::Mat>>
      usable;  ///< likewise: 255 where a point may lie, 0 near what is left out
  std::vector<std::vector<Rigid3d>>
      world_from_camera;  ///< likewise, as recorded, at the image's own time
  MovingObjects moving;

  int cameras() const { return static_cast<int>(grey.size()); }
  int frames() const { return static_cast<int>(scene.frames.size()); }
  const Camera& camera(int c) const { return model[c]; }
  /// A pixel of the image here in the image as recorded, and back.
  Eigen::Vector2d recorded_pixel(int camera, const Eigen::Vector2d& pixel) const {
    return factor[camera] * (pixel.array() + 0.5) - 0.5;  // the inverse of Camera::downscaled
  }
  Eigen::Vector2d from_recorded(int camera, const Eigen::Vector2d& pixel) const {
    return (pixel.array() + 0.5) / factor[camera] - 0.5;
  }
  /// Where objects that move are when the image was taken.
  std::vector<MovingBox> moving_at(int camera, int frame) const;
  /// Whether a static point may be seen at `pixel`: inside, not masked, no moving object before it.
  bool may_be_static(int camera, int frame, const Eigen::Vector2d& pixel,
                     const std::vector<MovingBox>& moving) const;
};

/// At full size. `mask_folder`: as of static_masks; empty: all masks are found. `margin_px`: how
/// far a point stays from what is left out. InputError as load_view, read_mask, read_boxes.
RigImages load_rig_images(const Recording& recording, const std::filesystem::path& mask_folder,
                          int margin_px, ThreadPool& pool);

/// The same with images wider than `widest` averaged by whole factors: less noise, and more
/// surroundings in a patch.
RigImages downscaled_to_width(const RigImages& full, int widest, int margin_px, ThreadPool& pool);

}  // namespace redrive

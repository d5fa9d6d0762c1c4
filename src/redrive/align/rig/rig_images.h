// SPDX-License-Identifier: Apache-2.0
// The images of a recording for feature tracking: brightness, held-out frames included, and masks.
#pragma once

#include <filesystem>
#include <optional>
#include <vector>

#include <opencv2/core.hpp>

#include "redrive/base/opencv_threads.h"
#include "redrive/base/parallel.h"
#include "redrive/scene/moving_objects.h"
#include "redrive/scene/scene.h"

namespace redrive {

struct RigImages {
  Scene scene;  ///< all cameras and frames at full size: its indices are the recording's
  /// One per camera: the factor by which its images are downscaled. All pixels are pixels of the
  /// downscaled image.
  std::vector<int> factor;
  std::vector<Camera> model;  ///< models of the downscaled images
  /// [camera][frame]; empty where there is no image. [height, width] 8 bits, the square root of
  /// brightness, so that noise is as strong in dark as in bright regions.
  std::vector<std::vector<cv::Mat>> grey;
  std::vector<std::vector<cv::Mat>>
      usable;  ///< likewise: 255 where features may lie, 0 near masked pixels
  std::vector<std::vector<Rigid3d>>
      world_from_camera;  ///< likewise, initial, at the image's own time
  MovingObjects moving;
  std::vector<Finding> damaged;  ///< about images that cannot be decoded, empty here

  int cameras() const { return static_cast<int>(grey.size()); }
  int frames() const { return static_cast<int>(scene.frames.size()); }
  const Camera& camera(int c) const { return model[c]; }
  /// Converts a pixel to the recorded image, and back.
  Eigen::Vector2d recorded_pixel(int camera, const Eigen::Vector2d& pixel) const {
    return factor[camera] * (pixel.array() + 0.5) - 0.5;  // the inverse of Camera::downscaled
  }
  Eigen::Vector2d from_recorded(int camera, const Eigen::Vector2d& pixel) const {
    return (pixel.array() + 0.5) / factor[camera] - 0.5;
  }
  /// The moving objects at the time of the image.
  std::vector<MovingBox> moving_at(int camera, int frame) const;
  /// Whether `pixel` may show a static point: inside, not masked, no moving object in front.
  bool may_be_static(int camera, int frame, const Eigen::Vector2d& pixel,
                     const std::vector<MovingBox>& moving) const;
};

/// Images at full size. `mask_folder`: as in static_masks; empty: all masks are computed.
/// `margin_px`: distance of features from masked pixels. InputError as load_view, read_mask,
/// read_boxes.
RigImages load_rig_images(const Recording& recording, const std::filesystem::path& mask_folder,
                          int margin_px, ThreadPool& pool);

/// Returns `full` with images wider than `max_width` downscaled by whole factors: less noise, and
/// more context in a patch.
RigImages downscaled_to_width(const RigImages& full, int max_width, int margin_px,
                              ThreadPool& pool);

}  // namespace redrive

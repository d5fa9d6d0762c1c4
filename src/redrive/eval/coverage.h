// SPDX-License-Identifier: Apache-2.0
// Coverage of a novel view: the pixels whose surface some training image saw. Elsewhere the field
// is extrapolated. Also finds the training images that saw a point.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <vector>

#include "redrive/render/renderer.h"
#include "redrive/train/run.h"
#include "redrive/train/training_data.h"

namespace redrive {

/// The depth of a training view, rendered small from the run's own field. It finds occlusions
/// without ground truth, so on every recording; where the field's geometry is wrong, so are the
/// occlusions.
struct TrainingDepth {
  Camera camera;  ///< camera of the small image
  Rigid3d camera_from_world;
  std::map<std::int64_t, Rigid3d> camera_from_actor;  ///< key: MovingObject::id of each one it has
  std::vector<float> range_m;  ///< [height, width]; 0 outside the camera model's valid region
                               ///< and where the run masks the image (train/training_data.h)

  /// Whether a point lies in the image, is not masked there and is not occluded.
  bool sees(const Eigen::Vector3d& point_in_camera) const;
};

/// Finds what the training images saw.
class Coverage {
 public:
  /// Renders the depth of at most kMaxViews training views, for a drive in blocks as many for
  /// each block, evenly spaced over each camera; one in each step() where not `at_once`: run and
  /// backend must outlive these. Throws InputError as read_exclusions.
  Coverage(const Run& run, kernels::Backend& backend, bool at_once = true);

  /// Renders the next view. Returns whether there are more.
  bool step();

  /// Returns [height, width]: 1 where some training image saw the surface in `rendered`, else 0. A
  /// ray that hits no surface (opacity below 1/2) ends at the far limit. A surface within a moving
  /// object's box is sought where the object was in each training image.
  std::vector<std::uint8_t> seen(const Camera& camera, const ShutterPoses& world_from_camera,
                                 const RenderedImage& rendered) const;

  /// Returns the share of the valid pixels that seen() marks, 0 to 1, from every eighth row and
  /// column.
  double seen_share(const Camera& camera, const ShutterPoses& world_from_camera,
                    const RenderedImage& rendered) const;

  static constexpr int kMaxViews = 64;

 private:
  bool sees(const Eigen::Vector3d& point_in_camera, const ShutterPoses& world_from_camera,
            const Rigid3d& middle) const;
  void for_each_pixel(int stride, const Camera& camera, const ShutterPoses& world_from_camera,
                      const RenderedImage& rendered,
                      const std::function<void(std::size_t, bool)>& see) const;

  const Run& run_;
  kernels::Backend& backend_;
  std::optional<Exclusions> exclusions_;  ///< kept until all views are rendered
  std::vector<const View*> to_render_;    ///< the next one last
  std::vector<TrainingDepth> views_;
  /// half sides of moving objects, with a margin
  std::map<std::int64_t, Eigen::Vector3d> half_size_m_;
  double far_m_ = 0;
};

/// A search for the training images that saw a point.
struct PointSearch {
  Eigen::Vector3d point_in_world;
  std::vector<const View*> candidates;  ///< with the point in the image, the nearest one first
  std::size_t tested = 0;               ///< candidates tested
  std::vector<const View*> seen_by;     ///< tested candidates that saw it
};

/// Searches all training views one by one and keeps their depths for the next search.
class PointObservers {
 public:
  /// Run and backend must outlive it. Throws InputError as read_exclusions.
  PointObservers(const Run& run, kernels::Backend& backend);

  PointSearch begin(const Eigen::Vector3d& point_in_world) const;
  /// Tests the next candidate. Returns whether there are more.
  bool step(PointSearch* search);

  std::size_t training_views() const;

 private:
  const Run& run_;
  kernels::Backend& backend_;
  Exclusions exclusions_;
  std::vector<RayTable> tables_;  ///< tables of the small images, one per camera
  std::map<const View*, TrainingDepth> depths_;
};

}  // namespace redrive

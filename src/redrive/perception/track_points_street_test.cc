// SPDX-License-Identifier: Apache-2.0
// Points of the shipped street, and of photographs, skipped where they are missing.
#include <gtest/gtest.h>

#include "redrive/edit/view_requests.h"
#include "redrive/perception/masks.h"
#include "redrive/perception/track_points.h"
#include "redrive/scene/load_views.h"

namespace redrive {
namespace {

/// A camera beside the drive, with the ground-truth depth of its pixels.
struct DepthView {
  Camera camera;
  Rigid3d camera_from_world;
  std::vector<float> depth_m;

  /// Returns the depth along the ray to `pixel`; nothing at depth edges and outside.
  std::optional<double> depth_at(const Eigen::Vector2d& pixel) const {
    const double x = std::floor(pixel.x()), y = std::floor(pixel.y());
    if (!(x >= 0 && y >= 0 && x + 1 < camera.width && y + 1 < camera.height)) return std::nullopt;
    double inverse = 0;
    float nearest = std::numeric_limits<float>::infinity(), furthest = 0;
    for (int corner = 0; corner < 4; ++corner) {
      const double u = x + corner % 2, v = y + corner / 2;
      const float depth = depth_m[static_cast<std::size_t>(v * camera.width + u)];
      nearest = std::min(nearest, depth);
      furthest = std::max(furthest, depth);
      inverse += (1 - std::abs(pixel.x() - u)) * (1 - std::abs(pixel.y() - v)) / depth;
    }
    if (!(nearest > 0) || furthest > 1.1f * nearest) return std::nullopt;
    return 1 / inverse;
  }
};

std::vector<DepthView> depth_views(const Recording& recording, const Scene& scene,
                                   const std::string& name) {
  std::vector<DepthView> views;
  for (const NovelSet& set : recording.novel) {
    if (set.name != name) continue;
    const ViewRequests requests = read_view_requests(set.poses_file);
    for (const RequestedView& requested : requests.views)
      for (const CameraCalibration& calibration : requests.cameras) {
        if (calibration.name != requested.camera || !requested.global_from_body) continue;
        const Camera camera = make_camera(calibration);
        const RigCamera rig{calibration.name, camera, camera, calibration.body_from_sensor};
        const std::string stem = std::filesystem::path(requested.file).stem().string();
        views.push_back({camera,
                         (scene.global_from_world.inverse() * *requested.global_from_body *
                          calibration.body_from_sensor)
                             .inverse(Eigen::Isometry),
                         load_depth(set.poses_file.parent_path() / (stem + "_depth.png"), rig)});
      }
  }
  return views;
}

TEST(TrackPointsStreet, AgreeWithTheGroundTruthDepth) {
  ThreadPool pool(2);
  const Recording recording = open_recording(REDRIVE_SAMPLES "/street", PoseSource::kGroundTruth);
  SceneOptions options;
  options.holdout_every = 8;
  const Scene scene = make_scene(recording, options);
  std::vector<Image8> images = load_views(scene, pool);
  apply_masks(scene, static_masks(scene, images, {}, pool, true),
              read_moving_objects(recording, scene), pool, &images);
  const PointCloud cloud = track_points(scene, images, pool);
  EXPECT_GT(cloud.n, 200'000u);
  const std::vector<DepthView> views = depth_views(recording, scene, "left_0.5");
  ASSERT_EQ(views.size(), 6u);
  std::vector<double> errors;
  for (std::size_t i = 0; i < cloud.n; ++i)
    for (const DepthView& view : views) {
      const Eigen::Vector3d in_camera =
          view.camera_from_world * Eigen::Vector3d(cloud.position[i], cloud.position[cloud.n + i],
                                                   cloud.position[2 * cloud.n + i]);
      const auto pixel = view.camera.project(in_camera);
      const auto depth = pixel ? view.depth_at(*pixel) : std::nullopt;
      if (depth) errors.push_back(std::abs(in_camera.norm() - *depth) / *depth);
    }
  ASSERT_GT(errors.size(), cloud.n);
  std::ranges::sort(errors);
  std::printf("%zu points, errors of the distance: median %.2f %%, three quarters below %.2f %%\n",
              cloud.n, 100 * errors[errors.size() / 2], 100 * errors[errors.size() * 3 / 4]);
  // Occluded points, which count as wrong, are among the last quarter.
  EXPECT_LT(errors[errors.size() / 2], 0.025);
  EXPECT_LT(errors[errors.size() * 3 / 4], 0.07);
}

TEST(TrackPointsFox, SurroundTheFox) {
  const std::filesystem::path root = REDRIVE_SHARED "/data/fox";
  if (!std::filesystem::exists(root)) GTEST_SKIP() << root << " is not here";
  ThreadPool pool(2);
  SceneOptions options;
  options.holdout_every = 8;
  const Scene scene = make_scene(open_recording(root), options);
  const PointCloud cloud = track_points(scene, load_views(scene, pool), pool);
  EXPECT_GT(cloud.n, 40'000u);
  std::size_t inside = 0;
  for (std::size_t i = 0; i < cloud.n; ++i)
    inside += std::abs(cloud.position[i]) < *scene.half_side &&
              std::abs(cloud.position[cloud.n + i]) < *scene.half_side &&
              std::abs(cloud.position[2 * cloud.n + i]) < *scene.half_side;
  EXPECT_GT(inside, 0.9 * static_cast<double>(cloud.n));
}

}  // namespace
}  // namespace redrive

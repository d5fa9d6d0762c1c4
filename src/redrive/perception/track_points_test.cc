// SPDX-License-Identifier: Apache-2.0
#include "redrive/perception/track_points.h"

#include <gtest/gtest.h>

#include "redrive/scene/textured_drive_testing.h"

namespace redrive {
namespace {

using Eigen::Vector3d;

constexpr int kFrames = 8;

/// A drive down the textured street, drawn with the poses of the scene.
struct Drive {
  explicit Drive(int holdout_every = 0, std::int64_t readout_ns = 0) {
    const TemporaryFolder folder;
    Recording recording = make_test_drive(folder.path, kFrames, /*textured=*/false);
    for (RecordedCamera& camera : recording.cameras) camera.calibration.readout_ns = readout_ns;
    SceneOptions options;
    options.holdout_every = holdout_every;
    scene = make_scene(recording, options);
    images.resize(scene.views.size());
    pool.run(static_cast<int>(images.size()), [&](int i) {
      const View& view = scene.views[i];
      if (!view.held_out)
        images[i] = draw_street(scene.rig[view.camera].camera, scene.shutter_poses(view));
    });
  }
  PointCloud points() { return track_points(scene, images, pool); }

  ThreadPool pool{4};
  Scene scene;
  std::vector<Image8> images;
};

Vector3d position(const PointCloud& cloud, std::size_t i) {
  return {cloud.position[i], cloud.position[cloud.n + i], cloud.position[2 * cloud.n + i]};
}

/// Distances from the street's surfaces, relative to the distance from the cameras, ascending.
std::vector<double> relative_errors(const PointCloud& cloud) {
  std::vector<double> errors;
  for (std::size_t i = 0; i < cloud.n; ++i) {
    const Vector3d p = position(cloud, i);
    const double error =
        std::min({std::abs(p.z()), std::abs(p.y() - 6), std::abs(p.y() + 5), std::abs(p.x() - 40)});
    errors.push_back(error / (p - Vector3d(0.4 * kFrames / 2, 0, 1.3)).norm());
  }
  std::ranges::sort(errors);
  return errors;
}

TEST(TrackPoints, LieOnTheSurfaces) {
  // With readouts of 50 ms a row's camera is up to 0.1 m from the image's middle one.
  for (const std::int64_t readout_ns : {0, 50'000'000}) {
    Drive drive(0, readout_ns);
    const PointCloud cloud = drive.points();
    ASSERT_GT(cloud.n, 4500u);
    ASSERT_EQ(cloud.position.size(), 3 * cloud.n);
    ASSERT_EQ(cloud.rgb.size(), 3 * cloud.n);
    const std::vector<double> errors = relative_errors(cloud);
    std::printf("%zu points, errors: median %.2f %%, nine tenths below %.2f %%\n", cloud.n,
                100 * errors[cloud.n / 2], 100 * errors[cloud.n * 9 / 10]);
    EXPECT_LT(errors[cloud.n / 2], 0.01) << readout_ns;
    EXPECT_LT(errors[cloud.n * 9 / 10], 0.03) << readout_ns;
    std::vector<double> colour_errors;
    for (std::size_t i = 0; i < cloud.n; ++i)
      colour_errors.push_back(std::abs(cloud.rgb[i] - street_texture(position(cloud, i))));
    std::ranges::sort(colour_errors);
    EXPECT_LT(colour_errors[cloud.n / 2], 0.05);
  }
}

TEST(TrackPoints, MaskedAndTransparentPixelsGiveNone) {
  for (const bool transparent : {false, true}) {
    Drive drive;
    const int front = drive.scene.camera_index("FRONT");
    for (std::size_t i = 0; i < drive.images.size(); ++i) {
      Image8& image = drive.images[i];
      auto& values = transparent ? image.alpha : image.used;
      values.assign(image.rgb.size() / 3, 255);
      // FRONT is level: below its middle row is what lies lower than itself.
      const std::size_t first = drive.scene.views[i].camera == front ? values.size() / 2 : 0;
      std::fill(values.begin() + static_cast<std::ptrdiff_t>(first), values.end(), 0);
    }
    const PointCloud cloud = drive.points();
    EXPECT_GT(cloud.n, 500u);
    for (std::size_t i = 0; i < cloud.n; ++i) EXPECT_GT(position(cloud, i).z(), 1.2);
  }
}

TEST(TrackPoints, HeldOutImagesAreNotUsed) {
  Drive drive(/*holdout_every=*/4);
  const PointCloud cloud = drive.points();
  EXPECT_GT(cloud.n, 500u);
  for (std::size_t i = 0; i < drive.images.size(); ++i)
    if (drive.scene.views[i].held_out) drive.images[i] = drive.images[i + 1];
  EXPECT_EQ(drive.points().position, cloud.position);
}

TEST(TrackPoints, ThreadsDoNotChangeBits) {
  Drive drive;
  ThreadPool one(1);
  const PointCloud cloud = drive.points(), alone = track_points(drive.scene, drive.images, one);
  EXPECT_EQ(cloud.position, alone.position);
  EXPECT_EQ(cloud.rgb, alone.rgb);
}

TEST(TrackPoints, PhotographsMayHaveAnyUnit) {
  constexpr double kScale = 1.0 / 1024;  // exact
  Drive drive;
  drive.scene.metric = false;
  const PointCloud cloud = drive.points();
  EXPECT_GT(cloud.n, 4500u);
  for (RigCamera& camera : drive.scene.rig) camera.body_from_sensor.translation() *= kScale;
  for (FramePose& frame : drive.scene.trajectory) {
    frame.global_from_body = drive.scene.global_from_world.inverse() * frame.global_from_body;
    frame.global_from_body.translation() *= kScale;
  }
  drive.scene.global_from_world = Rigid3d::Identity();
  const PointCloud small = drive.points();
  ASSERT_EQ(small.n, cloud.n);
  for (std::size_t i = 0; i < cloud.position.size(); ++i)
    ASSERT_FLOAT_EQ(small.position[i], cloud.position[i] * static_cast<float>(kScale)) << i;
}

TEST(TrackPoints, TooFewImagesGiveNone) {
  Drive drive;
  drive.scene.views.resize(3);
  drive.images.resize(3);
  EXPECT_EQ(drive.points().n, 0u);
}

}  // namespace
}  // namespace redrive

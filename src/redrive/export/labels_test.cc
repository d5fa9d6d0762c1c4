// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/labels.h"

#include <cstring>

#include <gtest/gtest.h>

#include "redrive/export/drive_path.h"
#include "redrive/export/simulate.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/scene/scene_testing.h"

namespace redrive {
namespace {

constexpr int kWidth = 40, kHeight = 30;
constexpr double kFocal = 50;

Camera pinhole() {
  return make_camera(
      {"CAM", "opencv_pinhole", {kFocal, kFocal, 19.5, 14.5, 0, 0, 0, 0, 0}, kWidth, kHeight});
}

/// Poses of a camera at the world's origin, x right, y down, z forward, that sees one object whose
/// box is centred at `centre`.
ShutterPoses poses_with_object(const Eigen::Vector3d& camera, const Eigen::Vector3d& centre) {
  const Rigid3d world_from_camera(Eigen::Translation3d{camera}),
      world_from_box(Eigen::Translation3d{centre});
  ShutterPoses poses(world_from_camera);
  poses.set_actors({{.body = 7,
                     .actor_from_camera = {plain(world_from_box.inverse() * world_from_camera)},
                     .number = 1}});
  return poses;
}

TEST(LabelsTest, RunsGoDownTheColumns) {
  // 0 0 1
  // 0 1 1
  const std::vector<std::uint16_t> ids{0, 0, 1, 0, 1, 1};
  const PixelBox all{0, 0, 3, 2};
  EXPECT_EQ(run_lengths(ids, 3, 2, 1, all), (std::vector<std::uint32_t>{3, 3}));
  EXPECT_EQ(run_lengths(ids, 3, 2, 0, all), (std::vector<std::uint32_t>{0, 3, 3}));
  EXPECT_EQ(run_lengths(ids, 3, 2, 2, all), (std::vector<std::uint32_t>{6}));
  EXPECT_EQ(run_lengths(ids, 3, 2, 1, {1, 0, 3, 2}), (std::vector<std::uint32_t>{3, 3}));
  EXPECT_EQ(run_lengths(ids, 3, 2, 0, {0, 0, 2, 2}), (std::vector<std::uint32_t>{0, 3, 3}));
}

TEST(LabelsTest, OverlapIsIntersectionOverUnion) {
  EXPECT_DOUBLE_EQ(overlap({0, 0, 4, 2}, {2, 0, 6, 2}), 4.0 / 12);
  EXPECT_DOUBLE_EQ(overlap({0, 0, 1, 1}, {2, 0, 3, 1}), 0);
}

/// The object's box spans 2 m, 10 m ahead on its near side: 10 pixels to both sides of the centre.
TEST(LabelsTest, AnObjectHalfOutsideIsTruncated) {
  const ShutterPoses poses = poses_with_object({0, 0, 0}, {-4, 0, 11});
  Scene scene;
  scene.actors.resize(1);
  scene.actors[0].id = 7;
  scene.actors[0].type = "CAR";
  scene.actors[0].size_m = {2, 2, 2};
  // x from -5 to -3 m at z = 10: columns -5 to 5.
  RenderedImage image;
  image.labelled = true;
  image.clear(kWidth, kHeight);
  for (int y = 10; y < 20; ++y)
    for (int x = 0; x < 3; ++x) image.ids[y * kWidth + x] = 1;
  image.seen.push_back({1, 30, 50, 0, 10, 4, 19});
  const nlohmann::json labels = annotations_of(image, pinhole(), poses, scene);
  ASSERT_EQ(labels.size(), 1u);
  const nlohmann::json& label = labels[0];
  EXPECT_EQ(label.at("track_id"), 7);
  EXPECT_EQ(label.at("bbox"), (nlohmann::json{0.0, 10.0, 3.0, 10.0}));
  const auto whole = label.at("whole_bbox").get<std::vector<double>>();
  EXPECT_NEAR(whole[0], -5, 1e-9);
  EXPECT_NEAR(whole[0] + whole[2], 5, 1e-9);
  EXPECT_NEAR(label.at("truncation").get<double>(), 0.5, 1e-9);
  EXPECT_DOUBLE_EQ(label.at("occlusion"), 0.4);
  EXPECT_EQ(label.at("area"), 30);
  const nlohmann::json document = coco_document(
      {{{"file_name", "a.png"}, {"width", kWidth}, {"height", kHeight}, {"annotations", labels}}});
  EXPECT_EQ(document.at("annotations")[0].at("image_id"), document.at("images")[0].at("id"));
  EXPECT_EQ(document.at("annotations")[0].at("category_id"), document.at("categories")[0].at("id"));
  EXPECT_EQ(document.at("categories")[0].at("name"), "CAR");
}

/// What a camera sees of an opaque wall 10 m ahead.
RenderedImage image_of_wall(const RayTable& rays) {
  RenderedImage image;
  image.labelled = true;
  image.clear(kWidth, kHeight);
  for (std::size_t i = 0; i < rays.pixel.size(); ++i) {
    image.opacity[rays.pixel[i]] = 1;
    image.depth[rays.pixel[i]] = 10 / rays.direction[3 * i + 2];
  }
  return image;
}

/// The camera moves 0.2 m to the right past a wall 10 m ahead, which moves by -50 0.2 / 10 = -1
/// pixel; an object 5 m ahead moves with the camera.
TEST(LabelsTest, FlowIsParallaxAndMotion) {
  const auto backend = kernels::make_backend({.threads = 2});
  const RayTable rays = make_ray_table(pinhole(), backend->pool());
  RenderedImage image = image_of_wall(rays);
  for (const std::uint32_t pixel : rays.pixel) {
    if (pixel % kWidth == 39) image.opacity[pixel] = 0;
    if (pixel % kWidth >= 10) continue;
    image.ids[pixel] = 1;
    image.depth[pixel] /= 2;
  }
  const ShutterPoses now = poses_with_object({0, 0, 0}, {-1, 0, 5}),
                     later = poses_with_object({0.2, 0, 0}, {-0.8, 0, 5});
  const std::vector<float> flow = optical_flow(image, rays, now, later, *backend);
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) {
      const double expected = x < 10 || x == 39 ? 0 : -1;
      ASSERT_NEAR(flow[2 * (y * kWidth + x)], expected, 1e-3) << x << " " << y;
      ASSERT_NEAR(flow[2 * (y * kWidth + x) + 1], 0, 1e-3);
    }
  ShutterPoses gone = later;
  gone.set_actors({});
  EXPECT_EQ(optical_flow(image, rays, now, gone, *backend)[0], kUnknownFlow);
  const std::string file = make_flo(flow, kWidth, kHeight);
  ASSERT_EQ(file.size(), 12 + 8u * kWidth * kHeight);
  float tag = 0;
  std::memcpy(&tag, file.data(), 4);
  EXPECT_EQ(tag, 202021.25f);
}

/// A camera moves at 0.2 m an image across its lines, N of them, before a wall 10 m ahead. The next
/// line is exposed 0.2 / N m further on, so the motion d obeys d = -50 (0.2 + 0.2 d / N) / 10.
TEST(LabelsTest, FlowOfARollingShutter) {
  const auto backend = kernels::make_backend({.threads = 2});
  const RayTable rays = make_ray_table(pinhole(), backend->pool());
  const RenderedImage image = image_of_wall(rays);
  for (const bool by_column : {false, true}) {
    const auto moving = [&](double first_m) {
      std::vector<Rigid3d> keys;
      for (int key = 0; key < 3; ++key) {
        const double m = first_m + 0.1 * key;
        keys.emplace_back(Eigen::Translation3d(by_column ? m : 0, by_column ? 0 : m, 0));
      }
      return ShutterPoses(keys, by_column);
    };
    const std::vector<float> flow = optical_flow(image, rays, moving(0), moving(0.2), *backend);
    const double across = -1 / (1 + 1.0 / (by_column ? kWidth : kHeight));
    for (int y = 2; y < kHeight; ++y)
      for (int x = 2; x < kWidth; ++x) {
        ASSERT_NEAR(flow[2 * (y * kWidth + x)], by_column ? across : 0, 1e-3) << x << " " << y;
        ASSERT_NEAR(flow[2 * (y * kWidth + x) + 1], by_column ? 0 : across, 1e-3) << x << " " << y;
      }
  }
}

TEST(SimulateTest, ARigReplacesTheCameras) {
  const TemporaryFolder folder;
  const Recording recording = make_test_recording(folder.path, 5);
  CameraCalibration left{"LEFT", "opencv_pinhole", {50, 50, 19.5, 14.5, 0, 0, 0, 0, 0}, 40, 30};
  left.body_from_sensor = Rigid3d(Eigen::Translation3d(1, 0.5, 1.4));
  left.time_offset_ns = 5'000'000;
  CameraCalibration roof = left;
  roof.name = "ROOF";
  const Scene scene = scene_with_rig(make_scene(recording, {}), {left, roof});
  ASSERT_EQ(scene.rig.size(), 2u);
  ASSERT_EQ(scene.views.size(), 10u);
  EXPECT_EQ(scene.views[7].camera, 1);
  EXPECT_EQ(scene.views[7].frame, 2);
  EXPECT_EQ(scene.exposed_ns(scene.views[7]), scene.frames[2].t_ns + 5'000'000);
  const Rigid3d expected =
      scene.world_from_body(scene.exposed_ns(scene.views[7])) * roof.body_from_sensor;
  EXPECT_LT((scene.world_from_camera(scene.views[7]).matrix() - expected.matrix()).norm(), 1e-9);
}

TEST(SimulateTest, PathsMoveTheBody) {
  const TemporaryFolder folder;
  const Recording recording = make_test_recording(folder.path, 5);
  const Scene scene = make_scene(recording, {}), left = scene_on_path(scene, "sideways:0.5"),
              fast = scene_on_path(scene, "speed:2");
  for (const Frame& frame : scene.frames)
    EXPECT_LT((scene.world_from_body(frame.t_ns).inverse() * left.world_from_body(frame.t_ns) *
                   Eigen::Vector3d::Zero() -
               Eigen::Vector3d(0, 0.5, 0))
                  .norm(),
              1e-6);
  ASSERT_EQ(fast.frames.size(), 3u);
  for (std::size_t f = 0; f < 3; ++f)
    EXPECT_LT((fast.world_from_body(scene.frames[f].t_ns).translation() -
               scene.world_from_body(scene.frames[2 * f].t_ns).translation())
                  .norm(),
              1e-6);
  for (const View& view : fast.views) EXPECT_LT(view.frame, 3);
}

}  // namespace
}  // namespace redrive

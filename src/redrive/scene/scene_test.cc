// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/scene.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/scene/scene_testing.h"

namespace redrive {
namespace {

using Eigen::Vector3d;

// A few roundings of ECEF coordinates of 4.7e6, whose ulp in double is 9e-10.
constexpr double kGlobalRounding_m = 1e-8;

class SceneTest : public ::testing::Test {
 protected:
  TemporaryFolder folder_;
  Recording recording_ = make_test_recording(folder_.path);

  /// Returns the message of the UsageError that `options` cause.
  std::string refusal(const SceneOptions& options) {
    try {
      make_scene(recording_, options);
    } catch (const UsageError& error) {
      return error.what();
    }
    ADD_FAILURE() << "not refused";
    return "";
  }
};

TEST_F(SceneTest, TakesEverythingByDefault) {
  const Scene scene = make_scene(recording_, {});
  ASSERT_EQ(scene.rig.size(), 2u);
  EXPECT_EQ(scene.frames.size(), 6u);
  ASSERT_EQ(scene.views.size(), 12u);
  for (int i = 0; i < 12; ++i) {
    EXPECT_EQ(scene.views[i].camera, i / 6);
    EXPECT_EQ(scene.views[i].frame, i % 6);
    EXPECT_FALSE(scene.views[i].held_out);
    EXPECT_EQ(scene.views[i].image, recording_.cameras[i / 6].images[i % 6].path);
  }
  EXPECT_EQ(scene.camera_index("FRONT"), 1);
  EXPECT_EQ(scene.camera_index("REAR"), -1);
  EXPECT_EQ(scene.frame_index(13), 3);
  EXPECT_EQ(scene.frame_index(9), -1);
  EXPECT_EQ(scene.frame_index(16), -1);
  EXPECT_EQ(scene.frames[2].t_ns, 1133333334);
}

// Frame n of the drive is reached by n steps of "1 m ahead, then 0.1 rad to the left" from frame 0,
// in its body axes.
TEST_F(SceneTest, TheWorldIsTheBodyOfTheFirstFrame) {
  const Scene scene = make_scene(recording_, {});
  Vector3d position(0, 0, 0);
  for (int n = 0; n < 6; ++n) {
    const Rigid3d pose = scene.world_from_body(scene.frames[n].t_ns);
    EXPECT_LT((pose.translation() - position).norm(), kGlobalRounding_m) << n;
    EXPECT_LT(
        (pose.linear() * Vector3d::UnitX() - Vector3d(std::cos(0.1 * n), std::sin(0.1 * n), 0))
            .norm(),
        1e-14)
        << n;
    EXPECT_LT((pose.linear() * Vector3d::UnitZ() - Vector3d::UnitZ()).norm(), 1e-14) << n;
    position += Vector3d(std::cos(0.1 * n), std::sin(0.1 * n), 0);
  }
  // Equation (2) of the front camera at frame 1, rotated by 0.1 rad at (1, 0, 0): centre (1, 0, 0)
  // + R (2, 0.1, 1.2), looking along R (1, 0, 0), its x axis to the right, R (0, -1, 0).
  const double c = std::cos(0.1), s = std::sin(0.1);
  const Rigid3d camera = scene.world_from_camera(scene.views[7]);
  EXPECT_LT((camera.translation() - Vector3d(1 + 2 * c - 0.1 * s, 2 * s + 0.1 * c, 1.2)).norm(),
            kGlobalRounding_m);
  EXPECT_LT((camera.linear() * Vector3d::UnitZ() - Vector3d(c, s, 0)).norm(), 1e-14);
  EXPECT_LT((camera.linear() * Vector3d::UnitX() - Vector3d(s, -c, 0)).norm(), 1e-14);
}

TEST_F(SceneTest, WorldDoesNotDependOnTheSelection) {
  const Scene all = make_scene(recording_, {});
  SceneOptions options;
  options.first_frame = 12;
  options.last_frame = 15;
  options.frame_step = 2;
  const Scene part = make_scene(recording_, options);
  ASSERT_EQ(part.frames.size(), 2u);
  EXPECT_EQ(part.frames[0].id, 12);
  EXPECT_EQ(part.frames[1].id, 14);
  EXPECT_EQ(part.posed_frames()[0].world_from_body.matrix(),
            all.posed_frames()[2].world_from_body.matrix());
  EXPECT_EQ(part.global_from_world.matrix(), recording_.frames[0].global_from_body.matrix());
}

// Half a frame late at 1 m and 0.1 rad a frame: half way along, and on beyond the last frame.
TEST_F(SceneTest, ViewsHaveThePoseAtTheirExposure) {
  const std::vector<PosedFrame> frames = make_scene(recording_, {}).posed_frames();
  const std::int64_t interval_ns = recording_.frames[1].t_ns - recording_.frames[0].t_ns;
  recording_.cameras[1].calibration.time_offset_ns = interval_ns / 2;
  const Scene scene = make_scene(recording_, {});
  for (int n = 0; n < 6; ++n) {
    EXPECT_EQ(scene.world_from_body(scene.views[n]).matrix(), frames[n].world_from_body.matrix())
        << "the other camera";
    const Rigid3d late = scene.world_from_body(scene.views[6 + n]);
    const Eigen::AngleAxisd turn(0.1 * (n + 0.5), Vector3d::UnitZ());
    EXPECT_LT((late.linear() - turn.toRotationMatrix()).norm(), 1e-7)
        << n;  // interval_ns / 2 is rounded
    const Vector3d step = frames[std::min(n + 1, 5)].world_from_body.translation() -
                          frames[std::min(n, 4)].world_from_body.translation();
    const Vector3d expected = frames[n].world_from_body.translation() + 0.5 * step;
    EXPECT_LT((late.translation() - expected).norm(), 1e-7) << n;
  }
}

TEST_F(SceneTest, KeepsTheOrderOfCamerasInTheOptions) {
  SceneOptions options;
  options.cameras = {"FRONT", "FISHEYE"};
  const Scene scene = make_scene(recording_, options);
  EXPECT_EQ(scene.rig[0].name, "FRONT");
  EXPECT_EQ(scene.rig[1].name, "FISHEYE");
  EXPECT_EQ(scene.views[0].image, recording_.cameras[1].images[0].path);
}

TEST_F(SceneTest, HoldsOutEveryNthFrameOfAllCameras) {
  SceneOptions options;
  options.first_frame = 11;
  options.holdout_every = 2;
  const Scene scene = make_scene(recording_, options);
  for (const View& view : scene.views)
    EXPECT_EQ(view.held_out, scene.frames[view.frame].id % 2 == 1);
}

TEST_F(SceneTest, TrainsOnEveryNthFrameAlone) {
  SceneOptions options;
  options.train_every = 3;
  const Scene scene = make_scene(recording_, options);
  for (const View& view : scene.views) EXPECT_EQ(view.held_out, view.frame % 3 != 0);
}

TEST_F(SceneTest, UsesTheRecordingsOwnSplit) {
  recording_.cameras[0].images[2].held_out = true;
  const Scene scene = make_scene(recording_, {});
  for (int i = 0; i < 12; ++i) EXPECT_EQ(scene.views[i].held_out, i == 2);
  SceneOptions options;
  options.holdout_every = 3;
  EXPECT_THAT(refusal(options), testing::HasSubstr("--holdout-every 3"));
  options = {};
  options.cameras = {"FISHEYE"};
  options.first_frame = options.last_frame = 12;
  EXPECT_THAT(refusal(options), testing::HasSubstr("leaves no image for training"));
}

TEST_F(SceneTest, ViewsCarryTheirMasks) {
  recording_.cameras[1].images[4].mask = {"mask.png", false};
  const Scene scene = make_scene(recording_, {});
  EXPECT_EQ(scene.views[10].mask.path, "mask.png");
  EXPECT_FALSE(scene.views[10].mask.black_is_masked);
  EXPECT_TRUE(scene.views[9].mask.path.empty());
}

// The world keeps the axes of the poses and has its origin in the middle of the cube.
TEST_F(SceneTest, ABoundedWorldIsCentredOnItsCube) {
  EXPECT_FALSE(make_scene(recording_, {}).half_side);
  recording_.bounds = BoundingCube{{4081000, 1405000, 4679000}, 2000};
  const Scene scene = make_scene(recording_, {});
  EXPECT_EQ(scene.half_side, 2000);
  const Rigid3d pose = scene.world_from_body(scene.frames[0].t_ns);
  EXPECT_EQ(pose.linear(), recording_.frames[0].global_from_body.linear());
  EXPECT_LT((pose.translation() - Vector3d(775.25, 467.5, 608.75)).norm(), kGlobalRounding_m);
}

TEST_F(SceneTest, SkipsMissingImages) {
  recording_.cameras[0].images.erase(recording_.cameras[0].images.begin() + 1);
  const Scene scene = make_scene(recording_, {});
  ASSERT_EQ(scene.views.size(), 11u);
  EXPECT_EQ(scene.views[1].frame, 2);
}

// Every second one of the frames that are shown, not of those that have a pose.
TEST_F(SceneTest, LeavesOutFramesThatNoChosenCameraShows) {
  std::erase_if(recording_.cameras[0].images,
                [](const ImageFile& image) { return image.frame_id % 2 == 0; });
  SceneOptions options;
  options.cameras = {recording_.cameras[0].calibration.name};
  options.shown_only = true;
  options.frame_step = 2;
  const Scene scene = make_scene(recording_, options);
  ASSERT_EQ(scene.frames.size(), 2u);
  EXPECT_EQ(scene.frames[0].id, 11);
  EXPECT_EQ(scene.frames[1].id, 15);
  EXPECT_EQ(scene.views.size(), 2u);
  EXPECT_EQ(scene.unseen_frames, 3u);
  options.cameras = {};
  options.frame_step = 1;
  EXPECT_EQ(make_scene(recording_, options).frames.size(), 6u);
  EXPECT_EQ(make_scene(recording_, {}).unseen_frames, 0u);
}

TEST_F(SceneTest, DownscalesTheCamera) {
  SceneOptions options;
  options.downscale = 3;
  const Scene scene = make_scene(recording_, options);
  EXPECT_EQ(scene.rig[1].camera.width, 8);
  EXPECT_EQ(scene.rig[1].camera.height, 5);
  EXPECT_EQ(scene.rig[1].recorded.width, 24);
  EXPECT_EQ(scene.downscale, 3);
}

TEST_F(SceneTest, UnitCubeContainsAllPointsWithinFar) {
  SceneOptions options;
  options.far_m = 7;
  const Scene scene = make_scene(recording_, options);
  const UnitFromWorld& unit = scene.unit_from_world;
  double furthest = 0;
  for (const View& view : scene.views) {
    const Vector3d center = scene.world_from_camera(view).translation();
    for (int d = 0; d < 3; ++d)
      for (const double side : {-7.0, 7.0}) {
        const float x = static_cast<float>(center[d] + side);
        const float u = (x - unit.center[d]) * unit.scale;
        ASSERT_LE(std::abs(u), 1);
        furthest = std::max<double>(furthest, std::abs(u));
      }
  }
  EXPECT_GT(furthest, 1 - 1e-5);  // the tightest such cube
}

TEST_F(SceneTest, RejectsUnknownCamerasAndFrames) {
  SceneOptions options;
  options.cameras = {"REAR"};
  EXPECT_THAT(refusal(options), testing::AllOf(testing::HasSubstr("--cameras REAR"),
                                               testing::HasSubstr("FISHEYE, FRONT")));
  options.cameras = {"FRONT", "FRONT"};
  EXPECT_THAT(refusal(options), testing::HasSubstr("twice"));

  options = {};
  options.first_frame = 16;
  EXPECT_THAT(refusal(options),
              testing::AllOf(testing::HasSubstr("--frames 16:"), testing::HasSubstr("10:15")));
  options.first_frame = 14;
  options.last_frame = 12;
  EXPECT_THAT(refusal(options), testing::HasSubstr("--frames 14:12"));

  options = {};
  options.last_frame = 10;
  options.cameras = {"FRONT"};
  recording_.cameras[1].images.erase(recording_.cameras[1].images.begin());
  EXPECT_THAT(refusal(options), testing::HasSubstr("--cameras FRONT"));
}

TEST_F(SceneTest, RejectsUndistortingAFisheye) {
  SceneOptions options;
  options.undistort = true;
  EXPECT_THAT(refusal(options), testing::HasSubstr("--undistort FISHEYE"));
  options.cameras = {"FRONT"};
  const Scene scene = make_scene(recording_, options);
  EXPECT_EQ(scene.rig[0].camera.fx, 22);
  EXPECT_EQ(std::get<OpenCvPinhole>(scene.rig[0].camera.model).distortion.k1, 0);
  EXPECT_EQ(std::get<OpenCvPinhole>(scene.rig[0].recorded.model).distortion.k1, -0.3);
}

TEST_F(SceneTest, RejectsHoldingOutEverything) {
  SceneOptions options;
  options.first_frame = options.last_frame = 12;
  options.holdout_every = 5;
  EXPECT_THAT(refusal(options), testing::HasSubstr("--holdout-every 5"));
}

TEST_F(SceneTest, RejectsOptionsOutOfRange) {
  const auto with = [&](auto change) {
    SceneOptions options;
    change(options);
    return refusal(options);
  };
  using testing::HasSubstr;
  EXPECT_THAT(with([](SceneOptions& o) { o.frame_step = 0; }), HasSubstr("--frames"));
  EXPECT_THAT(with([](SceneOptions& o) { o.downscale = 0; }), HasSubstr("--downscale 0"));
  EXPECT_THAT(with([](SceneOptions& o) { o.downscale = 65; }), HasSubstr("--downscale 65"));
  EXPECT_THAT(with([](SceneOptions& o) { o.downscale = 15; }), HasSubstr("FISHEYE"));  // 14 rows
  EXPECT_THAT(with([](SceneOptions& o) { o.holdout_every = 1; }), HasSubstr("--holdout-every 1"));
  EXPECT_THAT(with([](SceneOptions& o) { o.train_every = 1; }), HasSubstr("--train-every 1"));
  EXPECT_THAT(with([](SceneOptions& o) { o.train_every = o.holdout_every = 2; }),
              HasSubstr("--train-every 2"));
  EXPECT_THAT(with([](SceneOptions& o) { o.near_m = 0; }), HasSubstr("--near"));
  EXPECT_THAT(with([](SceneOptions& o) { o.near_m = NAN; }), HasSubstr("--near"));
  EXPECT_THAT(with([](SceneOptions& o) { o.far_m = 1; }), HasSubstr("--far"));
  EXPECT_THAT(with([](SceneOptions& o) { o.far_m = INFINITY; }), HasSubstr("--far"));
}

TEST_F(SceneTest, RejectsEmptyRecordings) {
  Recording empty = recording_;
  empty.frames.clear();
  EXPECT_THROW(make_scene(empty, {}), InputError);
  empty = recording_;
  empty.cameras.clear();
  EXPECT_THROW(make_scene(empty, {}), InputError);
}

}  // namespace
}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/pose_corrections.h"

#include <gtest/gtest.h>

#include "redrive/base/rng.h"
#include "redrive/scene/pose_gradients.h"
#include "redrive/scene/scene_testing.h"

namespace redrive {
namespace {

using Eigen::Vector3d;

class PoseCorrectionsTest : public ::testing::Test {
 protected:
  PoseCorrectionsTest() { recording_.cameras[0].calibration.time_offset_ns = 20'000'000; }

  Scene scene_of(int holdout_every = 0) const {
    SceneOptions options;
    options.holdout_every = holdout_every;
    return make_scene(recording_, options);
  }
  static double uniform(std::uint64_t i) {
    return 2.0 * random_unit(random_key(17, kStreamTest, 3), i) - 1;
  }

  TemporaryFolder folder_;
  Recording recording_ = make_test_recording(folder_.path);
};

void expect_same(const Rigid3d& a, const Rigid3d& b, double tolerance) {
  EXPECT_LT((a.matrix() - b.matrix()).cwiseAbs().maxCoeff(), tolerance);
}

TEST_F(PoseCorrectionsTest, ZeroCorrectionsChangeNothing) {
  const Scene scene = scene_of();
  Scene placed = scene;
  placed.correct(PoseCorrections(scene));
  for (std::size_t v = 0; v < scene.views.size(); ++v)
    expect_same(placed.world_from_camera(placed.views[v]), scene.world_from_camera(scene.views[v]),
                1e-8);
}

TEST_F(PoseCorrectionsTest, CorrectFramesExtrinsicsAndTimeOffsetsInTheirOwnAxes) {
  recording_.cameras[0].calibration.time_offset_ns = 0;
  const Scene scene = scene_of();
  PoseCorrections corrections(scene);
  const float frame[6] = {0.3f, -0.1f, 0.05f, 0, 0, 0.02f},
              camera[6] = {0.01f, 0, -0.02f, 0.001f, -0.002f, 0.003f};
  std::copy_n(frame, 6, &corrections.values[corrections.frame_slot(2)]);
  std::copy_n(camera, 6, &corrections.values[corrections.camera_slot(1)]);
  corrections.values[corrections.time_slot(0)] = 1 / 30.0f;  // half a frame
  Scene placed = scene;
  placed.correct(corrections);
  EXPECT_EQ(placed.rig[0].time_offset_ns, 33'333'335) << "rounded to float seconds";
  for (std::size_t v = 0; v < scene.views.size(); ++v) {
    const View& view = scene.views[v];
    const Rigid3d recorded = scene.world_from_body(view),
                  body = view.frame == 2 ? recorded * rigid_from_vector(frame) : recorded;
    if (view.camera == 1) {
      expect_same(placed.world_from_camera(placed.views[v]),
                  body * scene.rig[1].body_from_sensor * rigid_from_vector(camera), 1e-7);
    } else if (view.frame == 3) {  // interpolated half way to the next frame
      EXPECT_NEAR((placed.world_from_body(view).translation() - recorded.translation()).norm(), 0.5,
                  1e-5);
    }
  }
}

TEST_F(PoseCorrectionsTest, HeldOutFramesAreInterpolated) {
  const Scene scene = scene_of(3);  // frames 0 and 3 are held out
  PoseCorrections corrections(scene);
  for (const int f : {1, 2, 4, 5})
    corrections.values[corrections.frame_slot(f)] = static_cast<float>(f);
  interpolate_held_out(scene, &corrections);
  EXPECT_EQ(corrections.values[corrections.frame_slot(0)], 1) << "before the first";
  EXPECT_NEAR(corrections.values[corrections.frame_slot(3)], 3, 1e-5);
  EXPECT_EQ(corrections.values[corrections.frame_slot(4)], 4);
}

// Gradients of a view's position and rotation against differences, for each parameter.
TEST_F(PoseCorrectionsTest, GradientAgreesWithDifferencesOfViewPoses) {
  const Scene scene = scene_of();
  const PoseCorrections none(scene);
  std::vector<ViewGradient> views(scene.views.size());
  for (std::size_t i = 0; i < views.size(); ++i)
    for (int k = 0; k < 3; ++k) {
      views[i].d_translation[k] = uniform(6 * i + k);
      views[i].d_rotation[k] = uniform(6 * i + 3 + k);
    }
  const auto loss = [&](const PoseCorrections& corrections) {
    Scene placed = scene;
    placed.correct(corrections);
    double sum = 0;
    for (std::size_t v = 0; v < views.size(); ++v) {
      const Rigid3d before = scene.world_from_camera(scene.views[v]),
                    after = placed.world_from_camera(placed.views[v]);
      const Eigen::AngleAxisd turn(Eigen::Matrix3d(after.linear() * before.linear().transpose()));
      sum += views[v].d_translation.dot(after.translation() - before.translation()) +
             views[v].d_rotation.dot(turn.angle() * turn.axis());
    }
    return sum;
  };
  const std::vector<double> gradient = gradient_of_corrections(scene, none, views);
  ASSERT_EQ(gradient.size(), none.size());
  for (std::size_t i = 0; i < gradient.size(); ++i) {
    // ECEF metres round to 1e-9, angles of such differences to 1e-8. Between frames poses are
    // chords of arcs of 0.1 rad, along which corrections are interpolated by time alone: a few per
    // cent of the motions' own rotation.
    constexpr float h = 1e-3f;
    PoseCorrections more = none, less = none;
    more.values[i] += h;
    less.values[i] -= h;
    EXPECT_NEAR((loss(more) - loss(less)) / (2 * h), gradient[i],
                0.03 * std::abs(gradient[i]) + 0.1)
        << i;
  }
}

}  // namespace
}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/poses/pose_refiner.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/methods/march/ray_model.h"
#include "redrive/rays/ray_table.h"
#include "redrive/scene/scene_testing.h"
#include "redrive/train/poses/pose_changes.h"
#include "redrive/train/poses/pose_refinement.h"

namespace redrive {
namespace {

using Eigen::Vector3d;

class PoseRefinerTest : public ::testing::Test {
 protected:
  static SceneOptions holdout() {
    SceneOptions options;
    options.holdout_every = 3;
    return options;
  }
  TemporaryFolder folder_;
  Recording recording_ = make_test_recording(folder_.path);
  Scene scene_ = make_scene(recording_, holdout());
};

// Two rays of one view and one of another: derivatives of translations are sums, derivatives of
// rotations are sums of each ray's direction x its derivative.
TEST_F(PoseRefinerTest, SumsTheDerivativesOfAViewsRays) {
  RayBatch batch;
  batch.n = 3;
  batch.view = {2, 4, 2};
  batch.direction = {1, 0, 0, 0, 1, 0, 0, 0, 1};  // x, y, z
  RayGradientsOutput losses;
  losses.d_origin = {1, 2, 3, 10, 20, 30, 100, 200, 300};
  losses.d_direction = {0, 5, 0, 4, 0, 0, 0, 6, 7};
  const auto views = view_gradients(scene_, batch, losses.d_origin, losses.d_direction);
  ASSERT_EQ(views.size(), scene_.views.size());
  EXPECT_EQ(views[2].d_translation, Vector3d(4, 40, 400));
  EXPECT_EQ(views[2].d_rotation, Vector3d(1, 0, 0).cross(Vector3d(0, 4, 0)) +
                                     Vector3d(0, 0, 1).cross(Vector3d(0, 0, 7)));
  EXPECT_EQ(views[4].d_translation, Vector3d(2, 20, 200));
  EXPECT_EQ(views[4].d_rotation, Vector3d(0, 1, 0).cross(Vector3d(5, 0, 6)));
  EXPECT_EQ(views[0].d_translation, Vector3d::Zero());
}

const PoseRefinement kRefinement;

/// A loss with its minimum at the poses of `ground_truth`: squared distances of three points on
/// each camera.
class Landmarks {
 public:
  explicit Landmarks(const Scene& ground_truth) : ground_truth_(ground_truth) {}

  /// Returns the gradients by a batch of three rays per view.
  double losses(const Scene& now, RayBatch* batch, RayGradientsOutput* losses) const {
    std::vector<Vector3d> d_origin, direction, d_direction;
    batch->view.clear();
    double sum = 0;
    for (std::size_t v = 0; v < now.views.size(); ++v) {
      if (now.views[v].held_out) continue;
      const Rigid3d here = now.world_from_camera(now.views[v]),
                    there = ground_truth_.world_from_camera(ground_truth_.views[v]);
      for (int k = 0; k < 3; ++k) {
        // |o - o'|^2 + 100 |d - d'|^2: directions to points 10 m away.
        const Vector3d d = here.linear().col(k), off = d - there.linear().col(k),
                       moved = here.translation() - there.translation();
        batch->view.push_back(static_cast<std::uint32_t>(v));
        direction.push_back(d);
        d_origin.push_back(2 * moved);
        d_direction.push_back(200 * off);
        sum += moved.squaredNorm() + 100 * off.squaredNorm();
      }
    }
    const std::size_t n = direction.size();
    batch->n = static_cast<int>(n);
    for (auto* values : {&batch->direction, &losses->d_origin, &losses->d_direction})
      values->resize(3 * n);
    for (std::size_t i = 0; i < n; ++i)
      for (int k = 0; k < 3; ++k) {
        batch->direction[k * n + i] = static_cast<float>(direction[i][k]);
        losses->d_origin[k * n + i] = static_cast<float>(d_origin[i][k]);
        losses->d_direction[k * n + i] = static_cast<float>(d_direction[i][k]);
      }
    return sum / static_cast<double>(n);
  }

 private:
  const Scene& ground_truth_;
};

/// Refines zero corrections towards landmarks, with rates of the first and the last update. Returns
/// the loss before and after.
std::pair<double, double> refine(const Scene& scene, const Scene& ground_truth, int steps,
                                 double first_m, double last_m, PoseState* state) {
  const Landmarks landmarks(ground_truth);
  Scene now = scene;
  RayBatch batch;
  RayGradientsOutput losses;
  const double before = landmarks.losses(now, &batch, &losses);
  for (int step = 0; step < steps; ++step) {
    landmarks.losses(now, &batch, &losses);
    refine_poses(now, view_gradients(now, batch, losses.d_origin, losses.d_direction),
                 pose_rates(first_m * std::pow(last_m / first_m, double(step) / steps)),
                 kRefinement, state);
    now.correct(state->corrections);
  }
  return {before, landmarks.losses(now, &batch, &losses)};
}

TEST_F(PoseRefinerTest, RecoversErrorsOfFramesCamerasAndTimes) {
  PoseCorrections wrong(scene_);
  for (int f = 0; f < wrong.frames; ++f)
    for (int k = 0; k < 6; ++k)
      wrong.values[wrong.frame_slot(f) + k] = (k < 3 ? 0.05f : 0.004f) * std::sin(2.0f * f + k);
  wrong.values[wrong.camera_slot(1) + 4] = 0.01f;
  wrong.values[wrong.camera_slot(0) + 4] = 0.0f;
  wrong.values[wrong.time_slot(0)] = 0.005f;
  Scene ground_truth = scene_;
  ground_truth.correct(wrong);
  PoseState state(scene_);
  const auto [before, after] = refine(scene_, ground_truth, 600, 3e-3, 3e-5, &state);
  EXPECT_GT(before, 1e-3);
  EXPECT_LT(after, before / 100);
  // The mean correction of the cameras belongs to the frames.
  Vector3d turn = Vector3d::Zero();
  for (int c = 0; c < 2; ++c)
    for (int k = 0; k < 3; ++k)
      turn += scene_.rig[c].body_from_sensor.linear().col(k) *
              state.corrections.values[state.corrections.camera_slot(c) + 3 + k];
  EXPECT_LT(turn.norm(), 1e-6);
  EXPECT_NEAR(state.corrections.values[state.corrections.time_slot(0)] +
                  state.corrections.values[state.corrections.time_slot(1)],
              0, 1e-7);
}

TEST_F(PoseRefinerTest, IgnoresNonFiniteGradients) {
  PoseState state(scene_);
  RayBatch batch;
  RayGradientsOutput losses;
  Landmarks(scene_).losses(scene_, &batch, &losses);
  losses.d_origin[5] = NAN;
  refine_poses(scene_, view_gradients(scene_, batch, losses.d_origin, losses.d_direction),
               pose_rates(1), kRefinement, &state);
  EXPECT_EQ(state.moments.updates, 0);
  EXPECT_THAT(state.corrections.values, ::testing::Each(0.0f));
}

TEST_F(PoseRefinerTest, ClampsCorrectionsToTheirBoundsAndReportsIt) {
  PoseCorrections wrong(scene_);
  for (int f = 0; f < wrong.frames; ++f) wrong.values[wrong.frame_slot(f) + 1] = 2;  // metres
  Scene ground_truth = scene_;
  ground_truth.correct(wrong);
  PoseState state(scene_);
  refine(scene_, ground_truth, 100, 0.02, 0.02, &state);
  for (int f = 0; f < wrong.frames; ++f)
    EXPECT_EQ(state.corrections.values[state.corrections.frame_slot(f) + 1],
              kRefinement.bounds.translation_m)
        << f;
  EXPECT_EQ(at_bound(pose_changes(scene_, state.corrections, kRefinement.bounds)), "6 of 6 frames");
}

}  // namespace
}  // namespace redrive

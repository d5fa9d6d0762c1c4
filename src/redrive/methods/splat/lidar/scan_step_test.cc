// SPDX-License-Identifier: Apache-2.0
// Training steps on LiDAR scans of known Gaussians that no image shows.
#include "redrive/methods/splat/lidar/scan_step.h"

#include <cmath>
#include <numbers>

#include <gtest/gtest.h>

#include "redrive/methods/splat/known_splats_testing.h"

namespace redrive::known_splats {
namespace {

constexpr double kWall_m = 10;

/// Discs every 0.2 m on a wall to the left, which the camera, looking ahead, never sees.
GaussianList wall(double away_m, float intensity) {
  GaussianList list;
  for (int j = -30; j <= 30; ++j)
    for (int k = -8; k <= 8; ++k) {
      std::array<float, kGaussianRows> rows{};
      rows[kPositionRow] = 0.2f * static_cast<float>(j);
      rows[kPositionRow + 1] = static_cast<float>(away_m);
      rows[kPositionRow + 2] = 0.2f * static_cast<float>(k);
      for (int d = 0; d < 3; ++d) rows[kLogScaleRow + d] = std::log(d == 1 ? 0.01f : 0.12f);
      rows[kQuaternionRow] = 1;
      rows[kOpacityRow] = 3;
      rows[kLidarRow + 2 * kIntensitySlot] = intensity;
      rows[kLidarRow + 2 * kReturnSlot] = 1;
      rows[kDistanceRow] = static_cast<float>(kWall_m);
      list.rows.insert(list.rows.end(), rows.begin(), rows.end());
    }
  return list;
}

/// A wall at kWall_m in four scans: intensity 0.2 behind the sensor, 0.6 ahead; rays above 2
/// degrees are lost.
struct ScannedWall : SplatScene {
  ScannedWall() {
    add_camera("FRONT", "opencv_pinhole", {60, 60, 19.5, 14.5, 0, 0, 0, 0, 0}, 40, 30);
    for (int n = 0; n < 4; ++n) add_view(0, pose({0.1 * n, 0, 0}, {0, std::numbers::pi / 2, 0}));
    finish();
    scene.rig[0].body_from_sensor.linear() = so3_exp({0, -std::numbers::pi / 2, 0});
    std::vector<Eigen::Vector3f> directions;
    for (int n = 0; n < 4; ++n) {
      const std::int64_t t_ns = scene.frames[n].t_ns;
      const Rigid3d sensor_from_world =
          scene.world_from_body(t_ns, Poses::kRecorded).inverse(Eigen::Isometry);
      for (int ray = 0; ray < 1600; ++ray) {
        const double azimuth = std::numbers::pi * (0.35 + 0.3 * (ray / 16) / 100),
                     elevation = 0.006 * (ray % 16 - 8);
        const Eigen::Vector3d in_world(std::cos(azimuth) * std::cos(elevation),
                                       std::sin(azimuth) * std::cos(elevation),
                                       std::sin(elevation));
        const Eigen::Vector3f direction = (sensor_from_world.linear() * in_world).cast<float>();
        if (elevation > 2 * std::numbers::pi / 180) {
          lidar.lost.push_back({direction, t_ns});
          continue;
        }
        directions.push_back(direction);
        lidar.range_m.push_back(static_cast<float>(kWall_m / in_world.y()));
        lidar.t_ns.push_back(t_ns);
        lidar.intensity.push_back(in_world.x() > 0 ? 153 : 51);
      }
      lidar.scan_ends.push_back({lidar.range_m.size(), 0, lidar.lost.size()});
    }
    lidar.n = lidar.range_m.size();
    for (int k = 0; k < 3; ++k)
      for (const Eigen::Vector3f& d : directions) lidar.direction.push_back(d[k]);
  }
  /// Renders the rays of a scan again: mean range error of its returns, mean intensity error, mean
  /// probability of being lost of its returns and of its lost rays.
  std::array<double, 4> errors(kernels::Backend& backend, const SplatModel& model) const {
    const ScanWindows windows(scene, lidar, [](std::int64_t) { return true; });
    std::array<double, 4> sums{};
    double returned = 0, lost = 0;
    for (std::size_t w = 0; w < 4; ++w) {
      const ScanWindow window = windows[w];
      const RenderedRays seen = model.trace(backend, window.rays());
      for (std::size_t i = 0; i < window.t_ns.size(); ++i) {
        if (window.log_range[i] == kernels::kNoRange) {
          ++lost;
          sums[3] += double(seen.lost[i]);
          continue;
        }
        ++returned;
        sums[0] += std::abs(double(seen.depth[i]) - std::exp(double(window.log_range[i])));
        sums[1] += std::abs(double(seen.intensity[i] - window.intensity[i]));
        sums[2] += double(seen.lost[i]);
      }
    }
    for (int k = 0; k < 3; ++k) sums[k] /= returned;
    sums[3] /= lost;
    return sums;
  }
};

TEST(ScanStep, FindsRangesIntensitiesAndLostRays) {
  const ScannedWall drive;
  const auto backend = fast_backend();
  Training training;
  training.steps = 300;
  training.begin(wall(kWall_m + 0.15, 0.4f));
  training.model.last_rate = 0.03;  // the last state is judged, not a mean of late ones
  training.model.scan_every = 1;
  training.model.scan_weights = {1, 1, 0.5f};
  training.model.intensity_rate = training.model.return_rate = 1;
  training.model.surface_rate = 0;
  training.model.densify_every = 1000;
  const auto before = drive.errors(*backend, training.model);
  EXPECT_NEAR(before[0], 0.16, 0.02);
  EXPECT_NEAR(before[1], 0.2, 0.02);
  EXPECT_LT(before[3], 0.1);
  training.run(*backend, drive.data());
  const auto after = drive.errors(*backend, training.model);
  EXPECT_LT(after[0], 0.04) << "metres";
  EXPECT_LT(after[1], 0.03);
  EXPECT_LT(after[2], 0.1);
  EXPECT_GT(after[3], 0.8);
}

TEST(ScanStep, ScansTrainBeforeTheFirstImage) {
  const ScannedWall drive;
  const auto backend = fast_backend();
  for (const int parts : {0, 300}) {
    Training training;
    training.begin(wall(kWall_m + 0.15, 0.4f));
    training.model.scans_first = parts;
    training.model.scan_weights = {1, 1, 0.5f};
    EXPECT_TRUE(
        training.model.train_first(*backend, drive.data(), 5, &training.adam, [] { return true; }));
    for (const std::uint32_t moments : training.adam.packed.span()) ASSERT_EQ(moments, 0u);
    const auto after = drive.errors(*backend, training.model);
    if (parts == 0) {
      EXPECT_GT(after[0], 0.1) << "metres";
    } else {
      EXPECT_LT(after[0], 0.05) << "metres";
      EXPECT_GT(after[3], 0.8) << "lost rays";
    }
  }
}

TEST(ScanStep, EveryFewStepsHaveAScan) {
  const ScannedWall drive;
  const auto backend = fast_backend();
  Training training;
  training.begin(wall(kWall_m, 0.4f));
  StepRequest request = training.request();
  training.gradients(*backend, drive.data(), request);
  const float* const gradients = training.buffers.gradients.data();
  double intensity = 0, colour = 0;
  for (std::size_t i = 0; i < std::size_t(training.model.gaussians); ++i) {
    intensity += std::abs(double(gradients[gaussian_slot(i, kLidarRow)]));
    colour += std::abs(double(gradients[gaussian_slot(i, kColourRow)]));
  }
  EXPECT_GT(intensity, 0);
  EXPECT_EQ(colour, 0) << "no image shows them";
  request.step = 1;
  training.gradients(*backend, drive.data(), request);
  for (std::size_t i = 0; i < std::size_t(training.model.gaussians); ++i)
    ASSERT_EQ(gradients[gaussian_slot(i, kLidarRow)], 0) << "no scan in this step";
}

TEST(ScanStep, ThreadsChangeNoBit) {
  const ScannedWall drive;
  Training one, four;
  for (Training* training : {&one, &four}) {
    training->steps = 12;
    training->begin(wall(kWall_m, 0.4f));
    training->run(*fast_backend(training == &one ? 1 : 4), drive.data());
  }
  EXPECT_TRUE(std::ranges::equal(one.model.parameters.span(), four.model.parameters.span()));
}

}  // namespace
}  // namespace redrive::known_splats

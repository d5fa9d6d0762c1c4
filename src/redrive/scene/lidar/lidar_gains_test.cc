// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/lidar/lidar_gains.h"

#include <algorithm>
#include <array>
#include <cmath>

#include <gtest/gtest.h>

#include "redrive/scene/scene_testing.h"

namespace redrive {
namespace {

// Four beams that scale intensities differently and see the same spots.
TEST(LidarGains, OfBeamsFollowFromWhatOthersSee) {
  const TemporaryFolder folder;
  const Recording recording = make_test_recording(folder.path, 3);
  constexpr std::array kGains = {0.6, 1.0, 1.2, 1.1};
  constexpr std::size_t kSpots = 400;
  LidarReturns returns;
  std::vector<float> z;
  for (std::size_t spot = 0; spot < kSpots; ++spot)
    for (std::size_t k = 0; k < 16; ++k) {
      const auto ring = static_cast<std::uint8_t>(k % 4);
      returns.range_m.push_back(5.1f + 0.4f * static_cast<float>(spot));
      z.push_back(0.001f + 1e-5f * static_cast<float>(ring));  // not on a voxel's border
      returns.t_ns.push_back(recording.frames[1].t_ns);
      returns.ring.push_back(ring);
      returns.intensity.push_back(static_cast<std::uint16_t>(1000 * (1 + spot % 7) * kGains[ring]));
    }
  returns.n = returns.range_m.size();
  returns.direction.assign(3 * returns.n, 0);
  std::fill_n(returns.direction.begin(), returns.n, 1.0f);
  std::fill_n(returns.direction.begin() + std::ptrdiff_t(returns.n), returns.n, 0.001f);
  std::ranges::copy(z, returns.direction.begin() + std::ptrdiff_t(2 * returns.n));
  returns.scan_ends = {{returns.n, 0, 0, 0}};
  const Scene scene = make_scene(recording, {});
  ThreadPool pool(1);
  const std::vector<BeamGain> beams = estimate_gains(scene, returns, pool)[0].beams;
  ASSERT_EQ(beams.size(), 4u);
  for (std::size_t r = 0; r < 4; ++r) {
    EXPECT_NEAR(beams[r].gain / beams[1].gain, kGains[r], 0.01) << r;
    EXPECT_NEAR(beams[r].elevation_rad, 0.001 + 1e-5 * double(r), 1e-6);
  }
  double log_sum = 0;
  for (const BeamGain& beam : beams) log_sum += std::log(beam.gain);
  EXPECT_NEAR(log_sum, 0, 1e-5);
  // With them, all beams measure the same.
  returns.sensors[0].beam_gains = beams;
  const std::vector<float> full = returns.full_intensities();
  EXPECT_NEAR(returns.intensity_of(0, full), returns.intensity_of(2, full), 0.002f);
  // Few returns do not tell, nor does a single beam.
  returns.ring.assign(returns.n, 2);
  EXPECT_TRUE(estimate_gains(scene, returns, pool)[0].beams.empty());
}

}  // namespace
}  // namespace redrive

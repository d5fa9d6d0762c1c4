// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/memory.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/methods/splat/range_pixels.h"
#include "redrive/methods/splat/surface_planes.h"
#include "redrive/recording/formats/aimotive/aimotive.h"
#include "redrive/recording/lidar/las.h"
#include "redrive/train/train_testing.h"

namespace redrive {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

constexpr std::uint64_t kGiB = std::uint64_t{1} << 30;

TEST(Memory, AllowedAsBytesGiBOrShare) {
  const auto allowed = [](const char* text) {
    TrainOptions options;
    options.memory = text;
    return allowed_memory(options, 10 * kGiB);
  };
  EXPECT_EQ(allowed("6000000000"), 6000000000u);
  EXPECT_EQ(allowed("6GiB"), 6 * kGiB);
  EXPECT_EQ(allowed("0.5GiB"), kGiB / 2);
  EXPECT_EQ(allowed("50%"), 5 * kGiB);
  EXPECT_EQ(allowed_memory(TrainOptions{}, 10 * kGiB), 7 * kGiB);
  for (const char* text : {"", "GiB", "6GB", "-1", "0", "nan", "inf", "6 GiB", "1e30", "%"})
    EXPECT_THROW(allowed(text), UsageError) << text;
}

class MemoryEstimateTest : public testing::Test {
 protected:
  redrive::Run run_of(const TrainOptions& options) {
    redrive::Run run;
    run.options = options;
    run.recording = recording_;
    run.scene = make_scene(recording_, scene_options(options));
    run.state = make_initial_state(options, run.scene);
    return run;
  }
  MemoryEstimate of(const TrainOptions& options, int threads = 2) {
    return estimate_memory(run_of(options), threads);
  }

  TemporaryFolder folder_;
  Recording recording_ = make_test_recording(folder_.path, 6);  // FRONT 24 x 16
};

TEST_F(MemoryEstimateTest, CountsTheBytesOfEachPixel) {
  TrainOptions options = tiny_options(1);
  options.masks = "none";
  EXPECT_EQ(of(options).images, 6u * 24 * 16 * 3);
  EXPECT_EQ(of(options).rays, 24u * 16 * 16);
  options.holdout_every = 3;
  EXPECT_EQ(of(options).images, 4u * 24 * 16 * 3);
  options.masks = "auto";
  EXPECT_EQ(of(options).images, 4u * 24 * 16 * 4 + 4 * 24 * 16 * 3 / 16);
  options.downscale = 2;
  EXPECT_EQ(of(options).rays, 12u * 8 * 16);
  EXPECT_EQ(of(options).decoding, of(tiny_options(1)).decoding)
      << "images are decoded at their recorded size";
}

TEST_F(MemoryEstimateTest, GrowsWithTheModelAndTheBatch) {
  TrainOptions options = tiny_options(1);
  const MemoryEstimate one = of(options);
  options.set("batch_rays", 128);
  const std::uint64_t batch = of(options).step - one.step;
  options.set("batch_rays", 256);
  EXPECT_EQ(of(options).step, one.step + 3 * batch);
  options.set("width", 64);
  EXPECT_GT(of(options).state, one.state);
}

TEST_F(MemoryEstimateTest, RejectsMoreThanAllowedNamingTheOptionToLower) {
  TrainOptions options = tiny_options(1);
  MemoryEstimate need;
  need.images = 3 * kGiB;
  need.step = kGiB / 4;
  need.step_option = "--batch (64 rays: ";
  check_memory(need, 4 * kGiB, options);
  EXPECT_EQ(memory_text(need.total(), 4 * kGiB), "needs about 3.4 GiB of 4.0 GiB allowed");
  const auto rejection = [&] {
    try {
      check_memory(need, 3 * kGiB, options);
    } catch (const UsageError& error) {
      return std::string(error.what());
    }
    return std::string("not rejected");
  };
  EXPECT_THAT(rejection(),
              AllOf(HasSubstr("--memory"), HasSubstr("70%"),
                    HasSubstr("3.4 GiB of 3.0 GiB allowed"), HasSubstr("lower --downscale")));
  need.step = 8 * kGiB;
  EXPECT_THAT(rejection(), HasSubstr("lower --batch (64 rays: 8.0 GiB), --downscale"));
  need.sorting = 9 * kGiB;
  EXPECT_THAT(rejection(), HasSubstr("lower --frames or --lidar-rays 0 (LiDAR: 9.0 GiB), --batch"));
}

TEST(Memory, OfADeviceIsRefusedWithTheFigures) {
  TrainOptions options;
  options.gpu_memory = "50%";
  const std::uint64_t allowed = allowed_device_memory(options, 4 * kGiB);
  EXPECT_EQ(allowed, 2 * kGiB);
  check_device_memory(allowed, allowed, options);
  try {
    check_device_memory(3 * kGiB, allowed, options);
    ADD_FAILURE() << "not rejected";
  } catch (const UsageError& error) {
    EXPECT_STREQ(error.what(),
                 "--gpu-memory 50%: training needs about 3.0 GiB of 2.0 GiB allowed; lower "
                 "--max-gaussians, or --backend cpu needs none");
  }
}

TEST_F(MemoryEstimateTest, CountsWhatSplatsDeriveFromReturns) {
  constexpr std::uint64_t kPoints = 21'000, kReturns = kPoints * 2 / 3;
  const std::vector<LidarRecord> points(kPoints, {{20, 0, 0}, 1});
  folder_.write("frame_10.las", make_las(points));
  recording_.reader = aimotive::make_reader();
  recording_.lidars = {{"lidar", Rigid3d::Identity()}};
  recording_.lidar_files = {{10, folder_.path / "frame_10.las"}};
  EXPECT_EQ(of(tiny_options(1)).of_lidar, 0u);
  TrainOptions options;
  options.recording = "in memory";
  options.method = "splat";
  apply_preset(&options, {});
  options.cameras = {"FRONT"};
  const MemoryEstimate with_scans = of(options);
  options.set("scan_every", 0);
  const MemoryEstimate all = of(options);
  EXPECT_GT(with_scans.of_lidar, all.of_lidar + kReturns / 8 * kGaussianRows * 8);
  EXPECT_LT(with_scans.of_lidar, all.of_lidar + kReturns / 8 * 1000);
  options.set("range_weight", 0);
  const MemoryEstimate planes = of(options);
  EXPECT_EQ(planes.of_lidar, surface_planes_bytes(kReturns));
  EXPECT_EQ(all.of_lidar - planes.of_lidar, 6u * 24 * 16 * sizeof(ShownReturn))
      << "returns of about every pixel, one each";
  EXPECT_GT(all.total(), planes.total());
  options.set("surface_rate", 0);
  EXPECT_EQ(of(options).of_lidar, 0u);
}

// Methods without LiDAR read it, too, to find what moves.
TEST_F(MemoryEstimateTest, CountsTheSearchForMovingObjects) {
  constexpr std::uint64_t kPoints = 20'000;
  const std::vector<LidarRecord> points(kPoints, {{20, 0, 0}, 1});
  folder_.write("frame_10.las", make_las(points));
  recording_.reader = aimotive::make_reader();
  recording_.lidars = {{"lidar", Rigid3d::Identity()}};
  TrainOptions options = tiny_options(1);
  const MemoryEstimate without = of(options);
  EXPECT_EQ(without.search, 0u);
  recording_.lidar_files = {{10, folder_.path / "frame_10.las"}};
  const MemoryEstimate with = of(options);
  EXPECT_EQ(with.lidar, 0u);
  EXPECT_GT(with.search, kPoints * 36 * 2 / 3);
  EXPECT_LT(with.search, kPoints * 400);
  MemoryEstimate large = with;
  large.search = 4 * kGiB;
  EXPECT_GT(large.total(), 4 * kGiB);
  EXPECT_LT(large.total(), 5 * kGiB) << "what is loaded afterwards is not there yet";
  options.masks = "none";
  EXPECT_EQ(of(options).search, 0u);
}

}  // namespace
}  // namespace redrive

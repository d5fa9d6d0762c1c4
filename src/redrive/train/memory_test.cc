// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/memory.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/train/test_support.h"

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

class MemoryEstimate : public testing::Test {
 protected:
  MemoryNeed of(const TrainOptions& options, int threads = 2) {
    redrive::Run run;
    run.options = options;
    run.recording = recording_;
    run.scene = make_scene(recording_, scene_options(options));
    run.state = first_state(options, run.scene);
    return estimate_memory(run, threads);
  }

  TemporaryFolder folder_;
  Recording recording_ = make_test_recording(folder_.path, 6);  // FRONT 24 x 16
};

TEST_F(MemoryEstimate, CountsWhatIsKeptOfEachPixel) {
  TrainOptions options = tiny_options(1);
  options.masks = "none";
  EXPECT_EQ(of(options).pictures, 6u * 24 * 16 * 3);
  EXPECT_EQ(of(options).rays, 24u * 16 * 16);
  options.holdout_every = 3;
  EXPECT_EQ(of(options).pictures, 4u * 24 * 16 * 3);
  options.masks = "auto";
  EXPECT_EQ(of(options).pictures, 4u * 24 * 16 * 4 + 4 * 24 * 16 * 3 / 16);
  options.downscale = 2;
  EXPECT_EQ(of(options).rays, 12u * 8 * 16);
  EXPECT_EQ(of(options).decoding, of(tiny_options(1)).decoding) << "they are decoded as recorded";
}

TEST_F(MemoryEstimate, GrowsWithTheModelAndTheBatch) {
  TrainOptions options = tiny_options(1);
  const MemoryNeed one = of(options);
  options.batch_rays *= 2;
  const std::uint64_t batch = of(options).step - one.step;
  options.batch_rays *= 2;
  EXPECT_EQ(of(options).step, one.step + 3 * batch);
  options.width = 64;
  EXPECT_GT(of(options).state, one.state);
}

TEST_F(MemoryEstimate, MoreThanAllowedIsRefusedWithWhatToLower) {
  TrainOptions options = tiny_options(1);
  MemoryNeed need;
  need.pictures = 3 * kGiB;
  need.step = kGiB / 4;
  check_memory(need, 4 * kGiB, options);
  EXPECT_EQ(memory_text(need, 4 * kGiB), "needs about 3.4 GiB of 4.0 GiB allowed");
  const auto refused = [&] {
    try {
      check_memory(need, 3 * kGiB, options);
    } catch (const UsageError& error) {
      return std::string(error.what());
    }
    return std::string("not refused");
  };
  EXPECT_THAT(refused(), AllOf(HasSubstr("--memory"), HasSubstr("70%"), HasSubstr("3.4 GiB of 3.0 GiB allowed"),
                               HasSubstr("lower --downscale")));
  need.step = 8 * kGiB;
  EXPECT_THAT(refused(), HasSubstr("lower --batch (64 rays: 8.0 GiB), --downscale"));
  need.sorting = 9 * kGiB;
  EXPECT_THAT(refused(), HasSubstr("lower --frames or --lidar-rays 0 (LiDAR: 9.0 GiB), --batch"));
}

}  // namespace
}  // namespace redrive

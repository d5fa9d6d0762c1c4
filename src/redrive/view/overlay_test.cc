// SPDX-License-Identifier: Apache-2.0
// LiDAR points and masks over images whose surface is 2 m away.
#include "redrive/view/overlay.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/recording/formats/recording_reader.h"
#include "redrive/render/paint_backend_testing.h"
#include "redrive/scene/scene_testing.h"

namespace redrive::view {
namespace {

using ::testing::Each;
using ::testing::ElementsAre;
using ::testing::IsEmpty;

constexpr int kPointsOfFile = 80000;

/// Points on the axis of the test recording's FRONT camera, at the time of the frame.
class AxisReader : public RecordingReader {
 public:
  std::vector<LidarPoint> read_lidar(const FrameFile& file, std::size_t* = nullptr) const override {
    if (file.path == "damaged") throw InputError(file.path, "", "", "is damaged");
    const std::int64_t t_ns = 1000000000 + (file.frame_id - 10) * 66666667ll;
    return std::vector<LidarPoint>(
        kPointsOfFile, LidarPoint{.in_body_m = {2 + ahead_m, 0.1f, 1.2f}, .t_ns = t_ns});
  }
  float ahead_m = 1.5;
};

class OverlayTest : public testing::Test {
 protected:
  OverlayTest() {
    run_.recording = make_test_recording(folder_.path, 3);
    run_.scene = make_scene(run_.recording, {});
    run_.recording.reader = reader_;
    run_.recording.lidars = {{"lidar", Rigid3d::Identity()}};
    for (int frame = 10; frame < 14; ++frame)  // the last one has no pose
      run_.recording.lidar_files.push_back({frame, ""});
    run_.options.method = "nerf";
    run_.state.model = make_painted_model();
  }

  /// Returns the sixth byte of each point over FRONT's image of the first frame.
  std::vector<char> points(Overlay* overlay, const Overlays& which,
                           const RenderedScan* rendered = nullptr) {
    ViewRenderer renderer(run_, backend_);
    ViewRequest request;
    request.camera = "FRONT";
    request.frame = 10;
    RenderJob job = renderer.begin(request, renderer.place(request), 1, 0, 1);
    while (!job.step()) {
    }
    const std::string bytes = overlay->points(job, which, rendered);
    EXPECT_EQ(bytes.size() % 6, 0u);
    std::vector<char> kinds;
    for (std::size_t i = 5; i < bytes.size(); i += 6) kinds.push_back(bytes[i]);
    return kinds;
  }

  TemporaryFolder folder_;
  redrive::Run run_;
  std::shared_ptr<AxisReader> reader_ = std::make_shared<AxisReader>();
  PaintBackend backend_{[](const auto&, const auto&) {
    return std::array<float, 3>{0.5, 0.5, 0.5};
  }};
};

TEST_F(OverlayTest, ProjectsTheRevolutionOfTheFrame) {
  Overlay overlay(run_);
  const auto kinds = points(&overlay, {.lidar = true});
  EXPECT_EQ(kinds.size(), kPointsOfFile);
  EXPECT_THAT(kinds, Each(1));
  EXPECT_THAT(points(&overlay, {}), IsEmpty());
}

TEST_F(OverlayTest, HidesPointsBehindTheSurface) {
  reader_->ahead_m = 3;
  Overlay overlay(run_);
  EXPECT_THAT(points(&overlay, {.lidar = true}), IsEmpty());
}

TEST_F(OverlayTest, CollectsTheRevolutionsOfAllFrames) {
  Overlay overlay(run_);
  EXPECT_THAT(points(&overlay, {.cloud = true}), IsEmpty());
  EXPECT_TRUE(overlay.read_cloud());
  EXPECT_EQ(overlay.cloud_revolutions(), 1u);
  // A third of the cloud is 66,666 points: every second one of 80,000.
  EXPECT_EQ(points(&overlay, {.cloud = true}).size(), kPointsOfFile / 2);
  EXPECT_TRUE(overlay.read_cloud());
  EXPECT_TRUE(overlay.read_cloud());
  EXPECT_FALSE(overlay.read_cloud());
  const auto kinds = points(&overlay, {.cloud = true});
  EXPECT_EQ(kinds.size(), Overlay::kPointsOfImage);
  EXPECT_THAT(kinds, Each(0));
}

TEST_F(OverlayTest, ProjectsARenderedScan) {
  Overlay overlay(run_);
  RenderedScan scan;
  scan.in_world.assign(kPointsOfFile, {3.5f, 0.1f, 1.2f});
  scan.colour.assign(kPointsOfFile, 7);
  const auto kinds = points(&overlay, {}, &scan);
  EXPECT_EQ(kinds.size(), Overlay::kPointsOfImage);
  EXPECT_THAT(kinds, Each(2));
}

TEST_F(OverlayTest, LeavesOutADamagedRevolution) {
  run_.recording.lidar_files[0].path = "damaged";
  Overlay overlay(run_);
  EXPECT_THROW(overlay.read_cloud(), InputError);
  EXPECT_TRUE(overlay.read_cloud());
  EXPECT_EQ(overlay.cloud_revolutions(), 2u);
}

TEST(MaskRuns, AlternateFromUsedToMasked) {
  Mask mask = full_mask(20, 10);
  const auto runs = [&] {
    std::vector<int> bytes;
    for (const char byte : mask_runs(mask)) bytes.push_back(static_cast<unsigned char>(byte));
    return bytes;
  };
  EXPECT_THAT(runs(), ElementsAre(128 | 72, 1));  // 200 used
  mask.used[0] = mask.used[1] = mask.used[199] = 0;
  EXPECT_THAT(runs(), ElementsAre(0, 2, 128 | 69, 1, 1));  // 2 masked, 197 used, 1 masked
}

}  // namespace
}  // namespace redrive::view

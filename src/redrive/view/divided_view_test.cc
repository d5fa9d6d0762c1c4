// SPDX-License-Identifier: Apache-2.0
// The viewer's images of a drive in blocks, whose images are a formula of the ray.
#include <atomic>
#include <memory>

#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/render/divided_field.h"
#include "redrive/render/paint_backend_testing.h"
#include "redrive/scene/scene_testing.h"
#include "redrive/view/view_renderer.h"

namespace redrive::view {
namespace {

constexpr int kDriven = 50, kFramesOfBlock = 10;

class DividedView : public testing::Test {
 protected:
  DividedView() {
    run_.recording = make_test_recording(folder_.path, kDriven);
    run_.scene = make_scene(run_.recording, {});
    run_.options.method = "nerf";
    run_.paths.root = folder_.path / "run";
    std::vector<Eigen::Vector3d> positions;
    std::vector<std::int64_t> t_ns;
    std::vector<std::size_t> last_core;
    for (const PosedFrame& frame : run_.scene.posed_frames()) {
      positions.push_back(frame.world_from_body.translation());
      t_ns.push_back(frame.t_ns);
      if (positions.size() % kFramesOfBlock == 0) {
        last_core.push_back(positions.size() - 1);
        run_.blocks.push_back({.name = "00" + std::to_string(run_.blocks.size())});
      }
    }
    SeamExposure seams{{}, std::vector<std::vector<LogGains>>(last_core.size())};
    auto field = std::make_unique<DividedField>(
        make_painted_model(),
        DividedDrive{{"FISHEYE", "FRONT"}, t_ns, BlockWay(positions, last_core), seams},
        [this](int) {
          ++loads_;
          auto block = std::make_shared<LoadedBlock>();
          block->model = make_painted_model();
          block->scene.frames = run_.scene.frames;
          block->scene.rig = run_.scene.rig;
          block->bytes = 1000;
          return block;
        },
        /*bytes=*/4000);
    field_ = field.get();
    run_.field_of_blocks = std::move(field);
  }

  TemporaryFolder folder_;
  std::atomic<int> loads_ = 0;
  PaintBackend backend_{[](const std::array<float, 3>&, const std::array<float, 3>& d) {
    return std::array<float, 3>{0.5f + 0.4f * d[0], 0.5f + 0.4f * d[1], 0.5f + 0.4f * d[2]};
  }};
  redrive::Run run_;
  const DividedField* field_ = nullptr;
};

TEST_F(DividedView, DrivesThroughAllBlocksInBoundedMemory) {
  ViewRenderer renderer(run_, backend_);
  const auto one = make_painted_model();
  for (const Frame& frame : run_.scene.frames) {
    ViewRequest request;
    request.camera = "FRONT";
    request.frame = frame.id;
    request.exposure = "own";
    request.shift_m = {0, 0.5, 0};
    const Placement placement = renderer.place(request);
    RenderJob job = renderer.begin(request, placement, 1, 0, 1);
    while (!job.step()) {
    }
    EXPECT_EQ(
        to_image8(job.image()).rgb,
        to_image8(render_image(backend_, *one, placement.camera, placement.world_from_camera)).rgb)
        << frame.id;
    EXPECT_LE(field_->cache().bytes(), 4000u);
  }
  EXPECT_EQ(loads_, kDriven / kFramesOfBlock);
}

TEST_F(DividedView, SaysWhatItDoesNotShow) {
  ViewRenderer renderer(run_, backend_);
  ViewRequest request;
  request.camera = "FRONT";
  request.frame = run_.scene.frames.front().id;
  request.exposure = "own";
  RenderJob job = renderer.begin(request, renderer.place(request), 1, 0, 1);
  while (!job.step()) {
  }
  EXPECT_THROW(renderer.colours(job, Layer::kCoverage, run_.scene), UsageError);
  EXPECT_THROW(renderer.begin_search(Eigen::Vector3d::Zero()), UsageError);
  EXPECT_NO_THROW(renderer.colours(job, Layer::kDepth, run_.scene));
}

}  // namespace
}  // namespace redrive::view

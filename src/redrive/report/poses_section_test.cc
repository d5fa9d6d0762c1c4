// SPDX-License-Identifier: Apache-2.0
#include "redrive/report/poses_section.h"
#include "redrive/image/image_io.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/files/files.h"
#include "redrive/report/html_testing.h"
#include "redrive/report/plot.h"
#include "redrive/scene/scene_testing.h"
#include "redrive/train/poses/pose_refinement.h"

namespace redrive {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

class PosesSection : public ::testing::Test {
 protected:
  PosesSection() {
    run_.recording = make_test_recording(folder_.path);
    run_.scene = make_scene(run_.recording, {});
    run_.paths.root = folder_.path;
  }
  std::string section() const {
    return without_heads(poses_section(run_, folder_.path / "figures"));
  }
  /// As open_run does.
  void refine(std::size_t at, float value) {
    if (!run_.state.poses.refines()) run_.state.poses = PoseState(run_.scene);
    run_.state.poses.corrections.values[at] = value;
    run_.scene.correct(run_.state.poses.corrections);
  }
  TemporaryFolder folder_;
  redrive::Run run_;
};

TEST_F(PosesSection, NamesTheSourceOfThePoses) {
  EXPECT_THAT(section(), HasSubstr("As recorded. Not refined by training."));
  run_.options.poses = "/home/me/<aligned>";
  EXPECT_THAT(
      section(),
      HasSubstr("Aligned before training (<code>--poses /home/me/&lt;aligned&gt;</code>)."));
  EXPECT_THAT(section(), Not(HasSubstr("href")));
  run_.options.poses = "";
  run_.options.align = true;
  std::filesystem::create_directory(run_.paths.poses());
  write_file(run_.paths.poses() / "report.html", "");
  EXPECT_THAT(section(), HasSubstr("(<code>--align</code>). <a href=\"poses/report.html\">"));
  run_.options.align = false;
  run_.options.ground_truth_poses = true;
  EXPECT_THAT(section(), HasSubstr("--truth-poses"));
  EXPECT_FALSE(std::filesystem::exists(folder_.path / "figures")) << "nothing to draw";
}

TEST_F(PosesSection, ShowsTheCheckpointsCorrections) {
  const PoseCorrections at(run_.scene);
  refine(at.camera_slot(1) + 2, 0.025f);  // FRONT ahead
  refine(at.camera_slot(1) + 5, 0.01f);   // rolled
  refine(at.time_slot(1), -0.0035f);
  refine(at.frame_slot(2) + 1, 0.06f);  // to the left
  const std::string html = section();
  EXPECT_THAT(html, HasSubstr("<td>FRONT</td><td>2.50</td><td>0.00</td><td>0.00</td><td>2.50</"
                              "td><td>0.573</td><td>0.000"
                              "</td><td>0.000</td><td>0.573</td><td>-3.50</td><td></td>"));
  EXPECT_THAT(html, HasSubstr("<td>FISHEYE</td><td>0.00</td>"));
  EXPECT_THAT(html, HasSubstr("<td>2.45</td>")) << "6 cm of one of six frames";
  EXPECT_THAT(html, Not(HasSubstr("class=\"warning\"")));
  for (const char* plot : {"figures/poses_moved.png", "figures/poses_turned.png"})
    EXPECT_EQ(read_image(folder_.path / plot).width, kPlotWidth_px);
  const PoseChanges changes = pose_changes(run_.scene, run_.state.poses.corrections, PoseBounds());
  // Frame 2 at 2 x 0.066667 s: cm.
  EXPECT_THAT(frame_translations_script(run_.scene, changes),
              HasSubstr("\n0.133333 0 0 0 6 6 6 0 0 0\n"));
  EXPECT_THAT(frame_translations_script(run_.scene, changes), Not(HasSubstr("bound")));
}

TEST_F(PosesSection, WarnsWhereACorrectionIsAtItsBound) {
  const PoseCorrections at(run_.scene);
  refine(at.frame_slot(4) + 5, -PoseBounds().rotation_rad);
  refine(at.time_slot(0), PoseBounds().time_offset_s);
  const std::string html = section();
  EXPECT_THAT(html, HasSubstr("<p class=\"warning\">Warning: Corrections are at their bounds "
                              "(50 cm and 2.0 degrees "
                              "along each axis, cameras also at 50 ms): 1 of 6 frames, FISHEYE."));
  EXPECT_THAT(html, HasSubstr("<td>50.00</td><td>at its bound</td>"));
  EXPECT_THAT(html, HasSubstr("<td>1 at their bounds</td>"));
  const PoseChanges changes = pose_changes(run_.scene, run_.state.poses.corrections, PoseBounds());
  EXPECT_THAT(frame_rotations_script(run_.scene, changes), HasSubstr("title 'bound'"));
  EXPECT_THAT(frame_translations_script(run_.scene, changes), Not(HasSubstr("bound")));
}

}  // namespace
}  // namespace redrive

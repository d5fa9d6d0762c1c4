// SPDX-License-Identifier: Apache-2.0
// The ray of a pixel, E_P,0^-1 E_P,n E_C applied to ((u - cx)/fx, (v - cy)/fy, 1), against values
// computed independently from a real car's calibration and egomotion files, with 50 digits.
#include <algorithm>

#include <gtest/gtest.h>

#include "redrive/rays/ray_table.h"

namespace redrive {
namespace {

struct KnownRay {
  const char* camera;
  std::int64_t frame_id;
  int u, v;
  double origin_m[3], direction[3];
};

const KnownRay kKnown[] = {
    {"F_MIDLONGRANGECAM_CL",
     33663,
     1100,
     200,
     {41.9997904639, -0.377566892278, 1.16100746643},
     {0.910670758883, -0.386871073681, 0.144946684215}},
    {"B_MIDRANGECAM_C",
     33692,
     37,
     1100,
     {97.9945047135, -1.50184379084, 1.14758284807},
     {-0.674878421889, -0.645676955879, -0.357267944707}},
};

TEST(Equation2, HoldsForRaysOfARealRecording) {
  const std::filesystem::path root = REDRIVE_SHARED "/data/aimotive_night";
  if (!std::filesystem::exists(root)) GTEST_SKIP() << root << " is not here";
  SceneOptions options;
  options.cameras = {"F_MIDLONGRANGECAM_CL", "B_MIDRANGECAM_C"};
  options.undistort = true;
  const Scene scene = make_scene(open_recording(root), options);
  for (const KnownRay& known : kKnown) {
    SCOPED_TRACE(known.camera);
    const int camera = scene.camera_index(known.camera);
    const RayTable table = make_ray_table(scene.rig[camera].camera);
    ASSERT_EQ(table.pixel.size(), std::size_t(table.width) * table.height);
    const auto view = std::find_if(scene.views.begin(), scene.views.end(), [&](const View& v) {
      return v.camera == camera && scene.frames[v.frame].id == known.frame_id;
    });
    ASSERT_NE(view, scene.views.end());
    RayBatch rays;
    const std::uint32_t entry = known.v * table.width + known.u;
    view_rays(table, scene.world_from_camera(*view), {&entry, 1}, &rays);
    for (int d = 0; d < 3; ++d) {
      // Half a float step at 98 m is 3.8e-6; the files' rotations are orthonormal to 1e-7 and are
      // made exactly so.
      EXPECT_NEAR(rays.origin[d], known.origin_m[d], 5e-6) << d;
      EXPECT_NEAR(rays.direction[d], known.direction[d], 3e-7) << d;
    }
  }
}

}  // namespace
}  // namespace redrive

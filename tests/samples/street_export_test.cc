// SPDX-License-Identifier: Apache-2.0
// The street in other formats of drives, read back: every image has the same rays, every LiDAR
// point is where it was.
#include <algorithm>

#include <gtest/gtest.h>

#include "redrive/base/files/temporary_folder_testing.h"
#include "redrive/export/drive.h"
#include "redrive/recording/core/frame_range.h"
#include "redrive/recording/core/trajectory.h"

namespace redrive {
namespace {

class StreetExport : public ::testing::Test {
 protected:
  StreetExport() { keep_frames({1010, 1021}, &street_); }

  template <class Write>
  void write(const Write& write) {
    notes_ =
        write(folder_.path / "out", drive_of_scene(street_, make_scene(street_, {})), pool_, stop_);
    back_ = open_recording(folder_.path / "out");
    ASSERT_EQ(back_.cameras.size(), 4u);
    ASSERT_EQ(back_.frames.size(), 12u);
  }

  /// Compares an image's pose and, where the lens is the same, every 7th ray.
  void expect_same_camera(const std::string& was, const std::string& now, bool same_lens) {
    const Scene before = make_scene(street_, {}), after = make_scene(back_, {});
    const auto view_of = [](const Scene& scene, const std::string& camera, int frame) {
      return *std::ranges::find_if(scene.views, [&](const View& view) {
        return scene.rig[static_cast<std::size_t>(view.camera)].name == camera &&
               view.frame == frame;
      });
    };
    for (int f = 0; f < 12; ++f) {
      const Rigid3d expected = before.world_from_camera(view_of(before, was, f)),
                    found = after.world_from_camera(view_of(after, now, f));
      EXPECT_LT((expected.translation() - found.translation()).norm(), 1e-6) << now << ' ' << f;
      EXPECT_LT((expected.linear() - found.linear()).norm(), 1e-7) << now << ' ' << f;
    }
    if (!same_lens) return;
    const Camera &from = before.rig[static_cast<std::size_t>(before.camera_index(was))].recorded,
                 &to = after.rig[static_cast<std::size_t>(after.camera_index(now))].recorded;
    for (int y = 0; y < from.height; y += 7)
      for (int x = 0; x < from.width; x += 7) {
        const auto direction = from.unproject({double(x), double(y)});
        if (!direction) continue;
        const auto pixel = to.project(*direction);
        ASSERT_TRUE(pixel) << x << ' ' << y;
        EXPECT_LT((*pixel - Eigen::Vector2d(x, y)).norm(), 1e-4) << x << ' ' << y;
      }
  }

  /// Distances of the points in the world of the first frame, sorted by time as both readers do.
  void expect_same_points(double usual_m, double most_m) {
    ASSERT_EQ(back_.lidar_files.size(), street_.lidar_files.size());
    const auto positions = [](const Recording& recording, std::size_t f) {
      const Rigid3d first = recording.frames[0].global_from_body.inverse();
      std::vector<std::array<double, 3>> all;
      for (const LidarPoint& point : recording.reader->read_lidar(recording.lidar_files[f])) {
        const Eigen::Vector3d p =
            first * (pose_at(recording.frames, point.t_ns) * point.in_body_m.cast<double>());
        all.push_back({p.x(), p.y(), p.z()});
      }
      return all;
    };
    std::size_t beyond = 0, points = 0;
    for (std::size_t f = 0; f < back_.lidar_files.size(); f += 5) {
      const auto now = positions(back_, f);
      auto were = positions(street_, f);
      std::ranges::sort(were);
      ASSERT_GT(now.size(), 1000u);
      for (const auto& p : now) {
        ++points;
        const auto at = [&](const std::array<double, 3>& q) {
          return Eigen::Vector3d(p[0] - q[0], p[1] - q[1], p[2] - q[2]).norm();
        };
        double nearest_m = 1;
        const std::array<double, 3> low = {p[0] - most_m, -1e9, -1e9};
        for (auto q = std::ranges::lower_bound(were, low);
             q != were.end() && (*q)[0] <= p[0] + most_m; ++q)
          nearest_m = std::min(nearest_m, at(*q));
        EXPECT_LT(nearest_m, most_m);
        beyond += nearest_m > usual_m;
      }
    }
    EXPECT_LT(static_cast<double>(beyond), 0.02 * static_cast<double>(points));
  }

  Recording street_ = open_recording(REDRIVE_SAMPLES "/street"), back_;
  TemporaryFolder folder_;
  DriveNotes notes_;
  ThreadPool pool_{2};
  std::atomic<bool> stop_ = false;
};

TEST_F(StreetExport, Aimotive) {
  write(write_aimotive);
  for (const RecordedCamera& camera : street_.cameras)
    expect_same_camera(camera.calibration.name, camera.calibration.name, true);
  expect_same_points(2e-6, 1e-5);
}

TEST_F(StreetExport, Kitti360) {
  write(write_kitti360);
  expect_same_camera("F_MIDLONGRANGECAM_CL", "image_00", false);
  expect_same_camera("F_MIDRANGECAM_C", "image_01", false);
  expect_same_camera("M_FISHEYE_L", "image_02", true);
  expect_same_camera("M_FISHEYE_R", "image_03", true);
  expect_same_points(1e-5, 2e-3);
}

}  // namespace
}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
// Tables and two scans of a real log of Argoverse 2, which has no images; skipped where they are
// missing.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "redrive/base/files/files.h"
#include "redrive/base/files/temporary_folder_testing.h"
#include "redrive/math/angles.h"
#include "redrive/math/plane_fit.h"
#include "redrive/math/upper_median.h"
#include "redrive/recording/core/recording.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/formats/recording_reader.h"
#include "redrive/recording/lidar/lost_rays.h"
#include "redrive/recording/lidar/scan_structure.h"
#include "redrive/recording/parse/arrow_table.h"

namespace redrive {
namespace {

class RealArgoverse2 : public ::testing::Test {
 protected:
  static constexpr std::int64_t kScans_ns[] = {315'966'265'259'836'000, 315'966'265'360'032'000};

  void SetUp() override {
    const std::filesystem::path log =
        REDRIVE_SHARED "/data/argoverse2/7fab2350-7eaf-3b7e-a39d-6937a4c1bede";
    if (!std::filesystem::exists(log)) GTEST_SKIP() << log << " is not here";
    for (const char* name : {"annotations.feather", "city_SE3_egovehicle.feather", "calibration"})
      std::filesystem::create_symlink(log / name, folder_.path / name);
    const std::string cameras = "sensors/cameras/ring_front_center/";
    for (int i = -2; i < 7; ++i)  // in place of images, of which only names and sizes are read here
      folder_.write(cameras + std::to_string(kScans_ns[0] + i * 50'000'000) + ".jpg",
                    std::string(std::size_t(100 * (i + 3)), 'x'));
    std::filesystem::create_symlink(log / "sensors/lidar", folder_.path / "sensors/lidar");
    recording_ = open_recording(folder_.path);
    ASSERT_EQ(recording_.lidar_files.size(), 4u);
    for (const FrameFile& file : recording_.scans_of(0)) {
      scans_.push_back(recording_.reader->read_lidar(file));
      in_world_.emplace_back();
      for (const LidarPoint& point : scans_.back())
        in_world_.back().push_back(pose_at(recording_.frames, point.t_ns) *
                                   point.in_body_m.cast<double>());
    }
  }
  std::vector<Box> boxes_of(std::size_t scan) const {
    const std::int64_t frame = recording_.lidar_files[scan].frame_id;
    return recording_.reader->read_boxes(
        *std::ranges::find(recording_.box_files, frame, &FrameFile::frame_id));
  }

  TemporaryFolder folder_;
  Recording recording_;
  std::vector<std::vector<LidarPoint>> scans_;
  std::vector<std::vector<Eigen::Vector3d>> in_world_;  ///< points of scans_, along the poses
};

TEST_F(RealArgoverse2, ReadsWhatThereIs) {
  const std::vector<FrameFile> down = recording_.scans_of(1);
  EXPECT_EQ(scans_[0].size() + recording_.reader->read_lidar(down[0]).size(), 99'229u);
  EXPECT_EQ(scans_[1].size() + recording_.reader->read_lidar(down[1]).size(), 99'466u);
  EXPECT_EQ(recording_.reader->lidar_point_count(recording_.lidar_files[0]), 99'229u);
  const CameraCalibration& front = recording_.cameras.at(0).calibration;
  EXPECT_EQ(front.width, 1550);
  EXPECT_NEAR(front.parameters[0], 1776.04, 0.01);
  EXPECT_NEAR(front.body_from_sensor.translation().z(), 1.73, 0.01);
  EXPECT_NEAR(front.body_from_sensor.linear()(0, 2), 1, 1e-3) << "looks ahead";
  std::vector<double> heights;
  for (const LidarPoint& point : scans_[0])
    if (std::abs(point.in_body_m.x()) < 3 && std::abs(point.in_body_m.y() - 3) < 1)
      heights.push_back(point.in_body_m.z());
  ASSERT_GT(heights.size(), 100u);
  EXPECT_NEAR(upper_median(heights), 0, 0.03) << "the road";
}

TEST_F(RealArgoverse2, BeamsHaveTheirElevationsAtTheirOwnTimes) {
  for (std::size_t k = 0; k < 2; ++k) {
    std::vector<std::vector<LidarPoint>> scans;
    for (const FrameFile& file : recording_.scans_of(k))
      scans.push_back(recording_.reader->read_lidar(file));
    std::string why;
    const Rigid3d& body_from_lidar = recording_.lidars[k].body_from_lidar;
    const auto structure = estimate_structure(scans, body_from_lidar, &why);
    ASSERT_TRUE(structure) << why;
    EXPECT_EQ(structure->sensor.beams.size(), 32u) << k;
    EXPECT_NEAR(structure->sensor.rate_hz, 10, 0.05) << k;
    EXPECT_LT(structure->residual_rad, 0.01 * kRadiansPerDegree)
        << "0.05 degrees where the file's motion compensation stays, more from the other's place";
    EXPECT_FALSE(misfit(*structure)) << k;
    const LostRays lost = lost_rays(scans[0], body_from_lidar, *structure, &why);
    EXPECT_GT(lost.size(), 1000u) << why;
  }
}

TEST_F(RealArgoverse2, ScansLieOnEachOther) {
  // Planes of half a metre that the first scan shows, and returns of the second one in them.
  std::map<std::array<long, 3>, PlaneSums> cells;
  const auto cell_of = [](const Eigen::Vector3d& p) {
    return std::array{std::lround(2 * p.x()), std::lround(2 * p.y()), std::lround(2 * p.z())};
  };
  for (const Eigen::Vector3d& p : in_world_[0]) cells[cell_of(p)].add(p);
  const auto median_m = [&](const auto& place) {
    std::vector<double> distances;
    for (std::size_t i = 0; i < scans_[1].size(); ++i) {
      if (scans_[1][i].in_body_m.norm() > 30) continue;
      const Eigen::Vector3d p = place(i);
      const auto cell = cells.find(cell_of(p));
      if (cell == cells.end() || cell->second.n() < 12) continue;
      const PlaneFit plane = cell->second.fit();
      // Walls and the like alone: the road lies on itself wherever the car is.
      if (plane.thickness() > 0.03 || plane.extent()[1] < 0.08 ||
          std::abs(plane.normal().z()) > 0.5)
        continue;
      distances.push_back(std::abs(plane.normal().dot(p - plane.mean)));
    }
    EXPECT_GT(distances.size(), 1000u);
    return upper_median(distances);
  };
  const double along_m = median_m([&](std::size_t i) { return in_world_[1][i]; });
  // Places as if the car stood still between the scans.
  const Rigid3d before_from_now =
      pose_at(recording_.frames, kScans_ns[0]) * pose_at(recording_.frames, kScans_ns[1]).inverse();
  const double still_m =
      median_m([&](std::size_t i) -> Eigen::Vector3d { return before_from_now * in_world_[1][i]; });
  EXPECT_LT(along_m, 0.02) << "metres, median from planes along the poses";
  EXPECT_GT(still_m, 2 * along_m);
}

TEST_F(RealArgoverse2, BoxesHaveTheirReturns) {
  const std::filesystem::path file = folder_.path / "annotations.feather";
  const std::string bytes = read_file(file);
  const ArrowTable table(bytes, file);
  const auto times_ns = table.integers("timestamp_ns"), counts = table.integers("num_interior_pts");
  for (std::size_t s = 0; s < 2; ++s) {
    std::vector<Eigen::Vector3d> of_both = in_world_[s];
    for (const LidarPoint& point : recording_.reader->read_lidar(recording_.scans_of(1)[s]))
      of_both.push_back(pose_at(recording_.frames, point.t_ns) * point.in_body_m.cast<double>());
    std::vector<std::int64_t> found, annotated;
    for (std::size_t i = 0; i < table.rows(); ++i)
      if (times_ns[i] == kScans_ns[s]) annotated.push_back(counts[i]);
    for (const Box& box : boxes_of(s)) {
      const Rigid3d box_from_world =
          (pose_at(recording_.frames, box.t_ns) * box.body_from_box).inverse();
      found.push_back(std::ranges::count_if(of_both, [&](const Eigen::Vector3d& p) {
        return ((box_from_world * p).cwiseAbs().array() <= box.size_m.array() / 2).all();
      }));
    }
    ASSERT_EQ(found.size(), annotated.size());
    EXPECT_GT(found.size(), 80u);
    std::ranges::sort(found);
    std::ranges::sort(annotated);
    for (std::size_t i = 0; i < found.size(); ++i)
      EXPECT_NEAR(double(found[i]), double(annotated[i]), 2 + 0.02 * double(annotated[i]));
  }
}

TEST_F(RealArgoverse2, ReturnsOfMovingObjectsStayInTheirBoxes) {
  std::map<std::int64_t, Box> later;
  for (const Box& box : boxes_of(1)) later[box.object_id] = box;
  std::size_t objects = 0, all = 0, stayed = 0;
  for (const Box& box : boxes_of(0)) {
    const auto other = later.find(box.object_id);
    if (other == later.end()) continue;
    const Rigid3d body = pose_at(recording_.frames, box.t_ns),
                  then = pose_at(recording_.frames, other->second.t_ns);
    const Eigen::Vector3d velocity =
        body.linear() * box.velocity_in_body_m_per_s + velocity_at(recording_.frames, box.t_ns);
    if (velocity.norm() < 3) continue;
    const Rigid3d box_from_world = (body * box.body_from_box).inverse(),
                  later_from_world = (then * other->second.body_from_box).inverse();
    // Half a revolution at the object's speed, by which both LiDARs see it apart.
    const double margin_m = 0.025 * velocity.norm() + 0.1;
    std::size_t of_object = 0;
    for (std::size_t i = 0; i < scans_[0].size(); ++i) {
      const auto moved = [&](std::int64_t t_ns) -> Eigen::Vector3d {
        return in_world_[0][i] + 1e-9 * double(t_ns - scans_[0][i].t_ns) * velocity;
      };
      const Eigen::Vector3d here = box_from_world * moved(box.t_ns),
                            there = later_from_world * moved(other->second.t_ns);
      const Eigen::Array3d half = box.size_m.array() / 2;
      if ((here.cwiseAbs().array() > half).any() || here.z() < 0.2 - half.z()) continue;
      ++of_object;
      stayed += (there.cwiseAbs().array() <= half + margin_m).all();
    }
    all += of_object;
    objects += of_object > 20;
  }
  EXPECT_GE(objects, 4u);
  EXPECT_GE(stayed, 0.97 * double(all)) << stayed << " of " << all;
}

}  // namespace
}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
// A drive as a log of Argoverse 2, read back.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <map>
#include <set>

#include "redrive/base/files/files.h"
#include "redrive/export/argoverse2/argoverse2_terms.h"
#include "redrive/export/made_drive_testing.h"
#include "redrive/image/image_io.h"
#include "redrive/recording/core/lidar_sensor.h"
#include "redrive/recording/parse/arrow_table.h"

namespace redrive {
namespace {

using ::testing::AllOf;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;

class WriteArgoverse2 : public MadeDrive {
 protected:
  WriteArgoverse2() {
    recording_.cameras[1].calibration.parameters = {22, 20, 11.5, 7.5, 0, 0, 0, 0, 0};
  }
  Recording written() {
    notes_ = write_argoverse2(out_, drive(), pool_, stop_);
    return open_recording(out_);
  }
  /// Times count from 10 s before the first frame.
  std::int64_t later_ns() const { return 10'000'000'000 - recording_.frames[0].t_ns; }
  /// The pose of the first frame is the city's origin.
  Rigid3d city_from_global() const { return recording_.frames[0].global_from_body.inverse(); }
  Rigid3d city_from_body(std::int64_t t_ns) const {
    return city_from_global() * pose_at(recording_.frames, t_ns);
  }
};

TEST_F(WriteArgoverse2, ComesBack) {
  const Recording now = written();
  EXPECT_EQ(now.format, "argoverse2");
  EXPECT_TRUE(now.findings.empty()) << now.findings[0].subject << ": " << now.findings[0].what;
  EXPECT_TRUE(now.damaged.empty());
  ASSERT_EQ(now.cameras.size(), 2u);
  const Scene scene = make_scene(now, {}), before = make_scene(recording_, {});
  ASSERT_EQ(scene.views.size(), before.views.size());
  for (const View& view : scene.views) {
    const std::size_t was = scene.rig[view.camera].camera.fx == 22 ? 1 : 0;
    const std::int64_t t_ns = scene.frames[view.frame].t_ns + scene.rig[view.camera].time_offset_ns;
    const Rigid3d expected =
        city_from_body(t_ns - later_ns()) * recording_.cameras[was].calibration.body_from_sensor;
    const Rigid3d found = scene.global_from_world * scene.world_from_camera(view);
    EXPECT_LT((found.translation() - expected.translation()).norm(), 1e-6);
    EXPECT_LT((found.linear() - expected.linear()).norm(), 1e-6);
  }
  for (const RecordedCamera& camera : now.cameras) {
    EXPECT_EQ(camera.calibration.model, "opencv_pinhole");
    EXPECT_EQ(camera.images[0].path.extension(), ".jpg");
    EXPECT_EQ(read_image(camera.images[0].path).width, camera.calibration.width);
  }
  EXPECT_THAT(notes_.changed, Contains(HasSubstr("resampled to a pinhole")));
  EXPECT_THAT(notes_.changed, Contains(HasSubstr("become JPEG")));
}

TEST_F(WriteArgoverse2, JpegsAreCopied) {
  for (ImageFile& image : recording_.cameras[1].images) {
    const std::filesystem::path jpeg = std::filesystem::path(image.path).replace_extension(".jpg");
    write_image(jpeg, read_image(image.path));
    image.path = jpeg;
  }
  const Recording now = written();
  const auto pinhole = std::ranges::find_if(
      now.cameras, [&](const RecordedCamera& camera) { return camera.calibration.fx() == 22; });
  ASSERT_NE(pinhole, now.cameras.end());
  EXPECT_EQ(read_file(pinhole->images[3].path), read_file(recording_.cameras[1].images[3].path));
}

TEST_F(WriteArgoverse2, PointsKeepTimeAndPlace) {
  const Recording now = written();
  ASSERT_EQ(now.lidars.size(), 1u);
  EXPECT_EQ(now.lidars[0].name, "up_lidar");
  EXPECT_TRUE(now.lidars[0].body_from_lidar.isApprox(reader_->body_from_lidar, 1e-9));
  ASSERT_EQ(now.lidar_files.size(), 5u);
  for (std::size_t f = 0; f < 5; ++f) {
    const auto points = now.read_lidar(now.lidar_files[f]),
               were = recording_.read_lidar(recording_.lidar_files[f]);
    ASSERT_EQ(points.size(), were.size());
    for (std::size_t i = 0; i < points.size(); i += 7) {
      EXPECT_EQ(points[i].t_ns, were[i].t_ns + later_ns());
      EXPECT_LT((points[i].in_body_m - were[i].in_body_m).norm(), 1e-5);
      EXPECT_EQ(points[i].intensity, were[i].intensity);
      EXPECT_EQ(points[i].ring, 0);
    }
  }
}

TEST_F(WriteArgoverse2, BoxesHoldWhenTheLidarPasses) {
  const Recording now = written();
  ASSERT_EQ(now.box_files.size(), 5u);
  const double speed_m_per_s = 20;
  std::map<std::int64_t, int> seen;
  for (const FrameFile& file : now.box_files)
    for (const Box& box : now.reader->read_boxes(file)) {
      const double s = 1e-9 * double(box.t_ns - later_ns() - recording_.frames[0].t_ns);
      const Eigen::Vector3d in_city =
          (pose_at(now.frames, box.t_ns) * box.body_from_box).translation();
      EXPECT_EQ(box.size_m, Eigen::Vector3d(4, 2, 1.5));
      EXPECT_NEAR(in_city.z(), 0.75, 1e-5);
      EXPECT_EQ(box.type, std::abs(in_city.y() - 9) < 0.1 ? "PEDESTRIAN" : "REGULAR_VEHICLE");
      // The overtaking car is where it is then; 0.1 s beside it would be 2 m.
      const double moved_m = std::abs(in_city.y() - 7) < 0.1 ? speed_m_per_s * s : 0;
      EXPECT_NEAR(in_city.x(), 10 + moved_m, moved_m == 0 ? 1e-5 : 0.1);
      ++seen[box.object_id];
    }
  EXPECT_EQ(seen.size(), 3u);
  for (const auto& [id, n] : seen) EXPECT_EQ(n, 5) << id;
  EXPECT_THAT(notes_.changed, Contains(HasSubstr("CAR is REGULAR_VEHICLE, Pedestrian is PEDES")));
}

TEST_F(WriteArgoverse2, CountsTheReturnsOnObjects) {
  const auto reader = std::make_shared<OnObjects>();
  reader->frames = recording_.frames;
  recording_.reader = reader;
  written();
  const std::filesystem::path file = out_ / "annotations.feather";
  const std::string bytes = read_file(file);
  std::vector<std::int64_t> counts = ArrowTable(bytes, file).integers("num_interior_pts");
  counts.resize(3);
  EXPECT_THAT(counts, ElementsAre(7 + 8, 8 + 9, 9));
}

TEST_F(WriteArgoverse2, WithoutScansBoxesHoldAtTheirFrames) {
  recording_.lidar_files.clear();
  const Recording now = written();
  ASSERT_EQ(now.box_files.size(), 5u);
  for (std::size_t f = 0; f < 5; ++f)
    for (const Box& box : now.reader->read_boxes(now.box_files[f])) {
      EXPECT_EQ(box.t_ns, recording_.frames[f].t_ns + later_ns());
      const double s = 1e-9 * double(recording_.frames[f].t_ns - recording_.frames[0].t_ns);
      const Eigen::Vector3d in_city =
          (pose_at(now.frames, box.t_ns) * box.body_from_box).translation();
      EXPECT_NEAR(in_city.x(), std::abs(in_city.y() - 7) < 0.1 ? 10 + 20 * s : 10, 1e-5);
    }
}

/// Spinning LiDARs of `beams` beams, 10 Hz.
class Beams : public MadeReader {
 public:
  std::vector<int> beams;  ///< numbers of beams of the LiDARs
  std::vector<LidarPoint> read_lidar(const FrameFile& file, std::size_t* = nullptr) const override {
    const FramePose& frame = *std::ranges::find(frames, file.frame_id, &FramePose::id);
    std::vector<LidarPoint> points;
    const int n = beams.at(file.lidar), steps = 60;
    for (int step = 0; step < steps; ++step)
      for (int beam = 0; beam < n; ++beam) {
        const Eigen::Vector3d direction =
            beam_direction(0.4 * beam / n - 0.3, -2 * std::numbers::pi * step / steps);
        LidarPoint point;
        point.in_body_m = (body_from_lidar * Eigen::Vector3d(20 * direction)).cast<float>();
        point.intensity = 100;
        point.t_ns = frame.t_ns - 50'000'000 + 100'000'000 * step / steps;
        points.push_back(point);
      }
    return points;
  }
};

class WriteLasers : public WriteArgoverse2 {
 protected:
  /// Returns which lasers each sweep has.
  std::set<std::int64_t> lasers_of(const std::vector<int>& beams) {
    const auto reader = std::make_shared<Beams>();
    reader->frames = recording_.frames;
    reader->beams = beams;
    recording_.reader = reader;
    recording_.lidars.clear();
    recording_.lidar_files.clear();
    for (std::size_t k = 0; k < beams.size(); ++k) {
      recording_.lidars.push_back({"lidar" + std::to_string(k), reader->body_from_lidar});
      for (const FramePose& frame : recording_.frames)
        recording_.lidar_files.push_back({frame.id, "made" + std::to_string(k), k});
    }
    now_ = written();
    std::set<std::int64_t> lasers;
    for (const auto& entry : std::filesystem::directory_iterator(out_ / "sensors/lidar")) {
      const std::string bytes = read_file(entry.path());
      for (const std::int64_t laser : ArrowTable(bytes, entry.path()).integers("laser_number"))
        lasers.insert(laser);
    }
    return lasers;
  }
  std::size_t points_of(std::size_t lidar) const {
    return now_.read_lidar(now_.scans_of(lidar)[0]).size();
  }
  Recording now_;
};

TEST_F(WriteLasers, OfUpTo32BeamsAreOneLidar) {
  EXPECT_EQ(lasers_of({32}).size(), 32u);
  ASSERT_EQ(now_.lidars.size(), 1u);
  EXPECT_EQ(points_of(0), 32u * 60);
}

TEST_F(WriteLasers, OfTwoLidarsAreBoth) {
  const std::set<std::int64_t> lasers = lasers_of({32, 20, 16});
  EXPECT_EQ(*lasers.rbegin(), 32 + 19);
  ASSERT_EQ(now_.lidars.size(), 2u);
  EXPECT_EQ(points_of(1), 20u * 60);
  EXPECT_THAT(notes_.left_out, Contains(HasSubstr("LiDAR lidar2: the format has two")));
}

TEST_F(WriteLasers, Of64BeamsAreBothAtOnePlace) {
  EXPECT_EQ(lasers_of({64, 16}).size(), 64u);
  ASSERT_EQ(now_.lidars.size(), 2u);
  EXPECT_TRUE(now_.lidars[0].body_from_lidar.isApprox(now_.lidars[1].body_from_lidar));
  EXPECT_EQ(points_of(0) + points_of(1), 64u * 60);
  EXPECT_THAT(notes_.changed, Contains(AllOf(HasSubstr("lidar0 of 64 beams is up_lidar and"),
                                             Not(HasSubstr("share")))));
  EXPECT_THAT(notes_.left_out, Contains(HasSubstr("LiDAR lidar1: the format has two")));
}

TEST_F(WriteLasers, OfMoreBeamsShareNumbers) {
  EXPECT_EQ(lasers_of({128}).size(), 64u);
  EXPECT_EQ(points_of(0) + points_of(1), 128u * 60);
  EXPECT_THAT(notes_.changed, Contains(HasSubstr("of 128 beams is up_lidar and down_lidar, at one "
                                                 "place; beams share the 64 laser numbers")));
}

TEST(Argoverse2Terms, CategoriesOfOtherDataSets) {
  for (const auto& [type, category] :
       std::map<std::string, std::string>{{"CAR", "REGULAR_VEHICLE"},
                                          {"Van", "REGULAR_VEHICLE"},
                                          {"vehicle.car", "REGULAR_VEHICLE"},
                                          {"Pickup Truck", "REGULAR_VEHICLE"},
                                          {"BOX_TRUCK", "BOX_TRUCK"},
                                          {"vehicle.truck", "TRUCK"},
                                          {"vehicle.bus.bendy", "ARTICULATED_BUS"},
                                          {"vehicle.trailer", "VEHICULAR_TRAILER"},
                                          {"Cyclist", "BICYCLIST"},
                                          {"vehicle.bicycle", "BICYCLE"},
                                          {"vehicle.motorcycle", "MOTORCYCLE"},
                                          {"Motorcyclist", "MOTORCYCLIST"},
                                          {"Motorcycle with rider", "MOTORCYCLIST"},
                                          {"Personal Mobility Device", "WHEELED_DEVICE"},
                                          {"Construction Signs", "SIGN"},
                                          {"Person_sitting", "PEDESTRIAN"},
                                          {"human.pedestrian.adult", "PEDESTRIAN"},
                                          {"Tram", "RAILED_VEHICLE"},
                                          {"movable_object.trafficcone", "CONSTRUCTION_CONE"},
                                          {"Carriage", "Carriage"}})
    EXPECT_EQ(argoverse2::category_of(type), category) << type;
}

TEST(Argoverse2Terms, TracksAreUuids) {
  EXPECT_EQ(argoverse2::track_uuid(26), "00000000-0000-4000-8000-00000000001a");
  EXPECT_NE(argoverse2::track_uuid(-1), argoverse2::track_uuid(0xffff'ffff'ffff));
}

}  // namespace
}  // namespace redrive

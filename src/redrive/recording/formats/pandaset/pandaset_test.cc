// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/pandaset/pandaset.h"

#include "redrive/camera/camera.h"
#include "redrive/recording/core/actor_kind.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/formats/damaged_records.h"
#include "redrive/recording/formats/pandaset/pandaset_testing.h"
#include "redrive/recording/formats/recording_reader.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::Contains;
using ::testing::Field;
using ::testing::HasSubstr;
using testing::input_error;
using testing::PandaSetDrive;

class PandaSet : public ::testing::Test {
 protected:
  PandaSet() { drive_.write(folder_); }

  Recording opened() const { return open_recording(folder_.path); }
  void write(const std::string& file, const nlohmann::json& json) const {
    folder_.write(file, json.dump());
  }
  static auto says(const std::string& subject, const std::string& what) {
    return Contains(
        AllOf(Field(&Finding::subject, subject), Field(&Finding::what, HasSubstr(what))));
  }
  static auto damaged(const std::string& sensor, const std::string& why) {
    return Contains(
        AllOf(Field(&DamagedRecord::sensor, sensor), Field(&DamagedRecord::why, HasSubstr(why))));
  }
  /// Points of the Pandar64 in the world, at the poses of the recording.
  static std::vector<Eigen::Vector3d> in_world(const Recording& recording, std::size_t scan) {
    std::vector<Eigen::Vector3d> points;
    for (const LidarPoint& point : recording.reader->read_lidar(recording.lidar_files[scan]))
      points.push_back(pose_at(recording.frames, point.t_ns) * point.in_body_m.cast<double>());
    return points;
  }

  TemporaryFolder folder_;
  PandaSetDrive drive_;
};

TEST_F(PandaSet, ReadsFramesAndCameras) {
  const Recording recording = opened();
  EXPECT_EQ(recording.format, "pandaset");
  ASSERT_EQ(recording.frames.size(), 4u);
  ASSERT_EQ(recording.cameras.size(), 6u);
  EXPECT_EQ(recording.frames[2].t_ns, PandaSetDrive::t_ns(2));
  for (const FramePose& frame : recording.frames)
    EXPECT_TRUE(frame.global_from_body.isApprox(PandaSetDrive::world_from_body(frame.t_ns), 1e-9));
  EXPECT_TRUE(recording.lidars[0].body_from_lidar.isApprox(PandaSetDrive::body_from_lidar(), 1e-9));
  for (const RecordedCamera& camera : recording.cameras) {
    const CameraCalibration& calibration = camera.calibration;
    EXPECT_EQ(camera.images.size(), 4u);
    EXPECT_EQ(calibration.width, 192);
    EXPECT_EQ(calibration.fy(), 194.25);
    EXPECT_EQ(calibration.time_offset_ns, drive_.offsets_ns.at(calibration.name));
  }
  EXPECT_THAT(recording.findings,
              says("annotations/semseg", "not used: classes of the points of 1 scan"));
}

TEST_F(PandaSet, RaysAreTheImages) {
  const Recording recording = opened();
  for (const RecordedCamera& recorded : recording.cameras) {
    const CameraCalibration& calibration = recorded.calibration;
    const Camera camera = make_camera(calibration);
    for (const FramePose& frame : recording.frames) {
      const std::int64_t t_ns = frame.t_ns + calibration.time_offset_ns;
      const Rigid3d truth = PandaSetDrive::world_from_body(t_ns) *
                            drive_.body_from_camera.at(calibration.name),
                    read = pose_at(recording.frames, t_ns) * calibration.body_from_sensor;
      for (const Eigen::Vector3d& in_camera :
           {Eigen::Vector3d(0, 0, 5), Eigen::Vector3d(2, 1, 5), Eigen::Vector3d(-12, 5, 30)}) {
        const auto expected = camera.project(in_camera),
                   found = camera.project(read.inverse() * (truth * in_camera));
        ASSERT_TRUE(expected && found);
        EXPECT_LT((*expected - *found).norm(), 1e-4) << calibration.name << frame.id;
      }
    }
  }
}

TEST_F(PandaSet, PointsLieInTheWorldWhereTheFileHasThem) {
  const Recording recording = opened();
  ASSERT_EQ(recording.lidars.size(), 2u);
  ASSERT_EQ(recording.lidar_files.size(), 8u);
  EXPECT_GE(recording.reader->lidar_point_count(recording.lidar_files[1]), 40u);
  for (std::size_t f = 0; f < 8; ++f) {
    std::vector<PandaSetDrive::Point> truth = PandaSetDrive::points(int(f % 4));
    const auto lidar = static_cast<std::int64_t>(recording.lidar_files[f].lidar);
    EXPECT_EQ(lidar, std::int64_t(f / 4));
    std::erase_if(truth, [&](const auto& point) { return point.sensor != lidar; });
    ASSERT_FALSE(truth.empty());
    std::ranges::sort(truth, {}, &PandaSetDrive::Point::t_ns);
    const std::vector<LidarPoint> points = recording.reader->read_lidar(recording.lidar_files[f]);
    const std::vector<Eigen::Vector3d> placed = in_world(recording, f);
    ASSERT_EQ(points.size(), truth.size());
    for (std::size_t i = 0; i < points.size(); ++i) {
      EXPECT_EQ(points[i].t_ns, truth[i].t_ns);
      EXPECT_EQ(points[i].intensity, truth[i].intensity);
      EXPECT_LT((placed[i] - truth[i].in_world).norm(), 1e-6);
    }
  }
}

TEST_F(PandaSet, SiblingsAreOneObject) {
  const Recording recording = opened();
  ASSERT_EQ(recording.box_files.size(), 4u);
  for (std::size_t f = 0; f < 4; ++f) {
    const std::vector<Box> boxes = recording.reader->read_boxes(recording.box_files[f]);
    ASSERT_EQ(boxes.size(), 3u) << f;
    for (const Box& box : boxes) {
      const Rigid3d in_world = pose_at(recording.frames, box.t_ns) * box.body_from_box;
      const Eigen::Vector3d velocity =
          pose_at(recording.frames, box.t_ns).linear() * box.velocity_in_body_m_per_s +
          velocity_at(recording.frames, box.t_ns);
      if (box.type == "Car") {
        EXPECT_NEAR(in_world.translation().y(), 20 + 0.5 * double(f) + (f == 3 ? 0.1 : 0), 1e-6);
        EXPECT_TRUE(box.size_m.isApprox(Eigen::Vector3d(4.2, 1.8, 1.5)));
        EXPECT_TRUE(in_world.linear().col(0).isApprox(Eigen::Vector3d::UnitY(), 1e-9));
        EXPECT_NEAR(velocity.y(), 4, 1.5) << "its boxes hold at the laser's times";
      } else {
        EXPECT_LT(velocity.norm(), 1e-6) << box.type;
      }
      EXPECT_STREQ(kind_of(box.type).name, box.type.starts_with("Bicycle") ? "person" : "vehicle");
    }
  }
}

TEST(PandaSetLabels, LiveOrDoNot) {
  for (const char* label : {"Pedestrian with Object", "Animals - Bird", "Motorcycle with rider"})
    EXPECT_STREQ(kind_of(label).name, "person") << label;
  for (const char* label : {"Semi-truck", "Other Vehicle - Pedicab", "Motorcycle"})
    EXPECT_STREQ(kind_of(label).name, "vehicle") << label;
}

TEST_F(PandaSet, AnExcerptMayHaveLittle) {
  for (const char* camera : {"back_camera", "left_camera", "right_camera", "front_left_camera"})
    fs::remove_all(folder_.path / "camera" / camera);
  fs::remove_all(folder_.path / "annotations");
  fs::remove(folder_.path / "lidar/02.pkl.gz");
  fs::remove(folder_.path / "lidar/poses.json");
  const Recording recording = opened();
  EXPECT_EQ(recording.cameras.size(), 2u);
  EXPECT_THAT(recording.findings, says("cameras", "4 cameras of PandaSet without a folder"));
  EXPECT_THAT(recording.findings, says("lidar", "no scan of 1 frame with images: 2"));
  EXPECT_THAT(recording.findings, says("lidar/poses.json", "missing"));
  EXPECT_TRUE(recording.frames[1].global_from_body.isApprox(
      PandaSetDrive::world_from_body(PandaSetDrive::t_ns(1)), 1e-9))
      << "places are the published ones";
  fs::remove_all(folder_.path / "camera/front_camera");
  EXPECT_EQ(opened().frames.size(), 4u) << "of the camera that is left";
}

TEST_F(PandaSet, AnEntryThatCannotBeCostsItself) {
  nlohmann::json poses = drive_.poses_of("front_camera"), times = drive_.times_of("left_camera");
  poses[1]["heading"] = {{"w", 0}, {"x", 0}, {"y", 0}, {"z", 0}};
  times[2] = double(times[2]) + 0.0625;
  write("camera/front_camera/poses.json", poses);
  write("camera/left_camera/timestamps.json", times);
  poses = drive_.poses_of("right_camera");
  poses[0]["position"]["x"] = 500;
  write("camera/right_camera/poses.json", poses);
  const Recording recording = opened();
  ASSERT_EQ(recording.frames.size(), 3u);
  EXPECT_THAT(recording.damaged, damaged("poses of front_camera", "[1].heading"));
  EXPECT_THAT(recording.damaged, damaged("times of left_camera", "[2] = 0.093750 s after"));
  EXPECT_EQ(recording.find_camera("left_camera")->images.size(), 2u);
  EXPECT_THAT(recording.damaged,
              damaged("poses of right_camera", "so far from the camera's place"));
  EXPECT_EQ(recording.find_camera("right_camera")->images.size(), 2u);
}

TEST_F(PandaSet, FewerPosesThanImages) {
  nlohmann::json poses = drive_.poses_of("front_camera");
  poses.erase(3);
  write("camera/front_camera/poses.json", poses);
  const Recording recording = opened();
  EXPECT_EQ(recording.frames.size(), 3u);
  EXPECT_THAT(recording.findings, says("front_camera", "no pose for frame 3"));
}

TEST_F(PandaSet, TimesThatRunBackwardsAreNamed) {
  nlohmann::json times = drive_.times_of("front_camera");
  std::swap(times[1], times[2]);
  write("camera/front_camera/timestamps.json", times);
  EXPECT_THAT(opened().damaged,
              Contains(Field(&DamagedRecord::why, HasSubstr("timestamps.json: [2] = "))));
}

TEST_F(PandaSet, NamesFileFieldAndValue) {
  const auto message = [&](const std::string& file, const std::string& text) {
    folder_.write(file, text);
    const std::string error = input_error([&] { opened(); });
    drive_.write(folder_);
    return error;
  };
  const std::string front = "camera/front_camera/";
  EXPECT_THAT(message(front + "intrinsics.json", R"({"fx": -1, "fy": 1, "cx": 0, "cy": 0})"),
              AllOf(HasSubstr("intrinsics.json: fx = -1")));
  EXPECT_THAT(message(front + "timestamps.json", "{}"), HasSubstr("must be a list of times"));
  EXPECT_THAT(message(front + "poses.json", "[]"), HasSubstr("has no pose with a time"));
  EXPECT_THAT(message("lidar/poses.json", "3"), HasSubstr("must be a list of poses"));
}

TEST_F(PandaSet, ScansCountWhatCannotBe) {
  std::vector<PandaSetDrive::Point> points = PandaSetDrive::points(1);
  points[0].in_world.x() = std::nan("");
  points[1].intensity = 300;
  PandaSetDrive::write_scan(folder_, 1, points);
  const Recording recording = opened();
  std::size_t left_out = 0;
  EXPECT_EQ(recording.reader->read_lidar(recording.lidar_files[1], &left_out).size(), 30u);
  EXPECT_EQ(left_out, 2u);
  points[2].in_world.y() = 1e5;
  PandaSetDrive::write_scan(folder_, 1, points);
  EXPECT_THAT(input_error([&] { in_world(recording, 1); }),
              AllOf(HasSubstr("01.pkl.gz: row 1 i = 300"), HasSubstr("0 to 255")));
  folder_.write("lidar/01.pkl.gz", "no gzip");
  EXPECT_THAT(input_error([&] { in_world(recording, 1); }), HasSubstr("no whole gzip file"));
}

TEST_F(PandaSet, ACuboidThatCannotBeCostsItself) {
  std::vector<PandaSetDrive::Row> rows = drive_.rows(1);
  rows[2].size.y() = 0;
  rows[3].label = "Spaceship";
  PandaSetDrive::write_rows(folder_, 1, rows);
  folder_.write("annotations/cuboids/02.pkl.gz", "no gzip");
  Recording recording = opened();
  EXPECT_EQ(recording.reader->read_boxes(recording.box_files[1]).size(), 2u);
  EXPECT_THAT(input_error([&] { recording.reader->read_boxes(recording.box_files[2]); }),
              HasSubstr("02.pkl.gz: is no whole gzip file"));
  require_few_damaged({}, &recording);
  EXPECT_EQ(recording.box_files.size(), 3u);
  EXPECT_THAT(recording.findings, says("boxes",
                                       "1 cuboid without a size, a place or a name, left out: "
                                       "01.pkl.gz row 2: dimensions.y = 0"));
  EXPECT_THAT(recording.findings, says("boxes", "does not list, taken for vehicles: Spaceship"));
}

}  // namespace
}  // namespace redrive

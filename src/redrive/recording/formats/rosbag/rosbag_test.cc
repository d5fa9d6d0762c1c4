// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/rosbag/rosbag.h"

#include "redrive/camera/camera.h"
#include "redrive/image/image_io.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/formats/damaged_records.h"
#include "redrive/recording/formats/recording_reader.h"
#include "redrive/recording/formats/rosbag/rosbag_testing.h"

namespace redrive::rosbag {
namespace {

using ::testing::AllOf;
using testing::CdrWriter;
using ::testing::Contains;
using ::testing::Field;
using ::testing::HasSubstr;
using testing::input_error;
using testing::McapWriter;
using testing::RosDrive;

auto says(const std::string& subject, const std::string& what) {
  return Contains(
      AllOf(Field(&Finding::subject, HasSubstr(subject)), Field(&Finding::what, HasSubstr(what))));
}

Recording opened(const TemporaryFolder& folder, const RosDrive& drive) {
  folder.write("drive_0.mcap", drive.mcap());
  return open_recording(folder.path);
}

/// Expects rays, returns and times of the drive. `global_from_world` where the bag's poses are in
/// another frame.
void expect_drive(const Recording& recording, const std::string& what) {
  ASSERT_EQ(recording.frames.size(), 10u) << what;
  ASSERT_EQ(recording.cameras.size(), 3u) << what;
  for (const RecordedCamera& recorded : recording.cameras) {
    const CameraCalibration& calibration = recorded.calibration;
    EXPECT_EQ(recorded.images.size(), 10u) << what;
    EXPECT_EQ(calibration.time_offset_ns,
              RosDrive::offset_ns(calibration.name) - RosDrive::offset_ns("front"))
        << what << calibration.name;
    const Camera camera = make_camera(calibration);
    for (const FramePose& frame : recording.frames) {
      const std::int64_t t_ns =
          RosDrive::t_ns(int(frame.id)) + RosDrive::offset_ns(calibration.name);
      const Rigid3d truth = RosDrive::world_from_body(t_ns) * RosDrive::place(calibration.name),
                    read = pose_at(recording.frames, frame.t_ns + calibration.time_offset_ns) *
                           calibration.body_from_sensor;
      for (const Eigen::Vector3d& in_camera :
           {Eigen::Vector3d(0, 0, 5), Eigen::Vector3d(1, 0.7, 5), Eigen::Vector3d(-6, 5, 30)}) {
        const auto expected = camera.project(in_camera),
                   found = camera.project(read.inverse() * (truth * in_camera));
        ASSERT_TRUE(expected && found) << what;
        EXPECT_LT((*expected - *found).norm(), 1e-4) << what << calibration.name << frame.id;
      }
    }
  }
  ASSERT_EQ(recording.lidar_files.size(), std::size_t(RosDrive::kScans)) << what;
  for (int s = 0; s < RosDrive::kScans; ++s) {
    std::size_t left_out = 0;
    const FrameFile& file = recording.lidar_files[std::size_t(s)];
    const std::vector<LidarPoint> points = recording.read_lidar(file, &left_out);
    EXPECT_EQ(left_out, 1u) << what;
    EXPECT_EQ(recording.reader->lidar_point_count(file), 90u) << what;
    ASSERT_EQ(points.size(), 89u) << what;
    std::size_t next = 0;
    for (int i = 0; i < RosDrive::kPoints; ++i) {
      if (i == RosDrive::kWithoutReturn * 7 % RosDrive::kPoints) continue;
      const LidarPoint& point = points[next++];
      EXPECT_NEAR(double(point.t_ns - RosDrive::point_ns(s, i)), 0, 300) << what << i;
      EXPECT_EQ(point.intensity, 2 * i) << what;
      EXPECT_EQ(point.ring, i % RosDrive::kBeams) << what;
      const std::int64_t t_ns = RosDrive::point_ns(s, i);
      const Eigen::Vector3d truth =
          RosDrive::world_from_body(t_ns) * RosDrive::place("lidar") * RosDrive::point(s, i);
      EXPECT_LT((pose_at(recording.frames, t_ns) * point.in_body_m.cast<double>() - truth).norm(),
                1.5e-6)
          << what << i;
    }
  }
}

TEST(Rosbag, ReadsEachStorage) {
  const RosDrive drive, swapped({.big_endian = true});
  for (const std::string compression : {"", "lz4", "zstd"})
    for (const RosDrive* of : {&drive, &swapped}) {
      const TemporaryFolder folder;
      folder.write("a.mcap", of->mcap({.compression = compression}));
      expect_drive(open_recording(folder.path), compression);
    }
  const TemporaryFolder folder;
  drive.write_sqlite(folder.path / "drive_0.db3");
  expect_drive(open_recording(folder.path), "db3");
}

TEST(Rosbag, JoinsFilesOfABag) {
  const TemporaryFolder folder;
  const RosDrive drive;
  const std::size_t half = drive.messages.size() / 2;
  folder.write("b_1.mcap", drive.mcap({}, 0, half));
  folder.write("b_0.mcap", drive.mcap({.summary = false}, half));
  folder.write("metadata.yaml",
               "rosbag2_bagfile_information:\n  version: 5\n  relative_file_paths:\n"
               "    - b_0.mcap\n    - b_1.mcap\n    - b_2.mcap\n");
  const Recording recording = open_recording(folder.path);
  expect_drive(recording, "files");
  EXPECT_THAT(recording.findings, says("metadata.yaml", "b_2.mcap"));
  EXPECT_THAT(recording.findings, says("b_0.mcap", "no summary"));
}

TEST(Rosbag, ReadsEachKindOfPoses) {
  const RosDrive::Options kinds[] = {{.tf = false, .odometry = true},
                                     {.tf = false, .pose_stamped = true}};
  for (const RosDrive::Options& kind : kinds) {
    const TemporaryFolder folder;
    expect_drive(opened(folder, RosDrive(kind)), kind.odometry ? "odometry" : "poses");
  }
}

TEST(Rosbag, ReadsFixesWithAnImu) {
  const TemporaryFolder folder;
  const Recording recording = opened(folder, RosDrive({.tf = false, .fixes = true}));
  EXPECT_EQ(recording.global_frame, GlobalFrame::kEcef);
  ASSERT_EQ(recording.frames.size(), 10u);
  for (const FramePose& frame : recording.frames) {
    // East, north and up there, in which the Imu's orientation stands.
    const Rigid3d ecef_from_level = ecef_from_enu(RosDrive::fix_at(frame.t_ns)),
                  truth = ecef_from_level * Rigid3d(RosDrive::world_from_body(frame.t_ns).linear());
    EXPECT_LT((frame.global_from_body.translation() - truth.translation()).norm(), 1e-3);
    EXPECT_TRUE(frame.global_from_body.linear().isApprox(truth.linear(), 1e-5));
  }
}

TEST(Rosbag, ReadsTimesOfPointsAsDriversWriteThem) {
  for (const char* name : {"time", "timestamp"}) {
    const TemporaryFolder folder;
    expect_drive(opened(folder, RosDrive({.point_time = name})), name);
  }
}

TEST(Rosbag, DecodesImagesInTheBag) {
  const TemporaryFolder folder;
  const Recording recording = opened(folder, RosDrive());
  for (const RecordedCamera& camera : recording.cameras) {
    const int seed = camera.calibration.name == "front"  ? 1
                     : camera.calibration.name == "left" ? 2
                                                         : 0;
    for (const ImageFile& file : camera.images) {
      EXPECT_FALSE(std::filesystem::exists(file.path));
      const Image8 truth = RosDrive::image(int(file.frame_id), seed), read = read_image(file.path);
      ASSERT_EQ(read.rgb.size(), truth.rgb.size());
      double most = 0;
      // A Bayer pattern is interpolated: exact for a ramp, but at the border.
      for (int y = 2; y < 46; ++y)
        for (int x = 2; x < 62; ++x)
          for (int c = 0; c < 3; ++c) {
            const auto i = std::size_t(3 * (64 * y + x) + c);
            most = std::max(most, std::abs(double(read.rgb[i]) - truth.rgb[i]));
          }
      EXPECT_LE(most, seed == 1 ? 0 : seed == 0 ? 1 : 6) << file.path;
    }
  }
}

TEST(Rosbag, LeavesOutDamagedMessages) {
  const TemporaryFolder folder;
  RosDrive drive;
  int cut = 0;
  for (RosDrive::Message& message : drive.messages)
    if (message.topic == RosDrive::kFront && cut++ == 4) message.bytes.resize(20);
  const Recording recording = opened(folder, drive);
  EXPECT_THAT(recording.damaged,
              Contains(AllOf(Field(&DamagedRecord::sensor, "front"),
                             Field(&DamagedRecord::why, HasSubstr("longer than its message")))));
  EXPECT_EQ(recording.find_camera("front")->images.size(), 9u);
  EXPECT_EQ(recording.find_camera("rear")->images.size(), 10u);
}

TEST(Rosbag, LivesWithDisorder) {
  const TemporaryFolder folder;
  RosDrive drive;
  std::vector<RosDrive::Message> messages;
  int front = 0, left = 0, rear = 0;
  for (RosDrive::Message message : drive.messages) {
    if (message.topic == RosDrive::kLeft && left++ < 4) continue;  // it starts late
    if (message.topic == RosDrive::kRear && rear++ == 5)           // no stamp
      std::fill_n(message.bytes.begin() + 4, 8, '\0');
    messages.push_back(message);
    if (message.topic == RosDrive::kFront && front++ == 3) messages.push_back(message);  // twice
  }
  drive.messages = messages;
  const Recording recording = opened(folder, drive);
  EXPECT_EQ(recording.frames.size(), 10u);
  EXPECT_EQ(recording.find_camera("front")->images.size(), 10u);
  EXPECT_THAT(recording.findings, says("front", "1 message left out, at the time of another one"));
  EXPECT_EQ(recording.find_camera("left")->images.size(), 6u);
  EXPECT_EQ(recording.find_camera("left")->calibration.time_offset_ns, 4'000'000);
  EXPECT_EQ(recording.find_camera("rear")->images.size(), 9u);
  EXPECT_THAT(recording.damaged, Contains(Field(&DamagedRecord::why, HasSubstr("header.stamp"))));
}

TEST(Rosbag, GivesCamerasThatRunFreelyFramesOfTheirOwn) {
  const TemporaryFolder folder;
  RosDrive drive;
  int rear = 0;
  for (RosDrive::Message& message : drive.messages)
    if (message.topic == RosDrive::kRear) {  // each image 3 ms later than the one before
      const auto late_ns = static_cast<std::uint32_t>(3'000'000 * rear++);
      std::uint32_t ns;
      std::memcpy(&ns, &message.bytes[8], 4);
      ns += late_ns;
      std::memcpy(&message.bytes[8], &ns, 4);
    }
  const Recording recording = opened(folder, drive);
  const RecordedCamera& camera = *recording.find_camera("rear");
  EXPECT_EQ(camera.calibration.time_offset_ns, 0);
  EXPECT_GT(recording.frames.size(), 15u);
  EXPECT_EQ(camera.images.size(), 10u);
  for (const FramePose& frame : recording.frames)
    EXPECT_TRUE(frame.global_from_body.isApprox(RosDrive::world_from_body(frame.t_ns), 1e-9));
}

TEST(Rosbag, ImagesInTheBagAreCheckedAsFiles) {
  const TemporaryFolder folder;
  RosDrive drive;
  int n = 0;
  for (RosDrive::Message& message : drive.messages)  // a JPEG that is cut, in a whole message
    if (message.topic == RosDrive::kLeft && n++ == 0) {
      CdrWriter out;
      out.header(RosDrive::t_ns(0) + RosDrive::offset_ns("left"), "left_optical")
          .text("jpeg")
          .blob(encode_jpeg(RosDrive::image(0, 2), 95).substr(0, 300));
      message.bytes = out.bytes();
    }
  Recording recording = opened(folder, drive);
  const auto too_many = leave_out_damaged({.whole = 8}, &recording);
  EXPECT_THAT(too_many, ::testing::IsEmpty());
  EXPECT_EQ(recording.find_camera("left")->images.size(), 9u);
  EXPECT_EQ(recording.find_camera("front")->images.size(), 10u);
}

TEST(Rosbag, UsesEachLidar) {
  const TemporaryFolder folder;
  Recording recording = opened(folder, RosDrive({.second_lidar = "lidar_rear"}));
  ASSERT_EQ(recording.lidars.size(), 2u);
  EXPECT_EQ(recording.lidars[0].name, "lidar");
  EXPECT_EQ(recording.lidars[1].name, "rear_points") << "rear is a camera";
  const std::vector<FrameFile> scans = recording.scans_of(1);
  ASSERT_EQ(scans.size(), std::size_t(RosDrive::kScans));
  for (int s = 0; s < RosDrive::kScans; ++s) {
    const std::vector<LidarPoint> points = recording.read_lidar(scans[std::size_t(s)]);
    ASSERT_EQ(points.size(), 29u);
    const LidarPoint& point = points[0];
    const Eigen::Vector3d truth = RosDrive::world_from_body(point.t_ns) *
                                  RosDrive::place("lidar_rear") * RosDrive::point(s, 0);
    EXPECT_LT(
        (pose_at(recording.frames, point.t_ns) * point.in_body_m.cast<double>() - truth).norm(),
        2e-6);
  }
  std::erase_if(recording.lidar_files, [](const FrameFile& file) { return file.lidar == 1; });
  expect_drive(recording, "the first of two");
}

// Clouds that are made from others': in the same frame, or joined in the body's.
TEST(Rosbag, UsesEachSensorOnce) {
  for (const auto& [frame, why] : {std::pair("lidar", "the same sensor as /lidar/points"),
                                   std::pair("base_link", "made from others' scans"),
                                   std::pair("odom", "does not lead to its frame odom")}) {
    const TemporaryFolder folder;
    const Recording recording = opened(folder, RosDrive({.second_lidar = frame}));
    EXPECT_THAT(recording.findings, says("/rear/points", why));
    EXPECT_EQ(recording.lidars.size(), 1u);
    expect_drive(recording, frame);
  }
}

TEST(Rosbag, ReadsMappingsOfOneLidar) {
  const TemporaryFolder folder;
  folder.write("a.mcap", RosDrive().mcap());
  std::string text = mapping_of(folder.path)->text;
  const std::string now = "lidars:\n  lidar:\n";
  const std::size_t at = text.find(now);
  ASSERT_NE(at, text.npos) << text;
  folder.write("rig.yaml", text.replace(at, now.size(), "lidar:\n"));
  expect_drive(open_recording(folder.path), "lidar:");
}

TEST(Rosbag, FramesThatAreNotOptical) {
  const TemporaryFolder folder;
  folder.write("a.mcap", RosDrive().mcap());
  std::string text = mapping_of(folder.path)->text;
  for (const auto& [from, to] : {std::pair("frame: left_optical", "frame: roof"),
                                 std::pair("optical: true", "optical: false")})
    text.replace(text.find(from, text.find("info: /cam/left")), std::string(from).size(), to);
  folder.write("rig.yaml", text);
  const Recording recording = open_recording(folder.path);
  const Rigid3d place = recording.find_camera("left")->calibration.body_from_sensor;
  EXPECT_LT((place.translation() - RosDrive::roof().translation()).norm(), 1e-9);
  // The camera looks along the frame's x axis, and its image's x axis is the frame's -y.
  EXPECT_LT((place.linear().col(2) - RosDrive::roof().linear().col(0)).norm(), 1e-9);
  EXPECT_LT((place.linear().col(0) + RosDrive::roof().linear().col(1)).norm(), 1e-9);
}

TEST(Rosbag, AsksForWhatIsAmbiguous) {
  const auto error_of = [](const RosDrive& drive) {
    const TemporaryFolder folder;
    folder.write("a.mcap", drive.mcap());
    const auto mapping = mapping_of(folder.path);
    EXPECT_FALSE(mapping->questions.empty());
    return input_error([&] { open_recording(folder.path); });
  };
  EXPECT_THAT(error_of(RosDrive({.odometry = true})),
              AllOf(HasSubstr("poses.topic: 2 sources of poses: /tf, /odometry"),
                    HasSubstr("inspect --write-rig")));
  EXPECT_THAT(error_of(RosDrive({.left_frame = "nowhere"})),
              HasSubstr("cameras.left.frame: no extrinsic: /tf_static does not lead from "
                        "base_link to nowhere"));
  EXPECT_THAT(error_of(RosDrive({.tf = false})), HasSubstr("poses.topic: no source of poses"));
  RosDrive without_info;
  std::erase_if(without_info.messages,
                [](const auto& message) { return message.topic == "/cam/rear/camera_info"; });
  EXPECT_THAT(error_of(without_info), HasSubstr("cameras.rear.info: no CameraInfo"));
  RosDrive apart;
  for (RosDrive::Message& message : apart.messages)
    if (message.topic == RosDrive::kPoints2) message.log_ns += 37'000'000'000;
  EXPECT_THAT(error_of(apart), HasSubstr("time: clocks of headers are apart: /lidar/points by 37"));
}

TEST(Rosbag, ItsMappingIsWrittenEditedAndRead) {
  const TemporaryFolder folder;
  folder.write("a.mcap", RosDrive({.odometry = true, .left_frame = "nowhere"}).mcap());
  const auto mapping = mapping_of(folder.path);
  ASSERT_TRUE(mapping);
  EXPECT_EQ(mapping->file, folder.path / "rig.yaml");
  ASSERT_EQ(mapping->streams.size(), 10u);
  EXPECT_EQ(mapping->streams[0].name, "/cam/front/camera_info");
  EXPECT_EQ(mapping->streams[1].messages, 10u);
  EXPECT_EQ(mapping->streams[1].frame, "front_optical");
  EXPECT_EQ(mapping->streams[1].last_ns - mapping->streams[1].first_ns, 900'000'000);
  folder.write("rig.yaml", mapping->text);
  EXPECT_TRUE(mapping_of(folder.path)->is_there);
  EXPECT_THAT(input_error([&] { open_recording(folder.path); }),
              AllOf(HasSubstr("rig.yaml"), HasSubstr("cameras.left.frame"), HasSubstr("nowhere")));
  std::string text = mapping->text;
  text.replace(text.find("nowhere", text.find("info: /cam/left")), 7, "left_optical");
  folder.write("rig.yaml", text);
  expect_drive(open_recording(folder.path), "edited");
  // A transform, a height, the recorder's clock.
  const Eigen::Quaterniond q(RosDrive::place("left").linear());
  const Eigen::Vector3d p = RosDrive::place("left").translation();
  char place[300];
  std::snprintf(place, sizeof place,
                "body_from_sensor: {xyz: [%.17g, %.17g, %.17g], xyzw: [%.17g, %.17g, %.17g, "
                "%.17g]}\n    optical",
                p.x(), p.y(), p.z(), q.x(), q.y(), q.z(), q.w());
  std::string given = mapping->text;
  given.replace(given.find("optical:", given.find("nowhere", given.find("info: /cam/left"))), 7,
                place);
  folder.write("rig.yaml", given);
  expect_drive(open_recording(folder.path), "given");
  given.replace(given.find("above_ground_m: 0"), 17, "above_ground_m: 0.5");
  given.replace(given.find("time: header"), 12, "time: log");
  folder.write("rig.yaml", given);
  const Recording recording = open_recording(folder.path);
  EXPECT_EQ(recording.frames[0].t_ns, RosDrive::t_ns(0) + 7'000'000);
  EXPECT_TRUE(recording.frames[0].global_from_body.isApprox(
      RosDrive::world_from_body(RosDrive::t_ns(0) + 6'000'000) * Eigen::Translation3d(0, 0, -0.5),
      1e-9))
      << "poses are recorded 1 ms late";
  EXPECT_TRUE(recording.lidars[0].body_from_lidar.isApprox(
      Eigen::Translation3d(0, 0, 0.5) * RosDrive::place("lidar"), 1e-9));
}

TEST(Rosbag, NamesWhatIsWrongInItsMapping) {
  const TemporaryFolder folder;
  folder.write("a.mcap", RosDrive().mcap());
  const std::string good = mapping_of(folder.path)->text;
  const auto error_with = [&](const std::string& from, const std::string& to) {
    std::string text = good;
    const std::size_t at = text.find(from);
    EXPECT_NE(at, text.npos) << from << text;
    folder.write("rig.yaml", text.replace(at, from.size(), to));
    return input_error([&] { open_recording(folder.path); });
  };
  EXPECT_THAT(error_with("time: header", "time: sun"), HasSubstr("rig.yaml"));
  EXPECT_THAT(error_with("time: header", "tim: header"), HasSubstr("tim"));
  EXPECT_THAT(error_with("image: /cam/front/image_raw", "image: /no"),
              AllOf(HasSubstr("cameras.front.image"), HasSubstr("is no topic of the bag")));
  EXPECT_THAT(error_with("image: /cam/front/image_raw", "image: /tf"), HasSubstr("TFMessage"));
  EXPECT_THAT(error_with("info: /cam/front/camera_info", "info: /tf"),
              HasSubstr("cameras.front.info"));
  EXPECT_THAT(error_with("topic: /tf", "topic: /cam/front/image_raw"),
              HasSubstr("is no type of poses"));
  EXPECT_THAT(error_with("world: odom", "world: mars"), HasSubstr("mars"));
  EXPECT_THAT(error_with("time_unit: ns", "time_unit: days"), HasSubstr("lidars.lidar.time_unit"));
  EXPECT_THAT(error_with("intensity: intensity", "intensity: strength"), HasSubstr("strength"));
  EXPECT_THAT(error_with("readout_s: 0", "readout_s: 3"), HasSubstr("cameras.front.readout_s"));
  EXPECT_THAT(error_with("cameras:", "cameras: ["), HasSubstr("not usable YAML"));
  EXPECT_THAT(error_with("  lidar:", "  left:"), HasSubstr("lidars.left"));
}

TEST(Rosbag, NamesDefinitionsThatDiffer) {
  const TemporaryFolder folder;
  RosDrive drive;
  drive.schema_of = [](const std::string& type) {
    std::string text = testing::ros_definition(type);
    if (type == "sensor_msgs/msg/Image") text.replace(text.find("uint32 width"), 6, "uint16");
    return text;
  };
  EXPECT_THAT(input_error([&] { opened(folder, drive); }),
              AllOf(HasSubstr("/cam/front/image_raw sensor_msgs/msg/Image"),
                    HasSubstr("uint16 width"), HasSubstr("uint32 width")));
}

TEST(Rosbag, RefusesOtherFiles) {
  const TemporaryFolder folder;
  folder.write("a.mcap.zstd", "x");
  EXPECT_THAT(input_error([&] { open_recording(folder.path); }), HasSubstr("zstd -d"));
  const TemporaryFolder other;
  other.write("a.db3", "no database, but a text that is long enough");
  EXPECT_THAT(input_error([&] { open_recording(other.path); }),
              AllOf(HasSubstr("a.db3"), HasSubstr("not usable as SQLite")));
  const TemporaryFolder third;
  McapWriter writer;
  writer.message(writer.channel("/cam/image", "sensor_msgs/msg/Image",
                                testing::ros_definition("sensor_msgs/msg/Image"), "ros1"),
                 5, "x");
  third.write("a.mcap", writer.finish());
  EXPECT_THAT(input_error([&] { open_recording(third.path); }), HasSubstr("ROS 1"));
}

}  // namespace
}  // namespace redrive::rosbag

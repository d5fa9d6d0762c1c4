// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/damaged_records.h"

#include "redrive/base/files/files.h"
#include "redrive/image/image_io.h"
#include "redrive/recording/core/recording_testing.h"
#include "redrive/recording/lidar/las.h"

namespace redrive {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using testing::input_error;
using ::testing::IsEmpty;
using ::testing::SizeIs;

Image8 noise_image(int width, int height, std::uint32_t seed) {
  Image8 image{width, height, std::vector<std::uint8_t>(std::size_t(3) * width * height)};
  std::uint32_t state = seed + 1;
  for (std::uint8_t& value : image.rgb) value = static_cast<std::uint8_t>((state *= 48271) >> 16);
  return image;
}

/// A drive of a camera and a LiDAR.
class DamagedRecords : public ::testing::Test {
 protected:
  void make(int frames, const std::string& extension) {
    nlohmann::json sensors = {{"F_CAM", testing::front_camera()},
                              {"LIDAR",
                               {{"sensor_type", "lidar"},
                                {"RT_body_from_sensor",
                                 {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 2}, {0, 0, 0, 1}}}}}},
                   poses;
    sensors["F_CAM"]["image_resolution_px"] = {32, 16};
    sensors["F_CAM"]["principal_point_px"] = {16, 8};
    std::filesystem::remove_all(folder_.path / "sensor/camera");
    extension_ = extension;
    for (int id = 0; id < frames; ++id) {
      poses[std::to_string(id)] = testing::pose_at(id, 50 + 0.1 * id);
      std::filesystem::create_directories(image(id).parent_path());
      write_image(image(id), noise_image(32, 16, static_cast<std::uint32_t>(id)));
      const std::vector<LidarRecord> points(4, {{9, 2, 1}, 50'000'000'000, 7});
      std::filesystem::create_directories(scan(id).parent_path());
      write_file(scan(id), make_las(points));
    }
    folder_.write("sensor/calibration/calibration.json", sensors.dump());
    folder_.write("sensor/gnssins/egomotion2.json", poses.dump());
  }
  std::filesystem::path image(int id) const {
    return folder_.path / "sensor/camera/F_CAM" / ("F_CAM_" + std::to_string(id) + extension_);
  }
  std::filesystem::path scan(int id) const {
    return folder_.path / "dynamic/raw-revolutions" / ("frame_" + std::to_string(id) + ".las");
  }
  void cut(const std::filesystem::path& file, double share) {
    const std::string bytes = read_file(file);
    write_file(file, bytes.substr(0, std::size_t(share * double(bytes.size()))));
  }
  /// Damages the middle of a file.
  void scratch(const std::filesystem::path& file) {
    std::string bytes = read_file(file);
    for (std::size_t i = bytes.size() / 2; i < bytes.size() / 2 + 40; ++i) bytes[i] = 'x';
    write_file(file, bytes);
  }
  Recording open() const { return open_recording(folder_.path); }

  std::string extension_ = ".png";
  TemporaryFolder folder_;
};

std::vector<std::int64_t> ids(const std::vector<FrameFile>& files) {
  std::vector<std::int64_t> out;
  for (const FrameFile& file : files) out.push_back(file.frame_id);
  return out;
}

/// What the finding about a sensor says, or nothing.
std::string found(const Recording& recording, const std::string& subject) {
  for (const Finding& finding : recording.findings)
    if (finding.subject == subject) return finding.what;
  return "";
}

TEST_F(DamagedRecords, AnImageThatIsCutOrEmptyOrOfAnotherSizeCostsItself) {
  for (const std::string extension : {".png", ".jpg"}) {
    for (const int kind : {0, 1, 2}) {
      make(4, extension);
      if (kind == 0) cut(image(2), 0.6);
      if (kind == 1) cut(image(2), 0);
      if (kind == 2) write_image(image(2), noise_image(32, 14, 2));
      Recording recording = open();
      require_few_damaged({}, &recording);
      ASSERT_THAT(recording.cameras[0].images, SizeIs(3)) << extension << kind;
      EXPECT_EQ(recording.cameras[0].images[2].frame_id, 3);
      EXPECT_THAT(found(recording, "F_CAM"),
                  AllOf(HasSubstr("1 of 4 records left out: frame 2: "),
                        HasSubstr("F_CAM_2" + extension + ": "),
                        HasSubstr(kind == 0   ? "truncated or damaged"
                                  : kind == 1 ? "the file is empty"
                                              : "size = 32 x 14: the calibration of F_CAM has "
                                                "32 x 16")));
      EXPECT_EQ(recording.damaged.at(0).frame_id, 2);
    }
  }
}

TEST_F(DamagedRecords, AScanThatIsCutOrEmptyCostsItself) {
  for (const double share : {0.9, 0.1, 0.0}) {
    make(4, ".png");
    cut(scan(1), share);
    Recording recording = open();
    require_few_damaged({}, &recording);
    EXPECT_EQ(ids(recording.lidar_files), (std::vector<std::int64_t>{0, 2, 3})) << share;
    EXPECT_THAT(found(recording, "lidar"),
                AllOf(HasSubstr("1 of 4 records left out: frame 1: "), HasSubstr("frame_1.las")));
  }
}

TEST_F(DamagedRecords, MoreThanTheShareIsAnError) {
  make(40, ".png");
  for (const int id : {3, 4}) cut(image(id), 0.5);
  Recording two = open();
  EXPECT_THAT(leave_out_damaged({}, &two), IsEmpty());
  cut(image(5), 0.5);
  Recording three = open();
  EXPECT_THAT(input_error([&] { require_few_damaged({}, &three); }),
              AllOf(HasSubstr("F_CAM: 3 of 40 records cannot be used, more than 5 %"),
                    HasSubstr("--max-damaged"), HasSubstr("F_CAM_3.png")));
  Recording more = open();
  EXPECT_THAT(leave_out_damaged({.most_percent = 10}, &more), IsEmpty());
  EXPECT_THAT(more.cameras[0].images, SizeIs(37));
  Recording none = open();
  EXPECT_THAT(leave_out_damaged({.most_percent = 0}, &none), SizeIs(1));
  Recording other = open();
  EXPECT_THAT(leave_out_damaged({.cameras = {"OTHER"}}, &other), IsEmpty());
}

TEST_F(DamagedRecords, RecordsOfOtherFramesAreNotLookedAt) {
  make(10, ".png");
  for (const int id : {0, 1, 8}) cut(image(id), 0.5);
  Recording recording = open();
  require_few_damaged({.frames = {2, 7, 1}}, &recording);
  EXPECT_THAT(recording.cameras[0].images, SizeIs(10));
  EXPECT_EQ(found(recording, "F_CAM"), "");
}

TEST_F(DamagedRecords, WhatIsDamagedInItsMiddleIsFoundWhereAllIsRead) {
  make(4, ".png");
  scratch(image(1));
  Recording recording = open();
  require_few_damaged({}, &recording);
  EXPECT_THAT(recording.cameras[0].images, SizeIs(4));  // found when it is decoded
  require_few_damaged({.whole = DamageCheck::kAll}, &recording);
  EXPECT_THAT(recording.cameras[0].images, SizeIs(3));
}

TEST_F(DamagedRecords, NoImageLeftIsAnError) {
  make(1, ".png");
  cut(image(0), 0.5);
  Recording recording = open();
  EXPECT_THAT(input_error([&] { require_few_damaged({}, &recording); }),
              AllOf(HasSubstr("images: none is left"), HasSubstr("F_CAM_0.png")));
}

}  // namespace
}  // namespace redrive

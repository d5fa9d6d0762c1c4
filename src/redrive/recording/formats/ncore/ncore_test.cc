// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/ncore/ncore.h"

#include "redrive/base/files/files.h"
#include "redrive/camera/camera.h"
#include "redrive/image/image_io.h"
#include "redrive/recording/core/actor_kind.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/formats/damaged_records.h"
#include "redrive/recording/formats/ncore/ncore_testing.h"
#include "redrive/recording/formats/recording_reader.h"

namespace redrive {
namespace {

using ::testing::AllOf;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::Field;
using ::testing::HasSubstr;
using testing::input_error;
using testing::MadeNcore;

class Ncore : public ::testing::Test {
 protected:
  Recording opened(bool packed = true) const {
    made_.write(folder_.path, packed);
    return open_recording(folder_.path);
  }
  std::string error() const {
    return input_error([&] { opened(); });
  }
  static auto says(const std::string& subject, const std::string& what) {
    return Contains(
        AllOf(Field(&Finding::subject, subject), Field(&Finding::what, HasSubstr(what))));
  }
  static auto damaged(const std::string& sensor, const std::string& why) {
    return Contains(
        AllOf(Field(&DamagedRecord::sensor, sensor), Field(&DamagedRecord::why, HasSubstr(why))));
  }
  /// Changes attributes of a camera's lens.
  template <class Change>
  void change_lens(const std::string& camera, const Change& how) {
    made_.change(MadeNcore::kMain, "intrinsics/default/cameras/" + camera,
                 [&](nlohmann::json* all) { how(&(*all)["camera_model_parameters"]); });
  }

  TemporaryFolder folder_;
  MadeNcore made_;
};

class NcoreStores : public Ncore, public ::testing::WithParamInterface<bool> {};
INSTANTIATE_TEST_SUITE_P(Packed, NcoreStores, ::testing::Bool());

TEST_P(NcoreStores, HaveFramesAndCameras) {
  const Recording recording = opened(GetParam());
  EXPECT_EQ(recording.format, "ncore");
  EXPECT_EQ(recording.global_frame, GlobalFrame::kEcef);
  ASSERT_EQ(recording.frames.size(), 6u);
  ASSERT_EQ(recording.cameras.size(), 2u);
  for (const RecordedCamera& camera : recording.cameras) {
    const bool rolls = camera.calibration.name == "front_wide";
    ASSERT_EQ(camera.images.size(), 6u);
    EXPECT_EQ(
        camera.calibration.readout_ns,
        rolls ? 1000 * MadeNcore::kRead_us * MadeNcore::kHeight / (MadeNcore::kHeight - 1) : 0);
    EXPECT_TRUE(camera.calibration.body_from_sensor.isApprox(
        MadeNcore::rig_from_camera(rolls ? 0.25 : -0.25), 1e-12));
    for (int f = 0; f < 6; ++f) {
      const ImageFile& image = camera.images[static_cast<std::size_t>(f)];
      const std::int64_t middle_us = MadeNcore::end_us(f) - (rolls ? MadeNcore::kRead_us / 2 : 0);
      const Rigid3d expected =
          MadeNcore::world_global_from_world() * MadeNcore::world_from_rig(middle_us);
      const FramePose& frame = recording.frames[static_cast<std::size_t>(image.frame_id)];
      EXPECT_EQ(frame.t_ns + camera.calibration.time_offset_ns, 1000 * middle_us);
      const Rigid3d found = pose_at(recording.frames, 1000 * middle_us);
      EXPECT_LT((found.translation() - expected.translation()).norm(), 1e-6);
      EXPECT_LT((found.linear() - expected.linear()).norm(), 1e-9);
      const Image8 pixels = read_image(image.path);
      EXPECT_EQ(pixels.width, MadeNcore::kWidth);
      if (!rolls) {
        EXPECT_EQ(pixels.rgb[7], (7 * (f + 3)) % 256);
      }
    }
  }
}

TEST_P(NcoreStores, HaveTheReturnsOfEachRay) {
  const Recording recording = opened(GetParam());
  ASSERT_EQ(recording.lidars.size(), 1u);
  EXPECT_EQ(recording.lidars[0].name, "lidar_top");
  EXPECT_TRUE(recording.lidars[0].body_from_lidar.isApprox(MadeNcore::rig_from_lidar(), 1e-12));
  ASSERT_EQ(recording.lidar_files.size(), 6u);
  EXPECT_THAT(recording.findings, says("lidar_top", "the first return"));
  for (int f = 0; f < 6; ++f) {
    const FrameFile& file = recording.lidar_files[static_cast<std::size_t>(f)];
    std::size_t left_out = 0;
    const std::vector<LidarPoint> points = recording.read_lidar(file, &left_out);
    EXPECT_EQ(left_out, 0u) << "lost rays are no damage";
    EXPECT_EQ(recording.reader->lidar_point_count(file), std::uint64_t{MadeNcore::kRays});
    auto point = points.begin();
    for (int i = 0; i < MadeNcore::kRays; ++i) {
      if (MadeNcore::is_lost(i)) continue;
      ASSERT_NE(point, points.end());
      const Eigen::Vector3d expected =
          MadeNcore::rig_from_lidar() * (MadeNcore::range_m(i) * MadeNcore::ray_in_lidar(i));
      EXPECT_LT((point->in_body_m.cast<double>() - expected).norm(), 2e-6);
      EXPECT_EQ(point->t_ns, 1000 * MadeNcore::ray_us(f, i));
      EXPECT_EQ(point->ring, i % 4);
      EXPECT_EQ(point->intensity, std::lround(65535.0 * i / MadeNcore::kRays));
      ++point;
    }
    EXPECT_EQ(point, points.end());
  }
}

TEST_F(Ncore, RaysAreTheLenses) {
  const Recording recording = opened();
  const Camera wide = make_camera(recording.find_camera("front_wide")->calibration),
               rear = make_camera(recording.find_camera("rear")->calibration);
  for (const Eigen::Vector3d& point :
       {Eigen::Vector3d(0, 0, 1), Eigen::Vector3d(0.3, -0.2, 1), Eigen::Vector3d(-0.1, 0.4, 2)}) {
    const double r = point.head<2>().norm(), angle = std::atan2(r, point.z()),
                 distance = 40 * angle - 2 * angle * angle * angle;
    const Eigen::Vector2d toward =
        r > 0 ? Eigen::Vector2d(point.head<2>() / r) : Eigen::Vector2d(0, 0);
    EXPECT_LT((*wide.project(point) - Eigen::Vector2d(31.25, 23.75) - distance * toward).norm(),
              1e-6);
    const double x = point.x() / point.z(), y = point.y() / point.z(), rr = x * x + y * y,
                 scale = (1 + rr * (0.1 + rr * (-0.02 + rr * 0.003))) / (1 + rr * 0.01),
                 x_d = x * scale + 2 * 0.001 * x * y - 0.002 * (rr + 2 * x * x),
                 y_d = y * scale + 0.001 * (rr + 2 * y * y) - 2 * 0.002 * x * y;
    EXPECT_LT((*rear.project(point) - Eigen::Vector2d(50 * x_d + 31.5, 51 * y_d + 24)).norm(),
              1e-6);
  }
}

TEST_F(Ncore, BoxesLieInTheWorldAtTheirTimes) {
  const Recording recording = opened();
  ASSERT_EQ(recording.box_files.size(), 6u);
  for (const FrameFile& file : recording.box_files) {
    const std::vector<Box> boxes = recording.reader->read_boxes(file);
    ASSERT_EQ(boxes.size(), 2u);
    for (const Box& box : boxes) {
      const Rigid3d world_from_box = MadeNcore::world_global_from_world().inverse() *
                                     pose_at(recording.frames, box.t_ns) * box.body_from_box;
      if (box.type == "automobile") {
        const Rigid3d expected = MadeNcore::world_from_car(box.t_ns / 1000);
        EXPECT_LT((world_from_box.translation() - expected.translation()).norm(), 1e-6);
        EXPECT_LT((world_from_box.linear() - expected.linear()).norm(), 1e-8);
        EXPECT_EQ(box.size_m, Eigen::Vector3d(4.5, 1.8, 1.5));
      } else {
        EXPECT_STREQ(kind_of(box.type).name, "person");
        EXPECT_LT((world_from_box.translation() - Eigen::Vector3d(12, -4, 0.9)).norm(), 1e-6);
        EXPECT_NEAR(std::atan2(world_from_box.linear()(1, 0), world_from_box.linear()(0, 0)), 0.5,
                    1e-9);
      }
    }
  }
}

TEST_F(Ncore, MaskOfTheOwnCar) {
  const Recording recording = opened();
  EXPECT_THAT(recording.findings, says("front_wide", "masks not used: sky"));
  for (const ImageFile& image : recording.find_camera("front_wide")->images) {
    EXPECT_FALSE(image.mask.black_is_masked);
    EXPECT_EQ(read_image(image.mask.path).rgb.back(), 255);
  }
  EXPECT_TRUE(recording.find_camera("rear")->images[0].mask.path.empty());
}

TEST_F(Ncore, WithoutPlaceOnTheEarth) {
  made_.change(MadeNcore::kMain, "poses/default/static_poses", [](nlohmann::json* poses) {
    (*poses)["('world', 'world_global')"]["pose"] = MadeNcore::matrix(Rigid3d::Identity());
  });
  const Recording recording = opened();
  EXPECT_EQ(recording.global_frame, GlobalFrame::kArbitrary);
  EXPECT_LT(recording.frames.front().global_from_body.translation().norm(), 10);
}

TEST_F(Ncore, WindshieldBendsRaysBeforeTheLens) {
  const Camera without = make_camera(opened().find_camera("front_wide")->calibration);
  const auto put_windshield = [](nlohmann::json* lens) {
    (*lens)["external_distortion_parameters"] = {
        {"reference_poly", "FORWARD"},
        {"horizontal_poly", {-0.01, 1.02, 0.03}},
        {"vertical_poly", {0.02, 0.0, 0.04, 0.99, 0.05, 0.06}},
        {"horizontal_poly_inverse", {0.01, 1.0, 0.0}},
        {"vertical_poly_inverse", {0.0, 0.0, 1.0}}};
  };
  change_lens("front_wide", put_windshield);
  change_lens("rear", put_windshield);
  const Recording recording = opened();
  EXPECT_THAT(recording.findings,
              says("rear", "windshield that is not modelled: its lens is no ftheta"));
  const Camera camera = make_camera(recording.find_camera("front_wide")->calibration);
  for (const Eigen::Vector3d& ray : {Eigen::Vector3d(0, 0, 1), Eigen::Vector3d(0.3, -0.2, 0.9),
                                     Eigen::Vector3d(-0.4, 0.1, 0.8)}) {
    const double phi = std::asin(ray.normalized().x()), theta = std::asin(ray.normalized().y()),
                 x = std::sin(-0.01 + 1.02 * phi + 0.03 * theta),
                 y = std::sin(0.02 + 0.04 * phi * phi + 0.99 * theta + 0.05 * phi * theta +
                              0.06 * theta * theta);
    EXPECT_LT(
        (*camera.project(ray) - *without.project({x, y, std::sqrt(1 - x * x - y * y)})).norm(),
        1e-6);
  }
  change_lens("front_wide", [](nlohmann::json* lens) {
    (*lens)["external_distortion_parameters"]["vertical_poly"] = {0.0, 1.0};
  });
  EXPECT_THAT(opened().findings,
              says("front_wide", "external_distortion_parameters.vertical_poly = 2 numbers"));
}

TEST_F(Ncore, WindshieldsOfHigherOrderAreNotUsed) {
  change_lens("front_wide", [](nlohmann::json* lens) {
    (*lens)["external_distortion_parameters"] = {{"reference_poly", "BACKWARD"},
                                                 {"horizontal_poly", std::vector<double>(10, 0.0)},
                                                 {"vertical_poly", {0.0, 0.0, 1.0}},
                                                 {"horizontal_poly_inverse", {0.0, 1.0, 0.0}},
                                                 {"vertical_poly_inverse", {0.0, 0.0, 1.0}}};
  });
  const Recording recording = opened();
  EXPECT_THAT(recording.findings, says("front_wide", "higher order than 2 and 4"));
  EXPECT_EQ(recording.find_camera("front_wide")->calibration.model, "ftheta");
}

TEST_F(Ncore, PinholesHaveAPrism) {
  change_lens("rear", [](nlohmann::json* lens) {
    (*lens)["thin_prism_coeffs"] = {0.01, 0.02, 0.03, 0.04};
  });
  const CameraCalibration rear = opened().find_camera("rear")->calibration;
  EXPECT_EQ(rear.model, "opencv_thin_prism");
  EXPECT_THAT(rear.parameters, ElementsAre(50, 51, 31.5, 24, 0.1, -0.02, 0.001, -0.002, 0.003, 0.01,
                                           0, 0, 0.01, 0.02, 0.03, 0.04));
}

TEST_F(Ncore, OneBadCameraIsLeftOut) {
  change_lens("rear", [](nlohmann::json* lens) { (*lens)["thin_prism_coeffs"][1] = 1e9; });
  const Recording recording = opened();
  EXPECT_EQ(recording.cameras.size(), 1u);
  EXPECT_THAT(recording.findings, says("rear", "thin_prism_coeffs"));
  change_lens("front_wide", [](nlohmann::json* lens) { (*lens)["shutter_type"] = "SIDEWAYS"; });
  EXPECT_THAT(error(), HasSubstr("shutter_type = \"SIDEWAYS\""));
}

TEST_F(Ncore, DamagedRecordsCostThemselves) {
  auto& sensors = made_.stores.at(MadeNcore::kSensors);
  const std::string scan = "lidars/lidar_top/frames/" + std::to_string(MadeNcore::end_us(2)),
                    image = "cameras/rear/frames/" + std::to_string(MadeNcore::end_us(1));
  sensors.at(scan + "/ray_bundle/direction/0.0").resize(100);
  sensors.erase(image + "/image/0");
  made_.change(MadeNcore::kSensors, "cameras/rear/frames",
               [](nlohmann::json* frames) { (*frames)["frames_timestamps_us"][4][0] = -1; });
  Recording recording = opened();
  EXPECT_EQ(recording.find_camera("rear")->images.size(), 4u);
  EXPECT_THAT(recording.damaged, damaged("rear", image + "/image"));
  EXPECT_THAT(recording.damaged, damaged("rear", "frames_timestamps_us[4]"));
  EXPECT_THAT(input_error([&] { recording.read_lidar(recording.lidar_files[2]); }),
              HasSubstr(scan + "/ray_bundle/direction/0.0: is damaged"));
  recording.most_damaged_percent = 100;
  leave_out_damaged({.whole = DamageCheck::kAll}, &recording);
  EXPECT_EQ(recording.lidar_files.size(), 5u);
}

TEST_F(Ncore, RaysThatCannotBe) {
  const std::string path = "lidars/lidar_top/frames/" + std::to_string(MadeNcore::end_us(0));
  std::vector<float> directions(3 * MadeNcore::kRays, 1.0f);
  made_.array(path + "/ray_bundle/direction", "<f4", {MadeNcore::kRays, 3}, directions);
  const Recording recording = opened();
  EXPECT_THAT(input_error([&] { recording.read_lidar(recording.lidar_files[0]); }),
              AllOf(HasSubstr("direction of ray 0"), HasSubstr("must have length 1")));
}

TEST_F(Ncore, CuboidsWithoutAPlaceAreLeftOut) {
  made_.change(MadeNcore::kMain, "cuboids/default/cuboids", [](nlohmann::json* all) {
    auto& list = (*all)["cuboid_track_observations"];
    list[0]["reference_frame_id"] = "radar";
    list[1]["bbox3"]["dim"][2] = 0;
    list[2]["track_id"] = "";
  });
  const Recording recording = opened();
  EXPECT_THAT(recording.findings, says("boxes", "3 cuboids without"));
  EXPECT_THAT(recording.findings, says("boxes", "has no pose in the rig"));
  EXPECT_EQ(recording.box_files.size(), 5u);
}

TEST_F(Ncore, NamesWhatIsMissing) {
  auto& main = made_.stores.at(MadeNcore::kMain);
  const auto whole = main;
  const auto remove = [&](const std::string& start) {
    main = whole;
    std::erase_if(main, [&](const auto& file) { return file.first.starts_with(start); });
  };
  remove("poses/");
  EXPECT_THAT(error(), HasSubstr("poses: is missing"));
  remove("intrinsics/");
  EXPECT_THAT(error(), HasSubstr("intrinsics: is missing"));
  remove("masks/");
  EXPECT_EQ(opened().cameras.size(), 2u);
  remove("cuboids/");
  EXPECT_TRUE(opened().box_files.empty());
  main = whole;
  made_.change(MadeNcore::kMain, "poses/default/dynamic_poses", [](nlohmann::json* poses) {
    *poses = {{"('camera1', 'world')", (*poses)["('rig', 'world')"]}};
  });
  EXPECT_THAT(error(), HasSubstr("as photographs have"));
  main = whole;
  made_.change(MadeNcore::kMain, "poses/default",
               [](nlohmann::json* about) { (*about)["component_version"] = "v2"; });
  EXPECT_THAT(error(), HasSubstr("poses: is missing"));
}

TEST_F(Ncore, SeveralSequences) {
  made_.write(folder_.path, true);
  folder_.write("other.json", R"({"component_stores": []})");
  EXPECT_THAT(input_error([&] { open_recording(folder_.path); }),
              HasSubstr("has several sequences: made.json and other.json"));
  std::filesystem::remove(folder_.path / "other.json");
  made_.attributes(MadeNcore::kSensors, "", {{"sequence_id", "other"}, {"version", "v4"}});
  EXPECT_THAT(error(), HasSubstr("is another sequence"));
}

TEST_F(Ncore, StoresOutsideOfTheFolder) {
  made_.write(folder_.path, true);
  const std::string name = std::string(MadeNcore::kSensors) + ".itar";
  std::filesystem::create_directories(folder_.path / "in");
  for (const char* file : {"made.json", "made.ncore4.zarr.itar"})
    std::filesystem::rename(folder_.path / file, folder_.path / "in" / file);
  std::string list = read_file(folder_.path / "in/made.json");
  list.replace(list.find(name), name.size(), "../" + name);
  folder_.write("in/made.json", list);
  EXPECT_THAT(input_error([&] { open_recording(folder_.path / "in"); }),
              HasSubstr("--outside-files reads it"));
  EXPECT_EQ(open_recording(folder_.path / "in", PoseSource::kRecorded, true).cameras.size(), 2u);
}

}  // namespace
}  // namespace redrive

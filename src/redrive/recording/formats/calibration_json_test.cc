// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/calibration_json.h"
#include "redrive/camera/models.h"
#include "redrive/recording/core/recording_testing.h"

namespace redrive {
namespace {

using nlohmann::json;
using ::testing::AllOf;
using testing::calibration;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using testing::input_error;

std::vector<CameraCalibration> parsed_calibration(const json& document,
                                                  OtherSensors* others = nullptr) {
  return parse_calibration(document.dump(), "dir/calibration.json", others);
}

/// Returns the message for a calibration whose F_CAM has `value` in `field` (a JSON pointer).
std::string calibration_message(const std::string& field, const json& value) {
  json document = calibration();
  document["F_CAM"][json::json_pointer(field)] = value;
  const std::string message = input_error([&] { parsed_calibration(document); });
  EXPECT_THAT(message, HasSubstr("dir/calibration.json")) << field;
  return message;
}

TEST(Calibration, FindsTheOnlyLidarWithExtrinsics) {
  json document = calibration();
  document["M_LIDAR"]["RT_body_from_sensor"] = {
      {0, -1, 0, 1.2}, {1, 0, 0, 0}, {0, 0, 1, 1.7}, {0, 0, 0, 1}};
  document["F_RADAR"] = {{"sensor_type", "radar"}, {"RT_body_from_sensor", "not read"}};
  OtherSensors others;
  parsed_calibration(document, &others);
  ASSERT_TRUE(others.body_from_lidar.has_value());
  EXPECT_EQ(others.body_from_lidar->translation(), Eigen::Vector3d(1.2, 0, 1.7));
  EXPECT_EQ(others.body_from_lidar->linear().col(0), Eigen::Vector3d(0, 1, 0));

  json broken = document;
  broken["M_LIDAR"]["RT_body_from_sensor"][0][3] = 1200;
  EXPECT_THAT(input_error([&] { parsed_calibration(broken, &others); }),
              AllOf(HasSubstr("M_LIDAR"), HasSubstr("50 m")));

  document["R_LIDAR"] = document["M_LIDAR"];
  parsed_calibration(document, &others);
  EXPECT_FALSE(others.body_from_lidar.has_value());
}

TEST(Calibration, ReadsEveryField) {
  OtherSensors others;
  const auto cameras = parsed_calibration(calibration(), &others);
  ASSERT_EQ(cameras.size(), 2u);
  EXPECT_THAT(others.names, ElementsAre("Imu0", "M_LIDAR"));
  EXPECT_FALSE(others.body_from_lidar.has_value());  // M_LIDAR has no extrinsics
  const CameraCalibration& camera = cameras[0];
  EXPECT_EQ(camera.name, "F_CAM");
  EXPECT_EQ(camera.model, "opencv_pinhole");
  EXPECT_EQ(camera.fx(), 1171.5);
  EXPECT_EQ(camera.fy(), 1001.25);
  EXPECT_EQ(camera.cx(), 640);
  EXPECT_EQ(camera.cy(), 352.5);
  EXPECT_THAT(distortion(camera), ElementsAre(-0.3, 0.08, 0.002, 0.0006, 0));
  EXPECT_THAT(other_parameters(camera), ElementsAre());
  EXPECT_EQ(camera.width, 1280);
  EXPECT_EQ(camera.height, 704);
  // The camera's z axis is the body's x axis: a point 1 m ahead of the lens is 3 m ahead of the
  // body's origin.
  EXPECT_TRUE((camera.body_from_sensor * Eigen::Vector3d(0, 0, 1))
                  .isApprox(Eigen::Vector3d(3, 0.5, 1.5), 1e-15));
  EXPECT_EQ(cameras[1].model, "mei");
  EXPECT_THAT(other_parameters(cameras[1]), ElementsAre(std::pair("xi", 1.02)));
}

TEST(Calibration, AcceptsMissingOptionalFields) {
  json document = calibration();
  for (const char* key : {"RT_sensor_from_body", "pos_meter", "sensor_type"})
    document["F_CAM"].erase(key);
  EXPECT_EQ(parsed_calibration(document).size(), 2u) << "a model and a focal length make a camera";
  document["F_CAM"]["sensor_type"] = "radar";
  EXPECT_EQ(parsed_calibration(document).size(), 1u);
}

TEST(Calibration, ReadsTimeOffsetInSeconds) {
  json document = calibration();
  document["F_CAM"]["time_offset_s"] = -0.0125;
  const auto cameras = parsed_calibration(document);
  EXPECT_EQ(cameras[0].time_offset_ns, -12'500'000);
  EXPECT_EQ(cameras[1].time_offset_ns, 0);
  EXPECT_THAT(calibration_message("/time_offset_s", 8),
              AllOf(HasSubstr("F_CAM.time_offset_s"), HasSubstr("8")));
  EXPECT_THAT(calibration_message("/time_offset_s", "late"),
              AllOf(HasSubstr("F_CAM.time_offset_s"), HasSubstr("late")));
}

TEST(Calibration, ReadsReadoutInSeconds) {
  json document = calibration();
  document["F_CAM"]["readout_s"] = 0.03;
  const auto cameras = parsed_calibration(document);
  EXPECT_EQ(cameras[0].readout_ns, 30'000'000);
  EXPECT_FALSE(cameras[0].readout_by_column);
  EXPECT_EQ(cameras[1].readout_ns, 0);
  EXPECT_THAT(calibration_message("/readout_by_column", 1),
              AllOf(HasSubstr("F_CAM.readout_by_column"), HasSubstr("true or false")));
  EXPECT_THAT(calibration_message("/readout_s", 0.3),
              AllOf(HasSubstr("F_CAM.readout_s"), HasSubstr("0.3")));
  EXPECT_THAT(calibration_message("/readout_s", "slow"),
              AllOf(HasSubstr("F_CAM.readout_s"), HasSubstr("slow")));
}

TEST(Calibration, IgnoresOtherSensors) {
  json document = calibration();
  document["M_LIDAR"]["RT_body_from_sensor"] = "nan";
  EXPECT_EQ(parsed_calibration(document).size(), 2u);
}

TEST(Calibration, RejectsMissingFields) {
  for (const char* key : {"model", "RT_body_from_sensor", "focal_length_px", "principal_point_px",
                          "distortion_coeffs", "image_resolution_px"}) {
    json document = calibration();
    document["F_CAM"].erase(key);
    EXPECT_THAT(input_error([&] { parsed_calibration(document); }),
                AllOf(HasSubstr("dir/calibration.json"), HasSubstr("F_CAM." + std::string(key)),
                      HasSubstr("missing")));
  }
  json document = calibration();
  document["L_FISH"].erase("xi");
  EXPECT_THAT(input_error([&] { parsed_calibration(document); }), HasSubstr("L_FISH.xi"));
  EXPECT_THAT(input_error([&] { parsed_calibration(json::object()); }),
              HasSubstr("holds no camera"));
}

TEST(Calibration, RejectsInvalidJson) {
  const auto message = [](const std::string& text) {
    return input_error([&] { parse_calibration(text, "c.json", nullptr); });
  };
  EXPECT_THAT(message(""), HasSubstr("c.json"));
  EXPECT_THAT(message("{\"F_CAM\": {\"focal_length_px\": [NaN, 1],}}"),
              AllOf(HasSubstr("c.json"), HasSubstr("line 1")));
  EXPECT_THAT(message("{\"F_CAM\": {\"focal_length_px\": [1e999, 1]}}"), HasSubstr("c.json"));
  EXPECT_THAT(message("[1, 2]"), HasSubstr("c.json"));
  EXPECT_THAT(message("{\"F_CAM\": 7}"), AllOf(HasSubstr("F_CAM"), HasSubstr("7")));
}

TEST(Calibration, RejectsNonNumbers) {
  EXPECT_THAT(calibration_message("/focal_length_px/0", "nan"),
              AllOf(HasSubstr("F_CAM.focal_length_px[0]"), HasSubstr("\"nan\"")));
  EXPECT_THAT(calibration_message("/focal_length_px/1", nullptr),
              AllOf(HasSubstr("F_CAM.focal_length_px[1]"), HasSubstr("null")));
  EXPECT_THAT(calibration_message("/distortion_coeffs/4", "nan"),
              AllOf(HasSubstr("F_CAM.distortion_coeffs[4]"), HasSubstr("\"nan\"")));
  EXPECT_THAT(calibration_message("/RT_body_from_sensor/1/2", "nan"),
              AllOf(HasSubstr("F_CAM.RT_body_from_sensor"), HasSubstr("\"nan\"")));
  EXPECT_THAT(calibration_message("/distortion_coeffs/0", 1e300),
              AllOf(HasSubstr("F_CAM.distortion_coeffs[0]"), HasSubstr("1e+300")));
}

TEST(Calibration, RejectsWrongShapes) {
  EXPECT_THAT(calibration_message("/focal_length_px", {1171}),
              AllOf(HasSubstr("F_CAM.focal_length_px"), HasSubstr("[1171]")));
  EXPECT_THAT(calibration_message("/distortion_coeffs", {0, 0, 0, 0}),
              AllOf(HasSubstr("F_CAM.distortion_coeffs"), HasSubstr("5")));
  EXPECT_THAT(calibration_message("/RT_body_from_sensor", {{1, 0}, {0, 1}}),
              HasSubstr("F_CAM.RT_body_from_sensor"));
  EXPECT_THAT(calibration_message("/RT_body_from_sensor/2", {0, -1, 0}),
              HasSubstr("F_CAM.RT_body_from_sensor[2]"));
  EXPECT_THAT(calibration_message("/pos_meter", {1, 2}), HasSubstr("F_CAM.pos_meter"));
}

TEST(Calibration, RejectsValuesOutOfRange) {
  EXPECT_THAT(calibration_message("/model", "kannala_brandt"),
              AllOf(HasSubstr("F_CAM.model"), HasSubstr("kannala_brandt"), HasSubstr("mei")));
  EXPECT_THAT(calibration_message("/focal_length_px/0", 0),
              AllOf(HasSubstr("F_CAM.focal_length_px[0]"), HasSubstr("= 0")));
  EXPECT_THAT(calibration_message("/focal_length_px/1", -1001),
              AllOf(HasSubstr("F_CAM.focal_length_px[1]"), HasSubstr("-1001")));
  EXPECT_THAT(calibration_message("/image_resolution_px/0", 0),
              AllOf(HasSubstr("F_CAM.image_resolution_px[0]"), HasSubstr("= 0")));
  EXPECT_THAT(calibration_message("/image_resolution_px/1", 65537), HasSubstr("65537"));
  EXPECT_THAT(calibration_message("/image_resolution_px/1", 704.5), HasSubstr("704.5"));
  EXPECT_THAT(calibration_message("/principal_point_px/0", -1281),
              AllOf(HasSubstr("F_CAM.principal_point_px[0]"), HasSubstr("-1281")));
  EXPECT_THAT(calibration_message("/principal_point_px/1", 1409),
              AllOf(HasSubstr("F_CAM.principal_point_px[1]"), HasSubstr("1409")));
  for (const double xi : {-0.1, 10.5}) {
    json document = calibration();
    document["L_FISH"]["xi"] = xi;
    EXPECT_THAT(input_error([&] { parsed_calibration(document); }), HasSubstr("L_FISH.xi"));
  }
  json document = calibration();
  document["../F_CAM"] = testing::front_camera();
  EXPECT_THAT(input_error([&] { parsed_calibration(document); }), HasSubstr("../F_CAM"));
}

TEST(Calibration, RejectsInvalidRotations) {
  EXPECT_THAT(calibration_message("/RT_body_from_sensor/0/2", 1.1),
              AllOf(HasSubstr("F_CAM.RT_body_from_sensor"), HasSubstr("orthonormal")));
  EXPECT_THAT(calibration_message("/RT_body_from_sensor/0/2", -1),
              AllOf(HasSubstr("F_CAM.RT_body_from_sensor"), HasSubstr("det = -1")));
  EXPECT_THAT(calibration_message("/RT_body_from_sensor/3/3", 0.5),
              HasSubstr("F_CAM.RT_body_from_sensor"));
  EXPECT_THAT(calibration_message("/RT_sensor_from_body/0/1", 1),
              HasSubstr("F_CAM.RT_sensor_from_body"));
}

TEST(Calibration, RejectsInvertedExtrinsics) {
  const json camera = testing::front_camera();
  const json inverse = camera["RT_sensor_from_body"];
  // Detected by pos_meter, by RT_sensor_from_body, with both exchanged, and by the axes alone.
  EXPECT_THAT(calibration_message("/RT_body_from_sensor", inverse),
              AllOf(HasSubstr("F_CAM.RT_body_from_sensor"), HasSubstr("inverted"),
                    HasSubstr("(0.500, 1.500, -2.000)")));
  json document = calibration();
  document["F_CAM"]["RT_body_from_sensor"] = inverse;
  document["F_CAM"].erase("pos_meter");
  EXPECT_THAT(input_error([&] { parsed_calibration(document); }),
              AllOf(HasSubstr("RT_sensor_from_body"), HasSubstr("inverted")));
  document["F_CAM"]["RT_sensor_from_body"] = camera["RT_body_from_sensor"];
  EXPECT_THAT(input_error([&] { parsed_calibration(document); }),
              AllOf(HasSubstr("inverted"), HasSubstr("y axis")));
  document["F_CAM"].erase("RT_sensor_from_body");
  EXPECT_THAT(input_error([&] { parsed_calibration(document); }),
              AllOf(HasSubstr("inverted"), HasSubstr("y axis")));
}

TEST(Calibration, RejectsContradictoryExtrinsics) {
  EXPECT_THAT(calibration_message("/RT_body_from_sensor/0/3", 2.1),
              AllOf(HasSubstr("disagrees with pos_meter"), HasSubstr("2.100")));
  EXPECT_THAT(calibration_message("/RT_sensor_from_body/0/3", 0.6),
              AllOf(HasSubstr("disagrees with RT_sensor_from_body"), HasSubstr("0.1 m")));
  EXPECT_THAT(calibration_message("/RT_body_from_sensor/0/3", 2000), HasSubstr("metres"));
}

// A camera on its side that looks right has an inverse whose y axis points down. pos_meter decides.
TEST(Calibration, AcceptsUnusualExtrinsicsWhenThePositionAgrees) {
  json document = calibration();
  document["F_CAM"]["RT_body_from_sensor"] = {
      {0, 1, 0, 2}, {0, 0, -1, 0.5}, {-1, 0, 0, 1.5}, {0, 0, 0, 1}};
  document["F_CAM"].erase("RT_sensor_from_body");
  EXPECT_EQ(parsed_calibration(document).size(), 2u);
}

}  // namespace
}  // namespace redrive

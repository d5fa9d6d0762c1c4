// SPDX-License-Identifier: Apache-2.0
// The messages of ROS 2 that a drive is made of (ros2/common_interfaces, geometry2), as far as they
// are used.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "redrive/math/rigid3.h"

namespace redrive::rosbag {

/// Largest time of a stamp, in ns: ROS has 31 bits of seconds.
constexpr std::int64_t kMaxStamp_ns = (std::int64_t{1} << 31) * 1'000'000'000;

/// std_msgs/Header
struct Header {
  std::int64_t t_ns = 0;  ///< 0: not set
  std::string frame;
};

/// sensor_msgs/Image, or CompressedImage, whose size is 0.
struct ImageMessage {
  Header header;
  std::uint32_t width = 0, height = 0, step = 0;
  bool big_endian = false;
  std::string encoding;   ///< "rgb8"; of CompressedImage its format: "rgb8; jpeg compressed bgr8"
  std::size_t size = 0;   ///< bytes of the data
  std::string_view data;  ///< what is there of it
};

struct CameraInfo {
  Header header;
  std::uint32_t width = 0, height = 0;
  std::string model;  ///< "plumb_bob", "rational_polynomial", "equidistant"
  std::vector<double> d;
  std::array<double, 9> k{}, r{};
  std::array<double, 12> p{};
  std::uint32_t binning_x = 0, binning_y = 0;  ///< 0 is 1
  std::uint32_t roi_x = 0, roi_y = 0, roi_width = 0, roi_height = 0;
};

/// sensor_msgs/PointField
struct PointField {
  std::string name;
  std::uint32_t offset = 0;
  std::uint8_t type = 0;  ///< 1 to 8: int8, uint8, int16, uint16, int32, uint32, float32, float64
};

struct PointCloud {
  Header header;
  std::uint32_t width = 0, height = 0, point_step = 0, row_step = 0;
  std::vector<PointField> fields;
  bool big_endian = false;
  std::size_t size = 0;
  std::string_view data;
};

struct Fix {
  Header header;
  bool valid = false;
  double latitude_deg = 0, longitude_deg = 0, altitude_m = 0;
};

struct Orientation {
  Header header;
  std::optional<Eigen::Quaterniond> world_from_sensor;  ///< nothing: the sensor has none
};

/// A transform or a pose: parent_from_child at a time.
struct Transform {
  Header header;      ///< its frame is the parent
  std::string child;  ///< empty: the message does not say
  Rigid3d parent_from_child = Rigid3d::Identity();
};

/// Returns the fields of a type that is read, one line, and what a bag's schema makes of it must be
/// equal to; empty for other types.
std::string_view expected_fields(std::string_view type);
/// Flattens a definition of ros2msg: "int32 header.stamp.sec, uint32 header.stamp.nanosec, ...".
/// InputError: a type that the text does not define, or nested too deeply.
std::string fields_of_schema(std::string_view type, std::string_view text,
                             const std::filesystem::path& bag);

// They throw InputError with topic and field for damaged bytes and impossible numbers. The first
// three may be given a message's start alone.
using Bytes = std::string_view;
using Path = std::filesystem::path;
ImageMessage parse_image(Bytes bytes, const Path& bag, Bytes topic);
ImageMessage parse_compressed_image(Bytes bytes, const Path& bag, Bytes topic);
PointCloud parse_point_cloud(Bytes bytes, const Path& bag, Bytes topic);
CameraInfo parse_camera_info(Bytes bytes, const Path& bag, Bytes topic);
Fix parse_fix(Bytes bytes, const Path& bag, Bytes topic);
Orientation parse_imu(Bytes bytes, const Path& bag, Bytes topic);
/// Odometry, PoseStamped, PoseWithCovarianceStamped, TransformStamped, TFMessage.
bool is_pose_type(std::string_view type);
std::vector<Transform> parse_poses(std::string_view type, Bytes bytes, const Path& bag,
                                   Bytes topic);

}  // namespace redrive::rosbag

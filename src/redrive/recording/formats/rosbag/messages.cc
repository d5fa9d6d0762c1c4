// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/rosbag/messages.h"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <map>
#include <sstream>

#include "redrive/base/error.h"
#include "redrive/recording/formats/rosbag/cdr.h"
#include "redrive/recording/parse/rigid_json.h"

namespace redrive::rosbag {
namespace {

#define REDRIVE_ROS_HEADER \
  "int32 header.stamp.sec, uint32 header.stamp.nanosec, string header.frame_id, "
#define REDRIVE_ROS_VECTOR(name) "float64 " name ".x, float64 " name ".y, float64 " name ".z, "
#define REDRIVE_ROS_POSE(name)         \
  REDRIVE_ROS_VECTOR(name ".position") \
  REDRIVE_ROS_VECTOR(name ".orientation") "float64 " name ".orientation.w, "

constexpr std::pair<std::string_view, std::string_view> kFields[] = {
    {"sensor_msgs/msg/Image",
     REDRIVE_ROS_HEADER "uint32 height, uint32 width, string encoding, uint8 "
                        "is_bigendian, uint32 step, uint8[] data, "},
    {"sensor_msgs/msg/CompressedImage", REDRIVE_ROS_HEADER "string format, uint8[] data, "},
    {"sensor_msgs/msg/CameraInfo", REDRIVE_ROS_HEADER
     "uint32 height, uint32 width, string distortion_model, float64[] d, float64[9] k, "
     "float64[9] r, float64[12] p, uint32 binning_x, uint32 binning_y, uint32 "
     "roi.x_offset, "
     "uint32 roi.y_offset, uint32 roi.height, uint32 roi.width, bool roi.do_rectify, "},
    {"sensor_msgs/msg/PointCloud2", REDRIVE_ROS_HEADER
     "uint32 height, uint32 width, string fields[].name, uint32 fields[].offset, "
     "uint8 fields[].datatype, uint32 fields[].count, bool is_bigendian, uint32 "
     "point_step, "
     "uint32 row_step, uint8[] data, bool is_dense, "},
    {"sensor_msgs/msg/NavSatFix", REDRIVE_ROS_HEADER
     "int8 status.status, uint16 status.service, float64 latitude, float64 longitude, "
     "float64 altitude, float64[9] position_covariance, uint8 "
     "position_covariance_type, "},
    {"sensor_msgs/msg/Imu",
     REDRIVE_ROS_HEADER REDRIVE_ROS_VECTOR(
         "orientation") "float64 orientation.w, "
                        "float64[9] orientation_covariance, " REDRIVE_ROS_VECTOR(
                            "angular_velocity") "float64[9] "
                                                "angular_velocity_covariance,"
                                                " " REDRIVE_ROS_VECTOR("linear_"
                                                                       "acceleratio"
                                                                       "n") "float6"
                                                                            "4[9] "
                                                                            "linear"
                                                                            "_accel"
                                                                            "eratio"
                                                                            "n_"
                                                                            "covari"
                                                                            "ance,"
                                                                            " "},
    {"nav_msgs/msg/Odometry",
     REDRIVE_ROS_HEADER "string child_frame_id, " REDRIVE_ROS_POSE(
         "pose.pose") "float64[36] pose.covariance, " REDRIVE_ROS_VECTOR("twist.twist."
                                                                         "linear")
         REDRIVE_ROS_VECTOR("twist.twist.angular") "float64[36] twist.covariance, "},
    {"geometry_msgs/msg/PoseStamped", REDRIVE_ROS_HEADER REDRIVE_ROS_POSE("pose")},
    {"geometry_msgs/msg/PoseWithCovarianceStamped",
     REDRIVE_ROS_HEADER REDRIVE_ROS_POSE("pose.pose") "float64[36] pose.covariance, "},
    {"geometry_msgs/msg/TransformStamped",
     REDRIVE_ROS_HEADER "string child_frame_id, " REDRIVE_ROS_VECTOR("transform.translation")
         REDRIVE_ROS_VECTOR("transform.rotation") "float64 transform.rotation.w, "},
    {"tf2_msgs/msg/TFMessage",
     "int32 transforms[].header.stamp.sec, uint32 transforms[].header.stamp.nanosec, "
     "string transforms[].header.frame_id, string "
     "transforms[].child_frame_id, " REDRIVE_ROS_VECTOR("transforms[].transform.translation")
         REDRIVE_ROS_VECTOR(
             "transforms[].transform.rotation") "float64 "
                                                "transforms[].transform.rotation.w, "}};

/// Definitions of a schema by their types' names: "std_msgs/Header".
using Definitions = std::map<std::string, std::string_view, std::less<>>;

/// "std_msgs/msg/Header" and "std_msgs/Header" are the same.
std::string without_msg(std::string_view type) {
  std::string name(type);
  if (const auto at = name.find("/msg/"); at != name.npos) name.erase(at, 4);
  return name;
}

bool is_primitive(std::string_view type) {
  constexpr std::string_view kPrimitives[] = {"bool",   "byte",    "char",    "int8",   "uint8",
                                              "int16",  "uint16",  "int32",   "uint32", "int64",
                                              "uint64", "float32", "float64", "string", "wstring"};
  return std::ranges::find(kPrimitives, type) != std::end(kPrimitives);
}

void flatten(const Definitions& definitions, const std::string& type, const std::string& prefix,
             int levels, const std::filesystem::path& bag, int* budget, std::string* out) {
  constexpr int kMostLevels = 8;
  constexpr std::size_t kMostBytes = 1 << 16;
  const auto found = definitions.find(type);
  if (found == definitions.end() || levels > kMostLevels || out->size() > kMostBytes ||
      --*budget < 0)
    throw InputError(bag, "schema", type,
                     found == definitions.end() ? "is not defined by the schema that uses it"
                                                : "is nested too deeply");
  std::istringstream lines{std::string(found->second)};
  for (std::string line; std::getline(lines, line);) {
    line = line.substr(0, line.find('#'));
    std::istringstream words(line);
    std::string of, name;
    if (!(words >> of >> name) || line.find('=') != line.npos) continue;  // a constant
    std::string array;
    if (const auto bracket = of.find('['); bracket != of.npos) {
      array = of.substr(bracket);
      of.erase(bracket);
      if (array.starts_with("[<=")) array = "[]";
    }
    if (const auto bound = of.find("<="); bound != of.npos) of.erase(bound);
    std::ranges::transform(name, name.begin(), [](unsigned char c) { return std::tolower(c); });
    if (is_primitive(of)) {
      *out += of + array + " " + prefix + name + ", ";
      continue;
    }
    std::string full = without_msg(of);
    if (full == "time" || full == "Time") full = "builtin_interfaces/Time";
    if (full == "Header") full = "std_msgs/Header";
    if (full.find('/') == full.npos) full = type.substr(0, type.find('/') + 1) + full;
    flatten(definitions, full, prefix + name + array + ".", levels + 1, bag, budget, out);
  }
}

Header parse_header(CdrReader* cdr) {
  const auto seconds = cdr->number<std::int32_t>("header.stamp.sec");
  const auto nanoseconds = cdr->number<std::uint32_t>("header.stamp.nanosec");
  Header header;
  header.t_ns = std::max<std::int64_t>(
      0, std::int64_t{seconds} * 1'000'000'000 + std::min(nanoseconds, 999'999'999u));
  header.frame = cdr->text("header.frame_id");
  if (header.frame.starts_with('/')) header.frame.erase(0, 1);
  return header;
}

Eigen::Vector3d parse_vector(CdrReader* cdr, const char* field) {
  Eigen::Vector3d v;
  for (double& x : v) x = cdr->number<double>(field);
  return v;
}

Eigen::Quaterniond parse_quaternion(CdrReader* cdr, const char* field) {
  const Eigen::Vector3d v = parse_vector(cdr, field);
  return {cdr->number<double>(field), v.x(), v.y(), v.z()};
}

Rigid3d parse_pose(CdrReader* cdr) {
  constexpr double kMost_m = 1e8;
  const Eigen::Vector3d at = parse_vector(cdr, "position");
  const Eigen::Quaterniond q = parse_quaternion(cdr, "orientation");
  if (!(at.norm() <= kMost_m)) cdr->fail("position", std::to_string(at.norm()), "is at most 1e8 m");
  if (!is_rotation(q)) cdr->fail("orientation", std::to_string(q.norm()), "is a unit quaternion");
  Rigid3d pose = Rigid3d::Identity();
  pose.linear() = q.normalized().toRotationMatrix();
  pose.translation() = at;
  return pose;
}

Transform parse_transform(CdrReader* cdr, bool has_child) {
  Transform transform{parse_header(cdr), {}, Rigid3d::Identity()};
  if (has_child) transform.child = cdr->text("child_frame_id");
  if (transform.child.starts_with('/')) transform.child.erase(0, 1);
  transform.parent_from_child = parse_pose(cdr);
  return transform;
}

}  // namespace

std::string_view expected_fields(std::string_view type) {
  const auto found =
      std::ranges::find(kFields, type, &std::pair<std::string_view, std::string_view>::first);
  return found == std::end(kFields) ? "" : found->second;
}

std::string fields_of_schema(std::string_view type, std::string_view text,
                             const std::filesystem::path& bag) {
  Definitions definitions;
  std::string name = without_msg(type);
  for (std::size_t at = 0; at <= text.size();) {
    const std::size_t line = text.find("\n====", at), end = std::min(line, text.size());
    definitions.emplace(name, text.substr(at, end - at));
    if (line == text.npos) break;
    std::size_t next = text.find('\n', line + 1);
    if (next == text.npos) break;
    const std::string_view head = text.substr(next + 1, text.find('\n', next + 1) - next - 1);
    constexpr std::string_view kHead = "MSG: ";
    if (!head.starts_with(kHead)) break;
    name = without_msg(head.substr(kHead.size()));
    while (!name.empty() && std::isspace(static_cast<unsigned char>(name.back()))) name.pop_back();
    at = std::min(next + 1 + head.size(), text.size());
  }
  std::string out;
  int budget = 1000;  // types in types
  flatten(definitions, without_msg(type), "", 0, bag, &budget, &out);
  return out;
}

ImageMessage parse_image(Bytes bytes, const Path& bag, Bytes topic) {
  CdrReader cdr(bytes, bag, topic);
  ImageMessage image;
  image.header = parse_header(&cdr);
  image.height = cdr.number<std::uint32_t>("height");
  image.width = cdr.number<std::uint32_t>("width");
  image.encoding = cdr.text("encoding");
  image.big_endian = cdr.number<std::uint8_t>("is_bigendian") != 0;
  image.step = cdr.number<std::uint32_t>("step");
  CdrReader ahead = cdr;
  image.size = ahead.length("data");
  image.data = cdr.bytes("data", /*cut=*/true);
  return image;
}

ImageMessage parse_compressed_image(Bytes bytes, const Path& bag, Bytes topic) {
  CdrReader cdr(bytes, bag, topic);
  ImageMessage image;
  image.header = parse_header(&cdr);
  image.encoding = cdr.text("format");
  CdrReader ahead = cdr;
  image.size = ahead.length("data");
  image.data = cdr.bytes("data", /*cut=*/true);
  return image;
}

PointCloud parse_point_cloud(Bytes bytes, const Path& bag, Bytes topic) {
  CdrReader cdr(bytes, bag, topic);
  PointCloud cloud;
  cloud.header = parse_header(&cdr);
  cloud.height = cdr.number<std::uint32_t>("height");
  cloud.width = cdr.number<std::uint32_t>("width");
  constexpr std::size_t kLeastField = 13;
  for (std::size_t n = cdr.count("fields", kLeastField); n > 0; --n) {
    PointField field;
    field.name = cdr.text("fields.name");
    field.offset = cdr.number<std::uint32_t>("fields.offset");
    field.type = cdr.number<std::uint8_t>("fields.datatype");
    cdr.number<std::uint32_t>("fields.count");
    cloud.fields.push_back(std::move(field));
  }
  cloud.big_endian = cdr.number<std::uint8_t>("is_bigendian") != 0;
  cloud.point_step = cdr.number<std::uint32_t>("point_step");
  cloud.row_step = cdr.number<std::uint32_t>("row_step");
  CdrReader ahead = cdr;
  cloud.size = ahead.length("data");
  cloud.data = cdr.bytes("data", /*cut=*/true);
  return cloud;
}

CameraInfo parse_camera_info(Bytes bytes, const Path& bag, Bytes topic) {
  CdrReader cdr(bytes, bag, topic);
  CameraInfo info;
  info.header = parse_header(&cdr);
  info.height = cdr.number<std::uint32_t>("height");
  info.width = cdr.number<std::uint32_t>("width");
  info.model = cdr.text("distortion_model");
  for (std::size_t n = cdr.count("d", sizeof(double)); n > 0; --n)
    info.d.push_back(cdr.number<double>("d"));
  for (double& x : info.k) x = cdr.number<double>("k");
  for (double& x : info.r) x = cdr.number<double>("r");
  for (double& x : info.p) x = cdr.number<double>("p");
  for (std::uint32_t* x : {&info.binning_x, &info.binning_y, &info.roi_x, &info.roi_y,
                           &info.roi_height, &info.roi_width})
    *x = cdr.number<std::uint32_t>("binning_x, binning_y, roi");
  return info;
}

Fix parse_fix(Bytes bytes, const Path& bag, Bytes topic) {
  CdrReader cdr(bytes, bag, topic);
  Fix fix;
  fix.header = parse_header(&cdr);
  const auto status = cdr.number<std::int8_t>("status.status");
  cdr.number<std::uint16_t>("status.service");
  fix.latitude_deg = cdr.number<double>("latitude");
  fix.longitude_deg = cdr.number<double>("longitude");
  fix.altitude_m = cdr.number<double>("altitude");
  fix.valid = status >= 0 && std::abs(fix.latitude_deg) <= 90 &&
              std::abs(fix.longitude_deg) <= 360 && std::abs(fix.altitude_m) <= 1e5;
  return fix;
}

Orientation parse_imu(Bytes bytes, const Path& bag, Bytes topic) {
  CdrReader cdr(bytes, bag, topic);
  Orientation orientation;
  orientation.header = parse_header(&cdr);
  const Eigen::Quaterniond q = parse_quaternion(&cdr, "orientation");
  // sensor_msgs/Imu: -1 says that the sensor has no orientation.
  if (cdr.number<double>("orientation_covariance") != -1 && is_rotation(q))
    orientation.world_from_sensor = q.normalized();
  return orientation;
}

bool is_pose_type(std::string_view type) {
  constexpr std::string_view kTypes[] = {"nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped",
                                         "geometry_msgs/msg/PoseWithCovarianceStamped",
                                         "geometry_msgs/msg/TransformStamped",
                                         "tf2_msgs/msg/TFMessage"};
  return std::ranges::find(kTypes, type) != std::end(kTypes);
}

std::vector<Transform> parse_poses(std::string_view type, Bytes bytes, const Path& bag,
                                   Bytes topic) {
  CdrReader cdr(bytes, bag, topic);
  std::vector<Transform> out;
  if (type != "tf2_msgs/msg/TFMessage")
    return {parse_transform(
        &cdr, type == "nav_msgs/msg/Odometry" || type == "geometry_msgs/msg/TransformStamped")};
  constexpr std::size_t kLeastTransform = 72;
  for (std::size_t n = cdr.count("transforms", kLeastTransform); n > 0; --n)
    out.push_back(parse_transform(&cdr, true));
  return out;
}

}  // namespace redrive::rosbag

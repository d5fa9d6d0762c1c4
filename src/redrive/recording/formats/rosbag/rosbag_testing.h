// SPDX-License-Identifier: Apache-2.0
// A small valid bag with made numbers, for tests, which then break one thing.
#pragma once

#include <cmath>
#include <functional>
#include <map>
#include <numbers>
#include <string>
#include <vector>

#include <sqlite3.h>

#include "redrive/image/jpeg.h"
#include "redrive/math/local_level.h"
#include "redrive/math/so3.h"
#include "redrive/recording/core/recording_testing.h"
#include "redrive/recording/formats/rosbag/mcap_testing.h"

namespace redrive::testing {

/// Definitions as ROS 2 Humble ships them, comments shortened.
inline std::string ros_definition(const std::string& type) {
  const std::string line = "\n" + std::string(80, '=') + "\n";
  const std::string time = line +
                           "MSG: builtin_interfaces/Time\n# seconds\nint32 sec\n\nuint32 nanosec\n",
                    header = line +
                             "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\n\n"
                             "# Transform frame with which this data is associated.\n"
                             "string frame_id\n" +
                             time,
                    vector = line + "MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n",
                    quaternion = line +
                                 "MSG: geometry_msgs/Quaternion\nfloat64 x 0\nfloat64 y 0\n"
                                 "float64 z 0\nfloat64 w 1\n",
                    pose = line +
                           "MSG: geometry_msgs/Pose\nPoint position\nQuaternion orientation\n" +
                           line + "MSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n" +
                           quaternion,
                    transform = line +
                                "MSG: geometry_msgs/Transform\nVector3 translation\n"
                                "Quaternion rotation\n" +
                                vector + quaternion,
                    stamped =
                        "std_msgs/Header header\nstring child_frame_id\nTransform transform\n";
  const std::map<std::string, std::string> definitions = {
      {"sensor_msgs/msg/Image",
       "std_msgs/Header header # stamp\nuint32 height\nuint32 width\nstring encoding\n"
       "uint8 is_bigendian\nuint32 step\nuint8[] data\n" +
           header},
      {"sensor_msgs/msg/CompressedImage",
       "std_msgs/Header header\nstring format\nuint8[] data\n" + header},
      {"sensor_msgs/msg/CameraInfo",
       "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\n"
       "float64[] d\nfloat64[9]  k # 3x3\nfloat64[9]  r\nfloat64[12] p\nuint32 binning_x\n"
       "uint32 binning_y\nRegionOfInterest roi\n" +
           header + line +
           "MSG: sensor_msgs/RegionOfInterest\nuint32 x_offset\nuint32 y_offset\nuint32 height\n"
           "uint32 width\nbool do_rectify\n"},
      {"sensor_msgs/msg/PointCloud2",
       "std_msgs/Header header\nuint32 height\nuint32 width\nPointField[] fields\n"
       "bool    is_bigendian\nuint32  point_step\nuint32  row_step\nuint8[] data\nbool is_dense\n" +
           header + line +
           "MSG: sensor_msgs/PointField\nuint8 INT8    = 1\nuint8 FLOAT64 = 8\nstring name\n"
           "uint32 offset\nuint8  datatype\nuint32 count\n"},
      {"sensor_msgs/msg/NavSatFix",
       "std_msgs/Header header\nsensor_msgs/NavSatStatus status\nfloat64 latitude\n"
       "float64 longitude\nfloat64 altitude\nfloat64[9] position_covariance\n"
       "uint8 COVARIANCE_TYPE_UNKNOWN = 0\nuint8 position_covariance_type\n" +
           header + line +
           "MSG: sensor_msgs/NavSatStatus\nint8 STATUS_NO_FIX =  -1\nint8 status\n"
           "uint16 SERVICE_GPS = 1\nuint16 service\n"},
      {"sensor_msgs/msg/Imu",
       "std_msgs/Header header\ngeometry_msgs/Quaternion orientation\n"
       "float64[9] orientation_covariance\ngeometry_msgs/Vector3 angular_velocity\n"
       "float64[9] angular_velocity_covariance\ngeometry_msgs/Vector3 linear_acceleration\n"
       "float64[9] linear_acceleration_covariance\n" +
           header + vector + quaternion},
      {"nav_msgs/msg/Odometry",
       "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n"
       "geometry_msgs/TwistWithCovariance twist\n" +
           header + pose + vector + line +
           "MSG: geometry_msgs/PoseWithCovariance\nPose pose\nfloat64[36] covariance\n" + line +
           "MSG: geometry_msgs/TwistWithCovariance\nTwist twist\nfloat64[36] covariance\n" + line +
           "MSG: geometry_msgs/Twist\nVector3 linear\nVector3 angular\n"},
      {"geometry_msgs/msg/PoseStamped", "std_msgs/Header header\nPose pose\n" + header + pose},
      {"tf2_msgs/msg/TFMessage", "geometry_msgs/TransformStamped[] transforms\n" + line +
                                     "MSG: geometry_msgs/TransformStamped\n" + stamped + header +
                                     transform}};
  return definitions.at(type);
}

struct RosDriveOptions {
  bool big_endian = false, tf = true, odometry = false, fixes = false, pose_stamped = false;
  std::string second_lidar;  ///< frame of a second cloud; empty: none
  std::string left_frame = "left_optical";
  std::string point_time = "t";  ///< "t": ns; "time": s; "timestamp": s since the epoch
};

/// Ten images of three cameras and six scans at 10 Hz. The car drives along a line at 8 m/s while
/// it turns evenly, which linear interpolation has exactly. Poses come at 50 Hz, not with the
/// images.
class RosDrive {
 public:
  static constexpr int kFrames = 10, kScans = 6, kPoints = 90, kBeams = 3, kWithoutReturn = 5;
  static constexpr std::int64_t kFirst_ns = 1'700'000'000'123'456'789, kStep_ns = 100'000'000;
  static constexpr const char *kFront = "/cam/front/image_raw",
                              *kLeft = "/cam/left/image_raw/compressed",
                              *kRear = "/cam/rear/image_raw", *kPoints2 = "/lidar/points";

  struct Message {
    std::string topic, type;
    std::int64_t log_ns;
    std::string bytes;
  };
  using Options = RosDriveOptions;

  explicit RosDrive(Options options = {}) : options_(options) {
    add_static();
    for (int f = 0; f < kFrames; ++f) add_images(f);
    for (int s = 0; s < kScans; ++s) add_scan(s, kPoints2, "lidar", kPoints);
    if (!options_.second_lidar.empty())
      for (int s = 0; s < kScans; ++s)
        add_scan(s, "/rear/points", options_.second_lidar, kPoints / 3);
    for (std::int64_t t = kFirst_ns - 53'000'000; t < t_ns(kFrames); t += 20'000'000) add_pose(t);
    // Recorders get messages in no order of their stamps.
    for (std::size_t i = 0; i + 3 < messages.size(); i += 4)
      std::swap(messages[i], messages[i + 3]);
  }

  static std::int64_t t_ns(int frame) { return kFirst_ns + frame * kStep_ns; }
  static std::int64_t offset_ns(const std::string& camera) {
    return camera == "left" ? 4'000'000 : 0;
  }
  static Rigid3d world_from_body(std::int64_t t) {
    const double t_s = 1e-9 * static_cast<double>(t - kFirst_ns);
    Rigid3d pose = Rigid3d::Identity();
    pose.linear() = so3_exp({0.01, -0.02, 0.7}) * so3_exp(t_s * Eigen::Vector3d(0.01, 0.02, 0.3));
    pose.translation() = Eigen::Vector3d(52, 24, 6) + t_s * Eigen::Vector3d(6, 5, 0.3);
    return pose;
  }
  /// body_from_sensor as the tf of the bag has it, with the middle frame `roof`.
  static Rigid3d place(const std::string& sensor) {
    Eigen::Matrix3d axes;  // axes of a camera that looks ahead
    axes << 0, 0, 1, -1, 0, 0, 0, -1, 0;
    Rigid3d pose = Rigid3d::Identity();
    const double yaw = sensor == "left"                             ? 1.2
                       : sensor == "rear" || sensor == "lidar_rear" ? 3.0
                                                                    : 0.05;
    pose.linear() = so3_exp({0.01, -0.02, yaw});
    if (!sensor.starts_with("lidar")) pose.linear() *= axes;
    pose.translation() = Eigen::Vector3d(1.3 + 0.3 * std::cos(yaw), 0.3 * std::sin(yaw), 1.4);
    return pose;
  }
  static Rigid3d roof() {
    Rigid3d pose = Rigid3d::Identity();
    pose.linear() = so3_exp({0, 0.03, 0.1});
    pose.translation() = Eigen::Vector3d(0.5, 0, 1.6);
    return pose;
  }
  /// A point in the LiDAR's axes, as 32 bits have it.
  static Eigen::Vector3d point(int scan, int i) {
    const double azimuth = -2 * std::numbers::pi * i / kPoints;
    const Eigen::Vector3d p(9 * std::cos(azimuth), 9 * std::sin(azimuth),
                            0.2 * (i % kBeams) + 0.1 * scan);
    return p.cast<float>().cast<double>();
  }
  static std::int64_t point_ns(int scan, int i) { return t_ns(scan) + 10'000'000 + i * 900'000; }
  static Geodetic fix_at(std::int64_t t) {
    const Eigen::Vector3d at = world_from_body(t).translation();
    return {0.85 + at.y() * 1.5e-7, 0.2 + at.x() * 2.4e-7, 300 + at.z()};
  }

  std::map<std::string, std::string> types() const {
    std::map<std::string, std::string> found;
    for (const Message& message : messages) found[message.topic] = message.type;
    return found;
  }
  /// Writes the messages [first, last) as one file.
  std::string mcap(McapWriter::Options options = {}, std::size_t first = 0,
                   std::size_t last = SIZE_MAX) const {
    McapWriter writer(options);
    std::map<std::string, std::uint16_t> channels;
    for (const auto& [topic, type] : types())
      channels[topic] = writer.channel(topic, type, schema_of(type));
    for (std::size_t i = first; i < std::min(last, messages.size()); ++i)
      writer.message(channels.at(messages[i].topic), messages[i].log_ns, messages[i].bytes);
    return writer.finish();
  }
  void write_sqlite(const std::filesystem::path& file) const {
    sqlite3* db = nullptr;
    sqlite3_open(file.c_str(), &db);
    sqlite3_exec(db,
                 "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT "
                 "NULL, serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);"
                 "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, "
                 "timestamp INTEGER NOT NULL, data BLOB NOT NULL); BEGIN",
                 nullptr, nullptr, nullptr);
    std::map<std::string, int> ids;
    for (const auto& [topic, type] : types()) {
      ids.emplace(topic, static_cast<int>(ids.size()) + 1);
      const std::string row = "INSERT INTO topics VALUES(" + std::to_string(ids[topic]) + ",'" +
                              topic + "','" + type + "','cdr','')";
      sqlite3_exec(db, row.c_str(), nullptr, nullptr, nullptr);
    }
    sqlite3_stmt* insert = nullptr;
    sqlite3_prepare_v2(db, "INSERT INTO messages(topic_id, timestamp, data) VALUES(?,?,?)", -1,
                       &insert, nullptr);
    for (const Message& message : messages) {
      sqlite3_bind_int(insert, 1, ids[message.topic]);
      sqlite3_bind_int64(insert, 2, message.log_ns);
      sqlite3_bind_blob(insert, 3, message.bytes.data(), static_cast<int>(message.bytes.size()),
                        SQLITE_STATIC);
      sqlite3_step(insert);
      sqlite3_reset(insert);
    }
    sqlite3_finalize(insert);
    sqlite3_exec(db, "COMMIT", nullptr, nullptr, nullptr);
    sqlite3_close(db);
  }

  static Image8 image(int frame, int seed) {
    Image8 image{64, 48, {}, {}, {}};
    for (int y = 0; y < 48; ++y)
      for (int x = 0; x < 64; ++x)
        for (int c = 0; c < 3; ++c)
          image.rgb.push_back(static_cast<std::uint8_t>(40 + x + y + 30 * c * seed % 70 + frame));
    return image;
  }

  std::vector<Message> messages;
  std::function<std::string(const std::string& type)> schema_of = ros_definition;

  void add(const std::string& topic, const std::string& type, std::int64_t log_ns,
           const CdrWriter& cdr) {
    messages.push_back({topic, type, log_ns, cdr.bytes()});
  }
  CdrWriter cdr() const { return CdrWriter(options_.big_endian); }
  static void add_transform(std::int64_t t, const std::string& parent, const std::string& child,
                            const Rigid3d& pose, CdrWriter* out) {
    out->header(t, parent).text(child);
    add_pose_to(pose, out);
  }
  static void add_pose_to(const Rigid3d& pose, CdrWriter* out) {
    const Eigen::Quaterniond q(pose.linear());
    const Eigen::Vector3d& p = pose.translation();
    out->doubles({p.x(), p.y(), p.z(), q.x(), q.y(), q.z(), q.w()});
  }
  void add_image(const std::string& topic, std::int64_t t, const std::string& frame,
                 const Image8& image, const std::string& encoding, const std::string& data,
                 std::uint32_t step) {
    CdrWriter out = cdr();
    out.header(t, frame)
        .add<std::uint32_t>(static_cast<std::uint32_t>(image.height))
        .add<std::uint32_t>(static_cast<std::uint32_t>(image.width))
        .text(encoding)
        .add<std::uint8_t>(0)
        .add<std::uint32_t>(step)
        .blob(data);
    add(topic, "sensor_msgs/msg/Image", t + 7'000'000, out);
  }
  void add_info(const std::string& topic, std::int64_t t, const std::string& frame,
                const std::string& model, const std::vector<double>& d, double scale = 1,
                std::uint32_t binning = 0) {
    CdrWriter out = cdr();
    out.header(t, frame)
        .add<std::uint32_t>(static_cast<std::uint32_t>(48 * scale))
        .add<std::uint32_t>(static_cast<std::uint32_t>(64 * scale))
        .text(model)
        .add<std::uint32_t>(static_cast<std::uint32_t>(d.size()));
    const double fx = 50.5 * scale, fy = 51.25 * scale, cx = (31.75 + 0.5) * scale - 0.5,
                 cy = (23.25 + 0.5) * scale - 0.5;
    out.doubles(d)
        .doubles({fx, 0, cx, 0, fy, cy, 0, 0, 1, 1, 0, 0, 0, 1, 0, 0, 0, 1})
        .doubles({fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0});
    for (const std::uint32_t x : {binning, binning, 0u, 0u, 0u, 0u}) out.add(x);
    out.add<std::uint8_t>(0);
    add(topic, "sensor_msgs/msg/CameraInfo", t + 6'000'000, out);
  }

 private:
  void add_static() {
    CdrWriter out = cdr();
    out.add<std::uint32_t>(6);
    const auto link = [&](const char* parent, const char* child, const Rigid3d& pose) {
      add_transform(0, parent, child, pose, &out);
    };
    link("base_link", "roof", roof());
    link("roof", "left_optical", roof().inverse() * place("left"));
    link("base_link", "front_optical", place("front"));
    link("base_link", "rear_optical", place("rear"));
    link("roof", "lidar", roof().inverse() * place("lidar"));
    link("roof", "lidar_rear", roof().inverse() * place("lidar_rear"));
    add("/tf_static", "tf2_msgs/msg/TFMessage", kFirst_ns - 1'000'000'000, out);
  }
  void add_images(int f) {
    const Image8 front = image(f, 1), left = image(f, 2), rear = image(f, 0);
    std::string bgr, bayer;
    for (std::size_t y = 0; y < 48; ++y) {
      for (std::size_t x = 0; x < 64; ++x) {
        const std::uint8_t* const rgb = &front.rgb[3 * (64 * y + x)];
        for (const int c : {2, 1, 0}) bgr += static_cast<char>(rgb[c]);
        bayer += static_cast<char>(rear.rgb[3 * (64 * y + x) + (y % 2 + x % 2)]);
      }
      bgr += "pad";
    }
    add_image(kFront, t_ns(f), "front_optical", front, "bgr8", bgr, 3 * 64 + 3);
    add_image(kRear, t_ns(f), "rear_optical", rear, "bayer_rggb8", bayer, 64);
    CdrWriter out = cdr();
    out.header(t_ns(f) + offset_ns("left"), options_.left_frame)
        .text("rgb8; jpeg compressed bgr8")
        .blob(encode_jpeg(left, 95));
    add(kLeft, "sensor_msgs/msg/CompressedImage", t_ns(f) + 9'000'000, out);
    add_info("/cam/front/camera_info", t_ns(f), "front_optical", "plumb_bob",
             {-0.2, 0.03, 0.001, -0.002, 0.01});
    add_info("/cam/left/camera_info", t_ns(f), options_.left_frame, "equidistant",
             {0.02, -0.01, 0.003, -0.001}, 2);
    add_info("/cam/rear/camera_info", t_ns(f), "rear_optical", "rational_polynomial",
             {0.2, -0.1, 0.001, -0.0005, 0.01, 0.5, -0.08, 0.02}, 2, 2);
  }
  void add_scan(int s, const std::string& topic, const std::string& frame, int n) {
    CdrWriter out = cdr();
    const bool seconds = options_.point_time == "time", epoch = options_.point_time == "timestamp";
    const std::uint32_t step = 32;
    out.header(t_ns(s), frame)
        .add<std::uint32_t>(1)
        .add<std::uint32_t>(static_cast<std::uint32_t>(n))
        .add<std::uint32_t>(6);
    const auto field = [&](const std::string& name, std::uint32_t offset, std::uint8_t type) {
      out.text(name).add(offset).add(type).add<std::uint32_t>(1);
    };
    field("x", 0, 7);
    field("y", 4, 7);
    field("z", 8, 7);
    field("intensity", 12, 7);
    field(options_.point_time, 16, epoch ? 8 : seconds ? 7 : 6);
    field("ring", 24, 4);
    std::string data;
    for (int k = 0; k < n; ++k) {
      const int i = (k * 7) % n;
      std::string p;
      for (const double x : point(s, i))
        add_bytes(k == kWithoutReturn ? std::nanf("") : static_cast<float>(x), &p);
      add_bytes(static_cast<float>(2 * i), &p);
      const std::int64_t after_ns = point_ns(s, i) - t_ns(s);
      if (epoch)
        add_bytes(1e-9 * static_cast<double>(point_ns(s, i)), &p);
      else if (seconds)
        add_bytes(static_cast<float>(1e-9 * static_cast<double>(after_ns)), &p);
      else
        add_bytes(static_cast<std::uint32_t>(after_ns), &p);
      p.resize(24);
      add_bytes(static_cast<std::uint16_t>(i % kBeams), &p);
      p.resize(step);
      data += p;
    }
    out.add<std::uint8_t>(0)
        .add(step)
        .add<std::uint32_t>(step * static_cast<std::uint32_t>(n))
        .blob(data)
        .add<std::uint8_t>(0);
    add(topic, "sensor_msgs/msg/PointCloud2", t_ns(s) + 120'000'000, out);
  }
  void add_pose(std::int64_t t) {
    const Rigid3d pose = world_from_body(t);
    if (options_.tf) {
      CdrWriter out = cdr();
      out.add<std::uint32_t>(1);
      add_transform(t, "odom", "base_link", pose, &out);
      add("/tf", "tf2_msgs/msg/TFMessage", t + 1'000'000, out);
    }
    if (options_.odometry) {
      CdrWriter out = cdr();
      add_transform(t, "odom", "roof", pose * roof(), &out);
      out.doubles(std::vector<double>(36 + 6 + 36, 0));
      add("/odometry", "nav_msgs/msg/Odometry", t + 1'000'000, out);
    }
    if (options_.pose_stamped) {
      CdrWriter out = cdr();
      out.header(t, "map");
      add_pose_to(pose, &out);
      add("/pose", "geometry_msgs/msg/PoseStamped", t + 1'000'000, out);
    }
    if (!options_.fixes) return;
    const Geodetic at = fix_at(t);
    CdrWriter fix = cdr(), imu = cdr();
    fix.header(t, "base_link").add<std::int8_t>(0).add<std::uint16_t>(1);
    fix.doubles({at.latitude_rad * 180 / std::numbers::pi,
                 at.longitude_rad * 180 / std::numbers::pi, at.height_m})
        .doubles(std::vector<double>(9, 0))
        .add<std::uint8_t>(0);
    add("/fix", "sensor_msgs/msg/NavSatFix", t + 1'000'000, fix);
    const Eigen::Quaterniond q(pose.linear() * roof().linear());
    imu.header(t, "roof").doubles({q.x(), q.y(), q.z(), q.w()}).doubles(std::vector<double>(33, 0));
    add("/imu", "sensor_msgs/msg/Imu", t + 1'000'000, imu);
  }

  Options options_;
};

}  // namespace redrive::testing

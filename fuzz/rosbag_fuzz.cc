// SPDX-License-Identifier: Apache-2.0
// Messages of ROS 2, their definitions and rig.yaml: parses any bytes or throws an InputError. The
// first byte chooses the kind.
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/image/ppm.h"
#include "redrive/recording/formats/rosbag/bag_images.h"
#include "redrive/recording/formats/rosbag/messages.h"
#include "redrive/recording/formats/rosbag/point_clouds.h"
#include "redrive/recording/formats/rosbag/rig.h"

namespace {

void expect(bool condition) {
  if (!condition) __builtin_trap();
}

void parse(std::uint8_t kind, std::string_view bytes) {
  using namespace redrive;
  using namespace redrive::rosbag;
  constexpr const char* kPoses[] = {"nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped",
                                    "geometry_msgs/msg/TransformStamped", "tf2_msgs/msg/TFMessage"};
  switch (kind) {
    case '0': {
      const ImageMessage image = parse_image(bytes, "b", "t");
      const std::string ppm = as_ppm(image, kAllBytes, "b");
      expect(parse_ppm_head(ppm).has_value());
      for (const std::size_t most : {std::size_t{5}, std::size_t{100}})
        expect(as_ppm(image, most, "b").size() <= most);
      break;
    }
    case '1': expect(parse_compressed_image(bytes, "b", "t").data.size() <= bytes.size()); break;
    case '2': {
      const PointCloud cloud = parse_point_cloud(bytes, "b", "t");
      const ScanFields fields = propose_fields(cloud, "b");
      for (const LidarPoint& point :
           parse_scan(cloud, fields, cloud.header.t_ns, Rigid3d::Identity(), "b", nullptr))
        expect(point.in_body_m.allFinite());
      break;
    }
    case '3': {
      std::vector<Finding> findings;
      const CameraTopics camera{.name = "c", .image = "i", .info = "t"};
      const CameraInfo info = parse_camera_info(bytes, "b", "t");
      for (const int size : {0, 64})
        expect(calibration_of(camera, info, size, size, "b", &findings).width > 0);
      break;
    }
    case '4': parse_fix(bytes, "b", "t"); break;
    case '5': parse_imu(bytes, "b", "t"); break;
    case '6':
      for (const char* type : kPoses)
        for (const Transform& pose : parse_poses(type, bytes, "b", "t"))
          expect(pose.parent_from_child.matrix().allFinite());
      break;
    case '7': fields_of_schema("sensor_msgs/msg/Image", bytes, "b"); break;
    case '8': expect(!parse_rig(bytes, "rig.yaml").cameras.empty()); break;
    default: break;
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  try {
    parse(data[0], std::string_view(reinterpret_cast<const char*>(data) + 1, size - 1));
  } catch (const redrive::InputError&) {
  }
  return 0;
}

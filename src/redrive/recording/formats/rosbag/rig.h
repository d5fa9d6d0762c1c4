// SPDX-License-Identifier: Apache-2.0
// The mapping of a bag's topics to sensors, which stands in rig.yaml beside the bag's files, and is
// proposed where there is none.
#pragma once

#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "redrive/camera/calibration.h"
#include "redrive/recording/formats/rosbag/bag.h"
#include "redrive/recording/formats/rosbag/point_clouds.h"
#include "redrive/recording/formats/rosbag/transforms.h"

namespace redrive::rosbag {

constexpr const char* kRigFile = "rig.yaml";

/// The clock of a message: its header's stamp, or when the recorder got it.
enum class Clock { kHeader, kLog };

/// A sensor's place: a frame of tf, or a transform that rig.yaml has itself.
struct Place {
  std::string frame;
  std::optional<Rigid3d> body_from_sensor;
};

struct CameraTopics {
  std::string name, image, info;
  Place place;
  bool optical = true;     ///< the frame has z forward, as REP 103 wants it; else x forward, z up
  bool rectified = false;  ///< images are rectified: intrinsics are the first columns of P
  double readout_s = 0;
  std::optional<CameraCalibration> intrinsics;  ///< instead of `info`
};

struct LidarTopics {
  std::string name, topic;
  Place place;
  ScanFields scan;
};

struct Rig {
  Clock clock = Clock::kHeader;
  std::string body = "base_link";  ///< its axes: x forward, y left, z up
  double above_ground_m = 0;       ///< height of its origin
  std::string poses;               ///< topic
  std::string world;               ///< parent frame, for tf
  std::string imu;                 ///< topic with the orientation, for NavSatFix
  std::vector<CameraTopics> cameras;
  std::vector<LidarTopics> lidars;
};

/// A mapping that was proposed.
struct Proposal {
  Rig rig;
  std::vector<std::string> questions;  ///< what the bag leaves open, each with its field
  std::vector<Finding> findings;       ///< topics that are not used, and other choices
};

/// What messages of a bag say that a mapping needs.
struct Survey {
  TransformTree transforms;
  std::map<std::string, ImageMessage> images;  ///< first one by topic, without data
  std::map<std::string, CameraInfo> infos;     ///< first one by topic
  std::map<std::string, PointCloud> clouds;    ///< a middle one by topic, without data
  std::map<std::string, ScanFields> scans;     ///< keyed by topic
  std::map<std::string, std::string> frames;   ///< frame of the first message, keyed by topic
  std::map<std::string, double> clock_lag_s;   ///< log time minus stamp of the first, by topic
  std::vector<Finding> findings;
};

/// Reads tf, with times by `clock`, and one message of each other topic that may be used.
/// InputError: the topics' types differ from what ROS 2 defines.
Survey survey(const Bag& bag, Clock clock);

Proposal propose_rig(const Bag& bag, const Survey& survey);

/// Returns the text of a rig.yaml with comments.
std::string rig_text(const Proposal& proposal);
/// InputError names the field. Topics must be in the bag.
Rig parse_rig(std::string_view text, const std::filesystem::path& file);

/// Returns the calibration of a camera without its place. InputError: a model that is not known,
/// numbers that no camera has. Images have `width` and `height`; 0: not known. A finding says where
/// it is scaled.
CameraCalibration calibration_of(const CameraTopics& camera, const CameraInfo& info, int width,
                                 int height, const std::filesystem::path& bag,
                                 std::vector<Finding>* findings);
/// Returns body_from_sensor; nothing where it is not known.
std::optional<Rigid3d> place_of(const Place& place, const Rig& rig, const TransformTree& tree);

/// Images that are decoded by read_image: JPEG or PNG of a CompressedImage, or Image::encoding.
bool is_compressed(const Topic& topic);
/// Image or CompressedImage.
bool is_image(const Topic& topic);

}  // namespace redrive::rosbag

// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/rosbag/rosbag.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <map>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/math/upper_median.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/frame_files.h"
#include "redrive/recording/formats/image_size.h"
#include "redrive/recording/formats/recording_reader.h"
#include "redrive/recording/formats/rosbag/contents.h"
#include "redrive/recording/formats/rosbag/pose_topics.h"
#include "redrive/recording/formats/rosbag/rig.h"
#include "redrive/recording/formats/timed_images.h"

namespace redrive::rosbag {
namespace {

namespace fs = std::filesystem;

class Reader : public RecordingReader {
 public:
  std::vector<LidarPoint> read_lidar(const FrameFile& file,
                                     std::size_t* left_out = nullptr) const override {
    return contents->read_scan(file.path, scans.at(file.lidar), body_from_lidar.at(file.lidar),
                               left_out);
  }
  std::uint64_t lidar_point_count(const FrameFile& file) const override {
    return contents->points(file.path);
  }

  std::shared_ptr<Contents> contents;
  std::vector<ScanFields> scans;  ///< one for each LiDAR
  std::vector<Rigid3d> body_from_lidar;
};

const Topic& require_topic(const Bag& bag, const std::string& name, const std::string& field) {
  const Topic* const topic = bag.find(name);
  if (topic && !topic->messages.empty()) return *topic;
  throw InputError(bag.folder() / kRigFile, field, name,
                   topic ? "has no message in the bag" : "is no topic of the bag");
}

/// Returns rig.yaml, or the proposal where it leaves nothing open.
Rig find_rig(const Bag& bag, const Survey& survey, std::vector<Finding>* findings) {
  const fs::path file = bag.folder() / kRigFile;
  if (is_there(file)) return parse_rig(read_file(file), file);
  const Proposal proposal = propose_rig(bag, survey);
  if (!proposal.questions.empty())
    throw InputError(bag.folder(), "", "",
                     "its topics leave open " + first_few(proposal.questions, 9) +
                         "; `redrive inspect --write-rig` writes a " + kRigFile +
                         " into its folder, to be edited");
  findings->insert(findings->end(), proposal.findings.begin(), proposal.findings.end());
  return proposal.rig;
}

std::vector<Contents::Sensor> camera_topics(const Bag& bag, const Rig& rig, const Survey& survey) {
  std::vector<Contents::Sensor> topics;
  for (const CameraTopics& camera : rig.cameras) {
    const std::string field = "cameras." + camera.name;
    const Topic& topic = require_topic(bag, camera.image, field + ".image");
    if (!is_image(topic))
      throw InputError(bag.folder() / kRigFile, field + ".image", topic.type,
                       "is Image or CompressedImage");
    if (!camera.intrinsics && !survey.infos.contains(camera.info))
      throw InputError(bag.folder() / kRigFile, field + ".info", camera.info,
                       "is no topic with a CameraInfo");
    if (!survey.images.contains(camera.image))
      throw InputError(bag.folder(), camera.image, "", "none of its first messages can be read");
    topics.push_back({&topic, camera.name});
  }
  return topics;
}

std::vector<Contents::Sensor> lidar_topics(const Bag& bag, const Rig& rig, const Survey& survey) {
  std::vector<Contents::Sensor> topics;
  for (const LidarTopics& lidar : rig.lidars) {
    const std::string field = "lidars." + lidar.name;
    const Topic& topic = require_topic(bag, lidar.topic, field + ".topic");
    if (topic.type != "sensor_msgs/msg/PointCloud2")
      throw InputError(bag.folder() / kRigFile, field + ".topic", topic.type, "is PointCloud2");
    if (const auto cloud = survey.clouds.find(lidar.topic); cloud != survey.clouds.end())
      for (const auto& [key, name] : {std::pair("time", lidar.scan.time),
                                      {"intensity", lidar.scan.intensity},
                                      {"ring", lidar.scan.ring}})
        if (!name.empty() && std::ranges::find(cloud->second.fields, name, &PointField::name) ==
                                 cloud->second.fields.end())
          throw InputError(bag.folder() / kRigFile, field + "." + key, name,
                           "is no field of " + lidar.topic);
    topics.push_back({&topic, lidar.name});
  }
  return topics;
}

/// Returns body_from_sensor. `otherwise`: the frame of the sensor's messages. `field`: the
/// sensor's, for messages.
Rigid3d require_place(Place place, const std::string& otherwise, const std::string& field,
                      const Rig& rig, const Survey& survey, const Bag& bag) {
  if (place.frame.empty()) place.frame = otherwise;
  if (const auto pose = place_of(place, rig, survey.transforms)) return *pose;
  throw InputError(bag.folder() / kRigFile, field + ".frame", place.frame,
                   "no extrinsic: /tf_static does not lead to it from " + rig.body +
                       "; body_from_sensor gives it");
}

/// `files`: images by camera of the rig.
void add_cameras(const Rig& rig, const Survey& survey, const std::vector<FramePose>& poses,
                 std::vector<std::vector<FrameFile>> files, const Bag& bag, Recording* recording) {
  std::vector<TimedImages> cameras;
  std::map<std::string, CameraCalibration> calibrations;
  for (std::size_t c = 0; c < rig.cameras.size(); ++c) {
    const CameraTopics& camera = rig.cameras[c];
    const ImageMessage& head = survey.images.at(camera.image);
    TimedImages images{camera.name, 0, std::move(files[c])};
    int width = static_cast<int>(head.width), height = static_cast<int>(head.height);
    if (is_compressed(*bag.find(camera.image)) && !images.images.empty())
      if (const auto size = image_size(images.images.front().path))
        width = size->width, height = size->height;
    CameraCalibration calibration =
        calibration_of(camera, camera.intrinsics ? CameraInfo{} : survey.infos.at(camera.info),
                       width, height, bag.folder(), &recording->findings);
    calibration.body_from_sensor =
        require_place(camera.place, head.header.frame, "cameras." + camera.name, rig, survey, bag);
    if (!camera.optical) {
      Eigen::Matrix3d axes;  // axes of a camera that looks ahead
      axes << 0, 0, 1, -1, 0, 0, 0, -1, 0;
      calibration.body_from_sensor.linear() *= axes;
    }
    calibrations[camera.name] = calibration;
    cameras.push_back(std::move(images));
  }
  add_timed_cameras(poses, bag.folder(), {"stamp", "position"}, std::move(cameras), calibrations,
                    kSameImage_ns, recording);
}

/// Adds scans by the frames that are nearest to their middles. `files`: scans by LiDAR of
/// the rig.
void add_scans(const Rig& rig, const Survey& survey, std::vector<std::vector<FrameFile>> files,
               Reader* reader, Recording* recording) {
  for (const auto& [topic, cloud] : survey.clouds) recording->other_sensors.push_back(topic);
  for (std::size_t k = 0; k < rig.lidars.size(); ++k) {
    const LidarTopics& lidar = rig.lidars[k];
    const auto cloud = survey.clouds.find(lidar.topic);
    const Rigid3d pose =
        require_place(lidar.place, cloud == survey.clouds.end() ? "" : cloud->second.header.frame,
                      "lidars." + lidar.name, rig, survey, reader->contents->bag());
    recording->lidars.push_back({lidar.name, pose});
    reader->body_from_lidar.push_back(pose);
    reader->scans.push_back(lidar.scan);
    double middle_s = 0;
    if (const auto seen = survey.scans.find(lidar.topic);
        seen != survey.scans.end() && seen->second.time == lidar.scan.time)
      middle_s = seen->second.middle_s;
    for (FrameFile& scan : files[k]) {
      scan.frame_id += std::llround(1e9 * middle_s);
      scan.lidar = k;
    }
    add_timed_scans(std::move(files[k]), lidar.name, recording);
  }
}

}  // namespace

bool looks_like(const fs::path& root) {
  std::error_code error;
  fs::directory_iterator it(root, error);
  for (const fs::directory_iterator end; !error && it != end; it.increment(error))
    if (has_extension(it->path(), {".mcap", ".db3"}) ||
        (has_extension(it->path(), {".zstd"}) &&
         has_extension(it->path().stem(), {".mcap", ".db3"})))
      return true;
  return false;
}

Recording open(const fs::path& root, PoseSource source) {
  refuse_ground_truth(root, source);
  Recording recording;
  recording.root = root;
  recording.global_frame = GlobalFrame::kArbitrary;
  const auto bag = std::make_shared<const Bag>(root);
  Survey seen = survey(*bag, Clock::kHeader);
  recording.findings = bag->findings();
  const Rig rig = find_rig(*bag, seen, &recording.findings);
  if (rig.clock == Clock::kLog) seen = survey(*bag, Clock::kLog);
  recording.findings.insert(recording.findings.end(), seen.findings.begin(), seen.findings.end());
  const std::vector<FramePose> poses = read_poses(
      *bag, require_topic(*bag, rig.poses, "poses.topic"), rig, seen.transforms, &recording);
  const auto reader = std::make_shared<Reader>();
  reader->contents = std::make_shared<Contents>(bag);
  mount(root, reader->contents);
  std::vector<Contents::Sensor> topics = camera_topics(*bag, rig, seen);
  for (Contents::Sensor& lidar : lidar_topics(*bag, rig, seen)) topics.push_back(std::move(lidar));
  std::vector<std::vector<FrameFile>> files = reader->contents->add(topics, rig.clock, &recording);
  const auto first_lidar = files.begin() + std::ssize(rig.cameras);
  std::vector<std::vector<FrameFile>> scans(std::make_move_iterator(first_lidar),
                                            std::make_move_iterator(files.end()));
  add_cameras(rig, seen, poses, std::move(files), *bag, &recording);
  add_scans(rig, seen, std::move(scans), reader.get(), &recording);
  recording.reader = reader;
  return recording;
}

Mapping mapping(const fs::path& root) {
  const Bag bag(root);
  Mapping out;
  out.file = root / kRigFile;
  out.is_there = is_there(out.file);
  const Survey seen = survey(bag, Clock::kHeader);
  for (const Topic& topic : bag.topics()) {
    Stream stream{topic.name, topic.type, "", topic.messages.size()};
    if (!topic.messages.empty()) {
      stream.first_ns = topic.messages.front().log_ns;
      stream.last_ns = topic.messages.back().log_ns;
    }
    if (const auto frame = seen.frames.find(topic.name); frame != seen.frames.end())
      stream.frame = frame->second;
    out.streams.push_back(std::move(stream));
  }
  if (out.is_there) return out;
  const Proposal proposal = propose_rig(bag, seen);
  out.text = rig_text(proposal);
  out.questions = proposal.questions;
  return out;
}

}  // namespace redrive::rosbag

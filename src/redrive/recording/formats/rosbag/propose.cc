// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <set>

#include "redrive/recording/core/upper_median.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/rosbag/bag_images.h"
#include "redrive/recording/formats/rosbag/rig.h"

namespace redrive::rosbag {
namespace {

/// "/front/image_raw" of "/front/image_raw/compressed".
std::string base_topic(const std::string& topic) {
  for (const char* suffix : {"/compressed", "/image_compressed"})
    if (topic.ends_with(suffix)) return topic.substr(0, topic.size() - std::string(suffix).size());
  return topic;
}

/// "/front" of "/front/image_raw".
std::string folder_of(const std::string& topic) {
  const std::size_t slash = topic.rfind('/');
  return slash == topic.npos ? "" : topic.substr(0, slash);
}

/// "front" of "/sensing/camera/front/image_raw": what tells cameras apart.
std::string camera_name(const std::string& topic) {
  std::string folder = folder_of(base_topic(topic));
  if (folder.empty()) folder = base_topic(topic);
  std::string name = folder.substr(folder.rfind('/') + 1);
  if (name.empty()) name = "camera";
  for (char& c : name)
    if (!std::isalnum(static_cast<unsigned char>(c)) && c != '_' && c != '-') c = '_';
  return name;
}

class Proposer {
 public:
  Proposer(const Bag& bag, const Survey& survey) : bag_(bag), survey_(survey) {}

  Proposal propose() {
    choose_poses();
    choose_cameras();
    choose_lidar();
    choose_clock();
    return std::move(out_);
  }

 private:
  void ask(const std::string& question) { out_.questions.push_back(question); }
  void note(const std::string& subject, const std::string& what) {
    out_.findings.push_back({subject, what});
  }
  std::vector<const Topic*> of_type(std::string_view type) const {
    std::vector<const Topic*> found;
    for (const Topic& topic : bag_.topics())
      if (topic.type == type && !topic.messages.empty()) found.push_back(&topic);
    return found;
  }

  void choose_body() {
    for (const char* name :
         {"base_link", "base_footprint", "ego_vehicle", "vehicle", "body", "imu_link"})
      if (survey_.transforms.has(name)) {
        out_.rig.body = name;
        return;
      }
    const std::vector<std::string> moving = survey_.transforms.moving();
    if (!moving.empty()) out_.rig.body = moving.back();
  }

  void choose_poses() {
    choose_body();
    Rig& rig = out_.rig;
    std::vector<std::string> sources;  // the best first
    std::string world;
    for (const std::string& above : survey_.transforms.ancestors(rig.body))
      if (!survey_.transforms.poses(above, rig.body).empty()) world = above;
    // The farthest frame, map before odom, does not drift.
    if (!world.empty())
      for (const Topic* topic : of_type("tf2_msgs/msg/TFMessage"))
        if (!topic->name.ends_with("tf_static")) sources.push_back(topic->name);
    for (const char* type :
         {"nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped",
          "geometry_msgs/msg/PoseWithCovarianceStamped", "geometry_msgs/msg/TransformStamped"})
      for (const Topic* topic : of_type(type)) sources.push_back(topic->name);
    const std::vector<const Topic*> imus = of_type("sensor_msgs/msg/Imu");
    if (!imus.empty())
      for (const Topic* topic : of_type("sensor_msgs/msg/NavSatFix"))
        sources.push_back(topic->name);
    if (sources.empty()) {
      ask("poses.topic: no source of poses: no moving tf above " + rig.body +
          ", no Odometry, no PoseStamped, no NavSatFix with an Imu");
      return;
    }
    rig.poses = sources.front();
    rig.world = world;
    if (const Topic* topic = bag_.find(rig.poses);
        topic && topic->type == "sensor_msgs/msg/NavSatFix" && !imus.empty()) {
      rig.imu = imus.front()->name;
      if (imus.size() > 1)
        ask("poses.imu: " + counted(imus.size(), "Imu topic") + ", " + rig.imu + " is proposed");
    }
    if (sources.size() > 1)
      ask("poses.topic: " + counted(sources.size(), "source") +
          " of poses: " + first_few(sources, 9) + "; " + rig.poses + " is proposed");
  }

  void choose_cameras() {
    std::map<std::string, std::vector<const Topic*>> by_base;
    for (const Topic& topic : bag_.topics()) {
      if (!is_image(topic) || topic.messages.empty()) continue;
      const auto head = survey_.images.find(topic.name);
      if (head == survey_.images.end()) continue;
      const std::string& encoding = head->second.encoding;
      const bool depth = encoding.find("compressedDepth") != encoding.npos ||
                         topic.name.find("depth") != std::string::npos;
      if (depth || (!is_compressed(topic) && !is_known_encoding(encoding)))
        note(topic.name, "not used: " + (depth ? "depth images" : "encoding " + encoding));
      else
        by_base[base_topic(topic.name)].push_back(&topic);
    }
    std::map<std::string, int> names;
    for (const auto& [base, topics] : by_base) ++names[camera_name(base)];
    for (const auto& [base, topics] : by_base) {
      // The topic with most images; of equal ones the raw one.
      const Topic* best = topics.front();
      for (const Topic* topic : topics)
        if (topic->messages.size() > best->messages.size()) best = topic;
      for (const Topic* topic : topics)
        if (topic != best) note(topic->name, "not used: the same camera as " + best->name);
      CameraTopics camera;
      camera.name = camera_name(base);
      if (names[camera.name] > 1) {
        camera.name = base.substr(1);
        std::ranges::replace(camera.name, '/', '_');
      }
      camera.image = best->name;
      camera.rectified = base.find("rect") != std::string::npos;
      const ImageMessage& head = survey_.images.at(best->name);
      camera.place.frame = head.header.frame;
      choose_info(base, &camera);
      choose_place(&camera);
      out_.rig.cameras.push_back(camera);
    }
    if (out_.rig.cameras.empty()) ask("cameras: no topic with images that can be used");
  }

  void choose_info(const std::string& base, CameraTopics* camera) {
    for (std::string folder = base; !folder.empty(); folder = folder_of(folder))
      if (survey_.infos.contains(folder + "/camera_info")) {
        camera->info = folder + "/camera_info";
        return;
      }
    std::vector<std::string> same;
    for (const auto& [topic, info] : survey_.infos)
      if (info.header.frame == camera->place.frame) same.push_back(topic);
    if (same.size() == 1)
      camera->info = same[0];
    else
      ask("cameras." + camera->name + ".info: no CameraInfo beside " + camera->image +
          "; name its topic, or give intrinsics");
  }

  void choose_place(CameraTopics* camera) {
    std::string& frame = camera->place.frame;
    if (frame.empty() && survey_.infos.contains(camera->info))
      frame = survey_.infos.at(camera->info).header.frame;
    auto pose = survey_.transforms.fixed(out_.rig.body, frame);
    if (!pose) {
      ask("cameras." + camera->name + ".frame: no extrinsic: /tf_static does not lead from " +
          out_.rig.body + " to " +
          (frame.empty() ? "a frame that " + camera->image + " names" : frame) +
          "; name another frame, or give body_from_sensor");
      return;
    }
    // A frame whose z axis points up belongs to the housing: REP 103 gives it x forward.
    constexpr double kUp = 0.8;
    if (pose->linear()(2, 2) < kUp) return;
    for (const char* suffix : {"_optical_frame", "_optical", "_optical_link"})
      if (survey_.transforms.fixed(out_.rig.body, frame + suffix)) {
        note(camera->name, "frame " + frame + " has z up; " + frame + suffix + " is taken");
        frame += suffix;
        return;
      }
    camera->optical = false;
    note(camera->name, "frame " + frame + " has z up: it is taken for x forward, not optical");
  }

  void choose_lidar() {
    std::vector<std::pair<std::uint64_t, std::string>> clouds;  // most points first
    for (const auto& [topic, cloud] : survey_.clouds) {
      const std::uint64_t points = std::uint64_t{cloud.width} * cloud.height;
      if (survey_.scans.at(topic).time.empty() && survey_.scans.at(topic).ring.empty())
        note(topic, "its points have neither time nor ring: such clouds are often no raw scans");
      clouds.emplace_back(points, topic);
    }
    if (clouds.empty()) return;
    const auto raw = [&](const auto& cloud) {
      return !survey_.scans.at(cloud.second).time.empty();
    };
    const auto best = std::ranges::max_element(
        clouds, {}, [&](const auto& cloud) { return std::pair(raw(cloud), cloud.first); });
    Rig& rig = out_.rig;
    rig.lidar = best->second;
    rig.scan = survey_.scans.at(rig.lidar);
    rig.lidar_place.frame = survey_.clouds.at(rig.lidar).header.frame;
    for (const auto& [points, topic] : clouds)
      if (topic != rig.lidar) note(topic, "not used: one LiDAR is, " + rig.lidar);
    if (rig.scan.time.empty())
      note(rig.lidar, "no time of single points: all have the time of their scan");
    if (!survey_.transforms.fixed(rig.body, rig.lidar_place.frame))
      ask("lidar.frame: no extrinsic: /tf_static does not lead from " + rig.body + " to " +
          rig.lidar_place.frame + "; name another frame, or give body_from_sensor");
  }

  /// Messages reach the recorder within a second after their stamp, unless clocks differ.
  void choose_clock() {
    constexpr double kMostLag_s = 1;
    std::vector<std::string> apart;
    std::size_t stamped = 0, used = 0;
    std::vector<double> lags;
    const auto look = [&](const std::string& topic) {
      if (topic.empty()) return;
      ++used;
      const auto lag = survey_.clock_lag_s.find(topic);
      if (lag == survey_.clock_lag_s.end()) return;
      ++stamped;
      lags.push_back(lag->second);
    };
    for (const CameraTopics& camera : out_.rig.cameras) look(camera.image);
    look(out_.rig.lidar);
    if (used > 0 && stamped == 0) {
      out_.rig.clock = Clock::kLog;
      note("time", "no stamps in the headers: times are when messages were recorded");
      return;
    }
    if (stamped < used)
      ask("time: " + counted(used - stamped, "topic") + " of " + std::to_string(used) +
          " without stamps; log has times for all");
    if (lags.empty()) return;
    const double usual = upper_median(lags);
    const auto compare = [&](const std::string& topic) {
      const auto lag = survey_.clock_lag_s.find(topic);
      if (lag != survey_.clock_lag_s.end() && std::abs(lag->second - usual) > kMostLag_s)
        apart.push_back(topic + " by " + std::to_string(lag->second - usual) + " s");
    };
    for (const CameraTopics& camera : out_.rig.cameras) compare(camera.image);
    compare(out_.rig.lidar);
    if (!apart.empty())
      ask("time: clocks of headers are apart: " + first_few(apart) +
          "; log has the recorder's clock for all");
  }

  const Bag& bag_;
  const Survey& survey_;
  Proposal out_;
};

}  // namespace

Proposal propose_rig(const Bag& bag, const Survey& survey) {
  return Proposer(bag, survey).propose();
}

std::optional<Rigid3d> place_of(const Place& place, const Rig& rig, const TransformTree& tree) {
  std::optional<Rigid3d> pose = place.body_from_sensor;
  if (!pose) pose = tree.fixed(rig.body, place.frame);
  if (!pose) return std::nullopt;
  return Eigen::Translation3d(0, 0, rig.above_ground_m) * *pose;
}

}  // namespace redrive::rosbag

// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <set>
#include <tuple>

#include "redrive/math/upper_median.h"
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
    choose_lidars();
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

  struct Cloud {
    bool timed, ringed;
    std::uint64_t points;
    std::string topic, frame;
    bool placed;  ///< /tf_static leads to its frame
  };

  /// Chooses one cloud of each frame: with times, else with rings, else with most points; the
  /// others are made from it. A cloud in the body's frame is made from others, too, where sensors
  /// have frames of their own. A cloud in a frame that moves, such as a map, is no sensor's.
  void choose_lidars() {
    const Rig& rig = out_.rig;
    std::vector<Cloud> clouds;
    for (const auto& [topic, cloud] : survey_.clouds) {
      const ScanFields& scan = survey_.scans.at(topic);
      const std::string& frame = cloud.header.frame;
      clouds.push_back({!scan.time.empty(), !scan.ring.empty(),
                        std::uint64_t{cloud.width} * cloud.height, topic, frame,
                        survey_.transforms.fixed(rig.body, frame).has_value()});
    }
    std::ranges::stable_sort(clouds, std::ranges::greater(), [](const Cloud& cloud) {
      return std::tuple(cloud.timed, cloud.ringed, cloud.points);
    });
    const auto raw = [](const Cloud& cloud) { return cloud.timed || cloud.ringed; };
    const bool have_placed = std::ranges::any_of(clouds, &Cloud::placed),
               have_frames = std::ranges::any_of(clouds, [&](const Cloud&cloud) {
                 return raw(cloud) && cloud.placed && cloud.frame != rig.body;
               });
    std::vector<const Cloud*> chosen;
    for (const Cloud& cloud : clouds) {
      const auto same = std::ranges::find(chosen, cloud.frame, &Cloud::frame);
      if (same != chosen.end())
        note(cloud.topic, "not used: the same sensor as " + (*same)->topic);
      else if (!cloud.placed && have_placed)
        note(cloud.topic, "not used: /tf_static does not lead to its frame " + cloud.frame);
      else if (!raw(cloud) && !chosen.empty())
        note(cloud.topic, "not used: its points have neither time nor ring");
      else if (cloud.frame == rig.body && have_frames)
        note(cloud.topic,
             "not used: it lies in the frame " + rig.body + ", so it is made from others' scans");
      else
        chosen.push_back(&cloud);
    }
    for (const Cloud* cloud : chosen)
      add_lidar(*cloud, chosen.size() == 1 ? "lidar" : camera_name(cloud->topic));
  }

  void add_lidar(const Cloud& cloud, const std::string& name) {
    Rig& rig = out_.rig;
    LidarTopics lidar{name, cloud.topic, {cloud.frame, {}}, survey_.scans.at(cloud.topic)};
    const auto is_taken = [&] {
      return std::ranges::find(rig.lidars, lidar.name, &LidarTopics::name) != rig.lidars.end() ||
             std::ranges::find(rig.cameras, lidar.name, &CameraTopics::name) != rig.cameras.end();
    };
    if (is_taken()) {
      lidar.name = cloud.topic.substr(1);
      std::ranges::replace(lidar.name, '/', '_');
    }
    if (!cloud.timed)
      note(cloud.topic,
           "no time of single points: all have the time of their scan" +
               std::string(cloud.ringed ? ""
                                        : "; without rings, too, such clouds are often "
                                          "no raw scans"));
    if (!cloud.placed)
      ask("lidars." + lidar.name + ".frame: no extrinsic: /tf_static does not lead from " +
          rig.body + " to " + cloud.frame + "; name another frame, or give body_from_sensor");
    rig.lidars.push_back(std::move(lidar));
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
    for (const LidarTopics& lidar : out_.rig.lidars) look(lidar.topic);
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
    for (const LidarTopics& lidar : out_.rig.lidars) compare(lidar.topic);
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

// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/rosbag/contents.h"

#include <algorithm>
#include <mutex>

#include "redrive/base/error.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/rosbag/bag_images.h"
#include "redrive/recording/formats/rosbag/point_clouds.h"

namespace redrive::rosbag {
namespace {

constexpr std::size_t kMessageStart = 1024;  // header, encoding, fields of points

}  // namespace

Contents::Named Contents::entry_of(const Topic& topic, std::string_view head,
                                   const std::filesystem::path& bag, std::int64_t* stamp_ns) {
  Named out;
  if (is_compressed(topic)) {
    const ImageMessage image = parse_compressed_image(head, bag, topic.name);
    *stamp_ns = image.header.t_ns;
    out.entry.size = image.size;
    out.extension = image.data.starts_with("\x89PNG") ? ".png" : ".jpg";
  } else if (is_image(topic)) {
    const ImageMessage image = parse_image(head, bag, topic.name);
    *stamp_ns = image.header.t_ns;
    if (!is_known_encoding(image.encoding))
      throw InputError(bag, topic.name + " encoding", image.encoding, "is not known");
    out.entry.size = ppm_bytes(image);
    out.entry.row_bytes = 3 * image.width;
    out.entry.step = image.step;
    out.extension = ".ppm";
  } else {
    const PointCloud cloud = parse_point_cloud(head, bag, topic.name);
    *stamp_ns = cloud.header.t_ns;
    out.entry.size = std::max<std::size_t>(1, cloud.size);
    const std::size_t most = cloud.point_step == 0 ? 0 : cloud.size / cloud.point_step;
    out.entry.points = std::min<std::uint64_t>(std::uint64_t{cloud.width} * cloud.height, most);
    out.extension = ".cloud";
  }
  return out;
}

std::vector<std::vector<FrameFile>> Contents::add(const std::vector<Sensor>& sensors, Clock clock,
                                                  Recording* recording) {
  struct Of {
    std::size_t sensor, message;
  };
  std::vector<Message> messages;
  std::vector<Of> of;
  for (std::size_t s = 0; s < sensors.size(); ++s)
    for (std::size_t m = 0; m < sensors[s].topic->messages.size(); ++m) {
      messages.push_back(sensors[s].topic->messages[m]);
      of.push_back({s, m});
    }
  std::mutex mutex;
  std::vector<std::vector<FrameFile>> files(sensors.size());
  std::vector<std::size_t> repeated(sensors.size());
  const auto fail = [&](std::size_t i, const InputError& why) {
    const std::lock_guard lock(mutex);
    recording->damaged.push_back({sensors[of[i].sensor].name, -1, why.what()});
  };
  const auto take = [&](std::size_t i, std::string_view bytes) {
    const Sensor& sensor = sensors[of[i].sensor];
    const Topic& topic = *sensor.topic;
    try {
      std::int64_t stamp_ns = 0;
      Named named = entry_of(topic, bytes, bag_->folder(), &stamp_ns);
      const Message& message = messages[i];
      const std::int64_t t_ns = clock == Clock::kLog ? message.log_ns : stamp_ns;
      if (t_ns <= 0)
        throw InputError(bag_->folder(), topic.name + " header.stamp", "0",
                         "is set, or rig.yaml has time: log");
      named.entry.message = message;
      named.entry.topic = &topic;
      named.entry.t_ns = t_ns;
      const std::filesystem::path path =
          bag_->folder() / sensor.name / (std::to_string(t_ns) + named.extension);
      const std::lock_guard lock(mutex);
      const auto [place, is_new] = entries_.emplace(path.string(), named.entry);
      if (is_new) {
        files[of[i].sensor].push_back({t_ns, path});
        return;
      }
      ++repeated[of[i].sensor];
      // Whichever thread comes first, the one that was recorded first stays.
      if (message.log_ns < place->second.message.log_ns) place->second = named.entry;
    } catch (const InputError& error) {
      fail(i, error);
    }
  };
  bag_->read(messages, kMessageStart, take, fail);
  std::ranges::sort(recording->damaged, {}, [](const DamagedRecord& record) {
    return std::pair(record.sensor, record.why);
  });
  for (std::size_t s = 0; s < sensors.size(); ++s) {
    if (repeated[s] > 0)
      recording->findings.push_back(
          {sensors[s].name, counted(repeated[s], "message") +
                                " left out, at the time of another one of " +
                                sensors[s].topic->name});
    std::ranges::sort(files[s], {}, &FrameFile::frame_id);
  }
  return files;
}

std::vector<LidarPoint> Contents::read_scan(const std::filesystem::path& path,
                                            const ScanFields& fields,
                                            const Rigid3d& body_from_lidar,
                                            std::size_t* left_out) const {
  const Entry& entry = entries_.at(path.string());
  const std::string bytes = bag_->read(entry.message);
  const PointCloud cloud = parse_point_cloud(bytes, bag_->folder(), entry.topic->name);
  return parse_scan(cloud, fields, entry.t_ns, body_from_lidar, path, left_out);
}

std::uint64_t Contents::points(const std::filesystem::path& path) const {
  return entries_.at(path.string()).points;
}

std::optional<std::uint64_t> Contents::size(const std::filesystem::path& path) const {
  const auto entry = entries_.find(path.string());
  return entry == entries_.end() ? std::nullopt : std::optional(entry->second.size);
}

std::string Contents::read(const std::filesystem::path& path, std::size_t most) const {
  const Entry& entry = entries_.at(path.string());
  const Topic& topic = *entry.topic;
  std::size_t wanted = kAllBytes;
  if (most < entry.size && entry.row_bytes == 0) wanted = kMessageStart + most;
  if (most < entry.size && entry.row_bytes > 0)  // rows around are needed for patterns of colours
    wanted = kMessageStart + (most / entry.row_bytes + 8) * entry.step;
  const std::string bytes = bag_->read(entry.message, wanted);
  if (is_compressed(topic))
    return std::string(
        parse_compressed_image(bytes, bag_->folder(), topic.name).data.substr(0, most));
  if (is_image(topic)) return as_ppm(parse_image(bytes, bag_->folder(), topic.name), most, path);
  return bytes.substr(0, most);
}

}  // namespace redrive::rosbag

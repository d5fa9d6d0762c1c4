// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <mutex>

#include "redrive/base/error.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/rosbag/bag_images.h"
#include "redrive/recording/formats/rosbag/rig.h"

namespace redrive::rosbag {
namespace {

/// InputError unless the topic's messages are what ROS 2 defines for its type.
void check_type(const Topic& topic, const std::filesystem::path& bag) {
  if (!topic.encoding.empty() && topic.encoding != "cdr")
    throw InputError(bag, topic.name, topic.encoding,
                     "is cdr" + std::string(topic.encoding == "ros1"
                                                ? "; this is a bag of ROS 1, which rosbags-convert "
                                                  "(PyPI: rosbags) turns into one of ROS 2"
                                                : ""));
  if (topic.schema_encoding != "ros2msg" || topic.schema.empty()) return;
  const std::string fields = fields_of_schema(topic.type, topic.schema, bag);
  const std::string_view expected = expected_fields(topic.type);
  if (fields == expected) return;
  const auto [at, other] = std::ranges::mismatch(fields, expected);
  const auto from = [](const auto& text, std::size_t i) {
    std::size_t start = text.rfind(", ", i);
    start = start == text.npos ? 0 : start + 2;
    return std::string(text.substr(start, text.find(", ", i) - start));
  };
  const auto i = static_cast<std::size_t>(at - fields.begin());
  throw InputError(bag, topic.name + " " + topic.type,
                   i < fields.size() ? from(fields, i) : "the end",
                   "its schema differs there from ROS 2, which has " +
                       (i < expected.size() ? from(expected, i) : "the end"));
}

void add_transforms(const Bag& bag, const Topic& topic, Clock clock, Survey* out) {
  const std::size_t n = topic.messages.size();
  std::vector<std::vector<Transform>> transforms(n);
  std::mutex mutex;
  std::vector<std::string> damaged;
  const auto fail = [&](std::size_t, const InputError& why) {
    const std::lock_guard lock(mutex);
    damaged.push_back(why.what());
  };
  bag.read(
      topic.messages, kAllBytes,
      [&](std::size_t i, std::string_view bytes) {
        try {
          transforms[i] = parse_poses(topic.type, bytes, bag.folder(), topic.name);
        } catch (const InputError& error) {
          fail(i, error);
        }
      },
      fail);
  const bool is_static = topic.name.ends_with("tf_static");
  for (std::size_t i = 0; i < n; ++i)
    for (Transform& transform : transforms[i]) {
      if (clock == Clock::kLog) transform.header.t_ns = topic.messages[i].log_ns;
      out->transforms.add(transform, is_static);
    }
  if (!damaged.empty())
    out->findings.push_back({topic.name, counted(damaged.size(), "message") + " of " +
                                             std::to_string(n) +
                                             " left out: " + first_few(damaged, 1)});
}

/// Calls `parse`, which returns the header, for messages from the given one on until one is not
/// damaged.
template <class Parse>
bool first_usable(const Bag& bag, const Topic& topic, std::size_t from, std::size_t most,
                  const Parse& parse, Survey* out) {
  constexpr std::size_t kTried = 20;
  for (std::size_t i = from; i < std::min(topic.messages.size(), from + kTried); ++i) try {
      const Header header = parse(bag.read(topic.messages[i], most));
      out->frames[topic.name] = header.frame;
      if (header.t_ns > 0)
        out->clock_lag_s[topic.name] = 1e-9 * double(topic.messages[i].log_ns - header.t_ns);
      return true;
    } catch (const InputError& error) {
      if (i == from) out->findings.push_back({topic.name, error.what()});
    }
  return false;
}

}  // namespace

bool is_compressed(const Topic& topic) { return topic.type == "sensor_msgs/msg/CompressedImage"; }
bool is_image(const Topic& topic) {
  return topic.type == "sensor_msgs/msg/Image" || is_compressed(topic);
}

Survey survey(const Bag& bag, Clock clock) {
  constexpr std::size_t kHead = 4096;
  Survey out;
  const Path& path = bag.folder();
  for (const Topic& topic : bag.topics()) {
    if (expected_fields(topic.type).empty() || topic.messages.empty()) continue;
    check_type(topic, path);
    if (topic.type == "tf2_msgs/msg/TFMessage") add_transforms(bag, topic, clock, &out);
    if (is_image(topic))
      first_usable(
          bag, topic, 0, kHead,
          [&](const std::string& bytes) {
            ImageMessage image = is_compressed(topic)
                                     ? parse_compressed_image(bytes, path, topic.name)
                                     : parse_image(bytes, path, topic.name);
            image.data = {};
            return (out.images[topic.name] = std::move(image)).header;
          },
          &out);
    if (topic.type == "sensor_msgs/msg/CameraInfo")
      first_usable(
          bag, topic, 0, kAllBytes,
          [&](const std::string& bytes) {
            return (out.infos[topic.name] = parse_camera_info(bytes, path, topic.name)).header;
          },
          &out);
    if (topic.type == "sensor_msgs/msg/PointCloud2")
      first_usable(
          bag, topic, topic.messages.size() / 2, kAllBytes,
          [&](const std::string& bytes) {
            PointCloud cloud = parse_point_cloud(bytes, path, topic.name);
            out.scans[topic.name] = propose_fields(cloud, path);
            cloud.data = {};
            return (out.clouds[topic.name] = std::move(cloud)).header;
          },
          &out);
  }
  out.transforms.finish();
  return out;
}

}  // namespace redrive::rosbag

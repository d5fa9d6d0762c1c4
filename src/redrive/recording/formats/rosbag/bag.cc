// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/rosbag/bag.h"

#include <algorithm>
#include <map>
#include <numeric>
#include <tuple>

#include <yaml-cpp/yaml.h>

#include "redrive/base/cpu_features.h"
#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/parallel.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/frame_files.h"
#include "redrive/recording/formats/rosbag/mcap.h"
#include "redrive/recording/formats/rosbag/sqlite_file.h"
#include "redrive/recording/formats/rosbag/unpack.h"

namespace redrive::rosbag {
namespace {

namespace fs = std::filesystem;

constexpr const char* kMetadata = "metadata.yaml";

/// What metadata.yaml says; a bag without one is read, too.
struct Metadata {
  std::vector<std::string> files;
  bool packed_messages = false;
};

Metadata read_metadata(const fs::path& file) {
  Metadata metadata;
  if (!is_there(file)) return metadata;
  constexpr std::uint64_t kMostBytes = 16 << 20;
  try {
    const YAML::Node bag = YAML::Load(read_file(file, kMostBytes))["rosbag2_bagfile_information"];
    if (!bag || !bag.IsMap()) return metadata;
    for (const auto& path : bag["relative_file_paths"])
      metadata.files.push_back(path.as<std::string>());
    const auto word = [&](const char* name) {
      std::string value = bag[name] ? bag[name].as<std::string>("") : "";
      std::ranges::transform(value, value.begin(), [](unsigned char c) { return std::tolower(c); });
      return value;
    };
    const std::string mode = word("compression_mode"), format = word("compression_format");
    metadata.packed_messages = mode == "message";
    if (metadata.packed_messages && format != "zstd")
      throw InputError(file, "compression_format", format, "is zstd where messages are compressed");
  } catch (const YAML::Exception& error) {
    throw InputError(file, "", "", "not usable YAML: " + std::string(error.what()));
  }
  return metadata;
}

std::optional<std::string> unpack_message(std::string_view bytes, std::size_t most) {
  constexpr std::size_t kMost = std::size_t{1} << 30;
  bool given = false;
  return unpack_start(Packing::kZstd, std::min(most, kMost), [&] {
    const std::string part(given ? "" : bytes);
    given = true;
    return part;
  });
}

}  // namespace

Bag::Bag(const fs::path& folder) : folder_(folder) {
  const Metadata metadata = read_metadata(folder / kMetadata);
  packed_messages_ = metadata.packed_messages;
  for (const fs::path& path : list_folder(folder)) {
    if (has_extension(path, {".mcap", ".db3"})) add_file(path);
    if (has_extension(path, {".zstd"}) && has_extension(path.stem(), {".mcap", ".db3"}) &&
        !is_there(folder / path.stem()))
      throw InputError(path, "", "",
                       "is compressed as a whole file; `zstd -d --rm " + path.filename().string() +
                           "` unpacks it");
  }
  if (files_.empty()) throw InputError(folder, "", "", "has no .mcap or .db3 file");
  std::vector<std::string> missing;
  for (const std::string& name : metadata.files)
    if (!is_there(folder / fs::path(name).filename())) missing.push_back(name);
  if (!missing.empty())
    findings_.push_back({kMetadata, counted(missing.size(), "file") +
                                        " that it names are missing: " + first_few(missing)});
  for (Topic& topic : topics_) std::ranges::stable_sort(topic.messages, {}, &Message::log_ns);
  std::ranges::sort(topics_, {}, &Topic::name);
}

void Bag::add_file(const fs::path& path) {
  const auto index = static_cast<std::uint32_t>(files_.size());
  files_.push_back(has_extension(path, {".mcap"}) ? open_mcap(open_bytes(path), path)
                                                  : open_sqlite(path));
  paths_.push_back(path);
  for (const Finding& finding : files_.back()->findings()) findings_.push_back(finding);
  for (const Topic& of_file : files_.back()->topics()) {
    auto topic = std::ranges::find(topics_, of_file.name, &Topic::name);
    if (topic == topics_.end()) {
      topics_.push_back(of_file);
      topic = topics_.end() - 1;
      topic->messages.clear();
    } else if (topic->type != of_file.type) {
      throw InputError(path, of_file.name, of_file.type,
                       "is a topic of " + topic->type + " in a file before");
    }
    for (Message message : of_file.messages) {
      message.file = index;
      topic->messages.push_back(message);
    }
  }
}

const Topic* Bag::find(const std::string& name) const {
  const auto topic = std::ranges::lower_bound(topics_, name, {}, &Topic::name);
  return topic != topics_.end() && topic->name == name ? &*topic : nullptr;
}

void Bag::read_group(std::span<const Message> messages, std::size_t most,
                     const TakeMessage& take) const {
  const BagFile& file = *files_.at(messages[0].file);
  if (!packed_messages_) return file.read(messages, most, take);
  file.read(messages, kAllBytes, [&](std::size_t i, std::string_view bytes) {
    const auto unpacked = unpack_message(bytes, most);
    if (!unpacked)
      throw InputError(paths_[messages[0].file], "message", std::to_string(messages[i].log_ns),
                       "has damaged Zstandard");
    take(i, *unpacked);
  });
}

std::string Bag::read(const Message& message, std::size_t most) const {
  std::string out;
  read_group(std::span(&message, 1), most,
             [&](std::size_t, std::string_view bytes) { out = bytes; });
  return out;
}

void Bag::read(std::span<const Message> messages, std::size_t most, const TakeMessage& take,
               const std::function<void(std::size_t, const InputError&)>& fail) const {
  const auto place = [&](std::size_t i) {
    return std::tuple(messages[i].file, messages[i].chunk, messages[i].offset);
  };
  std::vector<std::size_t> order(messages.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::ranges::sort(order, {}, place);
  std::vector<Message> sorted;
  for (const std::size_t i : order) sorted.push_back(messages[i]);
  constexpr std::size_t kMostInGroup = 256;
  std::vector<std::size_t> starts;
  for (std::size_t i = 0; i < sorted.size(); ++i)
    if (i == 0 || i - starts.back() >= kMostInGroup || sorted[i].file != sorted[i - 1].file ||
        sorted[i].chunk != sorted[i - 1].chunk)
      starts.push_back(i);
  starts.push_back(sorted.size());
  ThreadPool pool(hardware_threads());
  pool.run(static_cast<int>(starts.size()) - 1, [&](int g) {
    const std::size_t first = starts[std::size_t(g)], end = starts[std::size_t(g) + 1];
    const std::span<const Message> all(sorted);
    std::vector<bool> taken(end - first, false);
    const auto read_part = [&](std::size_t from, std::size_t to) {
      read_group(all.subspan(from, to - from), most, [&](std::size_t i, std::string_view bytes) {
        taken[from + i - first] = true;
        take(order[from + i], bytes);
      });
    };
    if (!fail) return read_part(first, end);
    try {
      return read_part(first, end);
    } catch (const InputError&) {  // one of them is damaged
    }
    for (std::size_t i = first; i < end; ++i) try {
        if (!taken[i - first]) read_part(i, i + 1);
      } catch (const InputError& error) {
        fail(order[i], error);
      }
  });
}

}  // namespace redrive::rosbag

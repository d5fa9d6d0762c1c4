// SPDX-License-Identifier: Apache-2.0
// Tables of nuScenes, one after the other with a zero between them, in the order of kTables: reads
// any bytes or throws an InputError. Blocks of any size find the same records.
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/recording/formats/nuscenes/nuscenes_boxes.h"

namespace {

constexpr std::string_view kTables[] = {"scene",    "sample",   "sample_data",
                                        "sensor",   "ego_pose", "calibrated_sensor",
                                        "instance", "category", "sample_annotation"};

/// Records of a text, or an error, as one text.
std::string scanned(std::string_view text, std::size_t block) {
  std::string records;
  redrive::RecordScanner scanner("t.json", [&](std::string_view record, std::size_t index) {
    records += std::to_string(index) + std::string(record);
  });
  try {
    for (std::size_t i = 0; i < text.size(); i += block) scanner.add(text.substr(i, block));
    scanner.finish();
  } catch (const redrive::InputError& error) {
    records += error.what();
  }
  return records;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  if (scanned(text, 7) != scanned(text, size + 1)) __builtin_trap();
  const auto read = [&](redrive::RecordScanner* scanner) {
    std::string_view rest = text;
    for (const std::string_view table : kTables) {
      const std::string_view here = rest.substr(0, rest.find('\0'));
      if (scanner->file().stem() == table) scanner->add(here);
      rest.remove_prefix(std::min(rest.size(), here.size() + 1));
    }
    scanner->finish();
  };
  try {
    const redrive::nuscenes::SceneTables scene = redrive::nuscenes::read_scene("t", "", read);
    for (const redrive::FramePose& pose : scene.poses)
      if (!redrive::rigid_obstacle(pose.global_from_body.matrix()).empty()) __builtin_trap();
    for (const auto& [id, boxes] :
         redrive::nuscenes::boxes_of_frames(scene, redrive::Rigid3d::Identity(), {}, scene.poses))
      for (const redrive::Box& box : boxes)
        if (!box.body_from_box.matrix().allFinite()) __builtin_trap();
  } catch (const redrive::InputError&) {
  }
  return 0;
}

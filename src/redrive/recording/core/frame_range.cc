// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/core/frame_range.h"

#include <algorithm>
#include <charconv>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/recording/core/excerpt.h"

namespace redrive {
namespace {

std::string text_of(const FrameRange& range) {
  const auto bound = [](std::int64_t id) { return id < 0 ? std::string() : std::to_string(id); };
  return bound(range.first) + ":" + bound(range.last);
}

}  // namespace

FrameRange parse_frame_range(const std::string& text) {
  FrameRange range;
  if (text.empty()) return range;
  const auto fail = [&](const char* rule) { throw UsageError("--frames", text, rule); };
  const auto number = [&](std::string_view part, std::int64_t low) {
    std::int64_t value = 0;
    const auto [end, error] = std::from_chars(part.data(), part.data() + part.size(), value);
    if (error != std::errc() || end != part.data() + part.size() || value < low ||
        value > 1'000'000'000'000)
      fail("must be FIRST:LAST[:STEP], frame ids (either may be empty) and a step of 1 or more");
    return value;
  };
  std::vector<std::string_view> parts;
  for (std::size_t begin = 0; begin <= text.size();) {
    const std::size_t end = std::min(text.find(':', begin), text.size());
    parts.push_back(std::string_view(text).substr(begin, end - begin));
    begin = end + 1;
  }
  if (parts.size() < 2 || parts.size() > 3) fail("must be FIRST:LAST[:STEP]");
  if (!parts[0].empty()) range.first = number(parts[0], 0);
  if (!parts[1].empty()) range.last = number(parts[1], 0);
  if (parts.size() == 3)
    range.step = static_cast<int>(std::min<std::int64_t>(number(parts[2], 1), 1'000'000'000));
  if (range.first >= 0 && range.last >= 0 && range.last < range.first)
    fail("LAST must not be before FIRST");
  return range;
}

std::vector<FramePose> select_frames(const FrameRange& range,
                                     const std::vector<FramePose>& frames) {
  std::vector<FramePose> chosen;
  int index = 0;
  for (const FramePose& frame : frames) {
    if (range.first >= 0 && frame.id < range.first) continue;
    if (range.last >= 0 && frame.id > range.last) continue;
    if (index++ % range.step == 0) chosen.push_back(frame);
  }
  if (chosen.empty())
    throw UsageError("--frames", text_of(range),
                     "selects nothing; the recording has frames " +
                         std::to_string(frames.front().id) + ":" +
                         std::to_string(frames.back().id));
  return chosen;
}

void keep_frames(const FrameRange& range, Recording* recording) {
  if (range.first < 0 && range.last < 0 && range.step == 1) return;
  const std::vector<FramePose> chosen = select_frames(range, recording->frames);
  const auto outside = [&](std::int64_t id) {
    return id < chosen.front().id || id > chosen.back().id;
  };
  drop_foreign_points(*std::ranges::find_if_not(recording->frames, outside, &FramePose::id),
                      recording);
  std::erase_if(recording->frames, [&](const FramePose& frame) { return outside(frame.id); });
  for (RecordedCamera& camera : recording->cameras)
    std::erase_if(camera.images, [&](const ImageFile& image) {
      return !std::ranges::binary_search(chosen, image.frame_id, {}, &FramePose::id);
    });
  std::erase_if(recording->cameras,
                [](const RecordedCamera& camera) { return camera.images.empty(); });
  if (recording->cameras.empty())
    throw UsageError("--frames", text_of(range), "no camera has an image in the chosen frames");
  for (std::vector<FrameFile>* files : {&recording->lidar_files, &recording->box_files})
    std::erase_if(*files, [&](const FrameFile& file) { return outside(file.frame_id); });
  std::erase_if(recording->damaged, [&](const DamagedRecord& record) {
    const std::int64_t id = record.frame_id;  // a damaged pose has no frame
    return id >= 0 && (id < range.first || (range.last >= 0 && id > range.last));
  });
}

}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/files/blocks.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <functional>
#include <numeric>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/json_field.h"
#include "redrive/recording/core/frame_range.h"

namespace redrive {
namespace {

constexpr const char* kBlocksFormat = "redrive-blocks-1";
constexpr std::size_t kMaxBlocks = 100'000;
constexpr double kStep_m = 1;  // above the noise of a position, below the radius of a bend

std::string block_name(std::size_t index) {
  char name[24];
  std::snprintf(name, sizeof name, "%03zu", index);
  return name;
}

/// Frames [first, last] of a core.
struct Core {
  std::size_t first, last;
  double start_m, end_m;
};

/// Cuts the way at multiples of `length_m`. Parts without a frame belong to the core before them.
std::vector<Core> cut(const std::vector<double>& way, double length_m) {
  std::vector<Core> cores;
  const auto parts =
      std::max<std::int64_t>(1, static_cast<std::int64_t>(std::ceil(way.back() / length_m)));
  const double part_m = way.back() / static_cast<double>(parts);
  std::int64_t last = -1;
  for (std::size_t i = 0; i < way.size(); ++i) {
    const std::int64_t part =
        part_m > 0 ? std::min(parts - 1, static_cast<std::int64_t>(way[i] / part_m)) : 0;
    if (part != last) {
      const double start_m = cores.empty() ? 0 : static_cast<double>(part) * part_m;
      if (!cores.empty()) cores.back().end_m = start_m;
      cores.push_back({i, i, start_m, way.back()});
      last = part;
    }
    cores.back().last = i;
  }
  return cores;
}

bool boolean(const JsonField& field) {
  if (!field.json().is_boolean()) field.fail("must be true or false");
  return field.json().get<bool>();
}

Block block_from_json(const JsonField& json, std::size_t index) {
  Block block;
  block.name = json.at("name").string();
  if (block.name != block_name(index)) json.at("name").fail("must be " + block_name(index));
  const auto id = [&](const char* key, std::int64_t least, const char* rule) {
    const std::int64_t value = json.at(key).integer();
    if (value < least) json.at(key).fail(rule);
    return value;
  };
  block.first_frame = id("first_frame", 0, "must not be negative");
  block.first_core = id("first_core", block.first_frame, "must not be before first_frame");
  block.last_core = id("last_core", block.first_core, "must not be before first_core");
  block.last_frame = id("last_frame", block.last_core, "must not be before last_core");
  block.start_m = json.at("start_m").number();
  block.end_m = json.at("end_m").number();
  if (block.end_m < block.start_m) json.at("end_m").fail("must not be before start_m");
  block.finished = boolean(json.at("finished"));
  return block;
}

}  // namespace

double default_overlap_m(double length_m) { return std::min(20.0, length_m / 4); }

std::vector<double> way_driven(const std::vector<PosedFrame>& frames) {
  std::vector<double> way;
  if (frames.empty()) return way;
  Eigen::Vector3d from = frames.front().world_from_body.translation();
  double from_m = 0;
  for (const PosedFrame& frame : frames) {
    const Eigen::Vector3d here = frame.world_from_body.translation();
    const double step_m = (here - from).norm();
    way.push_back(std::max(way.empty() ? 0 : way.back(), from_m + step_m));
    if (step_m < kStep_m) continue;
    from = here;
    from_m = way.back();
  }
  return way;
}

std::vector<Block> divide(const std::vector<PosedFrame>& frames, const Division& division) {
  REDRIVE_CHECK(!frames.empty());
  REDRIVE_CHECK(division.length_m > 0 && division.overlap_m >= 0 && division.frame_multiple >= 1);
  const std::vector<double> way = way_driven(frames);
  const std::vector<Core> cores = cut(way, division.length_m);
  const auto multiple = static_cast<std::size_t>(division.frame_multiple);
  std::vector<Block> blocks;
  for (const Core& core : cores) {
    const auto from = std::ranges::lower_bound(way, core.start_m - division.overlap_m),
               to = std::ranges::upper_bound(way, core.end_m + division.overlap_m);
    auto first = static_cast<std::size_t>(from - way.begin());
    if (core.first > 0) first = std::min(first, core.first - 1);
    first = std::min(first, core.first) / multiple * multiple;
    const std::size_t last = std::max(core.last, static_cast<std::size_t>(to - way.begin()) - 1);
    blocks.push_back({block_name(blocks.size()), frames[first].id, frames[last].id,
                      frames[core.first].id, frames[core.last].id, core.start_m, core.end_m});
  }
  return blocks;
}

std::vector<int> longest_first(const std::vector<Block>& blocks,
                               const std::vector<PosedFrame>& frames) {
  std::vector<std::ptrdiff_t> sizes;
  for (const Block& block : blocks)
    sizes.push_back(std::ranges::upper_bound(frames, block.last_frame, {}, &PosedFrame::id) -
                    std::ranges::lower_bound(frames, block.first_frame, {}, &PosedFrame::id));
  std::vector<int> order(blocks.size());
  std::iota(order.begin(), order.end(), 0);
  std::ranges::stable_sort(order, std::greater<>(), [&](int i) { return sizes[i]; });
  return order;
}

std::filesystem::path blocks_file(const std::filesystem::path& run) { return run / "blocks.json"; }

std::filesystem::path block_folder(const std::filesystem::path& run, const Block& block) {
  return run / "blocks" / block.name;
}

const Block& block_of_frame(const std::vector<Block>& blocks, std::int64_t frame_id) {
  const auto found = std::ranges::lower_bound(blocks, frame_id, {}, &Block::last_core);
  return found == blocks.end() ? blocks.back() : *found;
}

bool is_divided_run(const std::filesystem::path& run) {
  std::error_code error;
  return std::filesystem::exists(blocks_file(run), error);
}

std::vector<Block> read_blocks(const std::filesystem::path& run) {
  return parse_blocks(read_file(blocks_file(run)), blocks_file(run));
}

void write_blocks(const std::filesystem::path& run, const std::vector<Block>& blocks) {
  write_file(blocks_file(run), blocks_text(blocks));
}

std::vector<Block> parse_blocks(std::string_view bytes, const std::filesystem::path& file) {
  const nlohmann::json document = parse_json(bytes, file);
  const JsonField root(document, file);
  if (root.at("format").string() != kBlocksFormat)
    root.at("format").fail(std::string("must be ") + kBlocksFormat);
  const JsonField list = root.at("blocks");
  if (!list.json().is_array() || list.size() == 0 || list.size() > kMaxBlocks)
    list.fail("must be a list of 1 to 100000 blocks");
  std::vector<Block> blocks;
  for (std::size_t i = 0; i < list.size(); ++i) {
    blocks.push_back(block_from_json(list.at(i), i));
    if (i == 0) continue;
    const Block &before = blocks[i - 1], &block = blocks[i];
    if (block.first_core <= before.last_core)
      list.at(i).at("first_core").fail("must be behind the core before it");
    if (block.start_m != before.end_m)
      list.at(i).at("start_m").fail("must be the end_m of the block before it");
  }
  return blocks;
}

std::string blocks_text(const std::vector<Block>& blocks) {
  nlohmann::ordered_json json = {{"format", kBlocksFormat},
                                 {"blocks", nlohmann::ordered_json::array()}};
  for (const Block& block : blocks)
    json["blocks"].push_back({{"name", block.name},
                              {"first_frame", block.first_frame},
                              {"last_frame", block.last_frame},
                              {"first_core", block.first_core},
                              {"last_core", block.last_core},
                              {"start_m", block.start_m},
                              {"end_m", block.end_m},
                              {"finished", block.finished}});
  return json.dump(2) + "\n";
}

TrainOptions block_options(const TrainOptions& whole, const Block& block) {
  TrainOptions options = whole;
  const int step = parse_frame_range(whole.frames).step;
  options.frames = std::to_string(block.first_frame) + ":" + std::to_string(block.last_frame) +
                   (step > 1 ? ":" + std::to_string(step) : "");
  options.refine_poses = "off";
  if (options.max_damaged > 0) options.max_damaged = 100;  // the whole drive was checked
  return options;
}

}  // namespace redrive

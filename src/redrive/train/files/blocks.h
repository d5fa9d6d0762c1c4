// SPDX-License-Identifier: Apache-2.0
// A drive divided into blocks along its way, each of which is trained as a run of its own. A
// divided run is a folder with
//   config.json    options of the whole, without resolved hyperparameters
//   blocks.json    the blocks
//   masks/ poses/  as in a run, for the whole drive; each block links to them
//   blocks/000/    a run: options of the whole with `frames` of its own; missing until it is begun
//   exposure.json  how bright the blocks are among each other (train/files/seam_exposure.h);
//   missing
//                  until all blocks are finished
// All blocks have the same world (Scene::global_from_world) and the same poses of frames.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "redrive/scene/scene.h"
#include "redrive/train/files/options.h"

namespace redrive {

/// A part of the way. The cores of all blocks tile the drive's frames in order.
struct Block {
  std::string name;                              ///< "000", "001", ...: its folder
  std::int64_t first_frame = 0, last_frame = 0;  ///< ids that it trains on, its core's among them
  std::int64_t first_core = 0, last_core = 0;    ///< ids of its core
  double start_m = 0, end_m = 0;                 ///< ends of the core along the way driven
  bool finished = false;                         ///< trained to the end of its options
};

/// How to divide a drive.
struct Division {
  double length_m = 0;   ///< length of a core, at most; > 0
  double overlap_m = 0;  ///< length that a block trains on beyond each end of its core; >= 0
  /// a block begins at a multiple of this number of frames of the drive, so that all blocks hold
  /// out the same ones (--holdout-every); >= 1
  int frame_multiple = 1;
};

/// Returns the overlap for cores of `length_m`: 20 m, at most a quarter. Beyond its frames a block
/// sees only what is further away than the overlap and needs no other detail.
double default_overlap_m(double length_m);

/// Returns the way driven at each frame, in metres from the first one; never decreases. Position
/// noise below a metre adds nothing, so a standing car does not move on.
std::vector<double> way_driven(const std::vector<PosedFrame>& frames);

/// Returns blocks with cores of equal lengths, `length_m` at most, in the order of the drive; one
/// if the way is no longer. A part of the way without a frame makes no block. Each block but the
/// first shares at least one frame with the one before.
std::vector<Block> divide(const std::vector<PosedFrame>& frames, const Division& division);

/// Returns the indices of the blocks in training order: blocks with most of `frames` first, so that
/// a long one does not begin last.
std::vector<int> longest_first(const std::vector<Block>& blocks,
                               const std::vector<PosedFrame>& frames);

std::filesystem::path blocks_file(const std::filesystem::path& run);
std::filesystem::path block_folder(const std::filesystem::path& run, const Block& block);

/// Returns the block whose core has a frame, even one that the run left out.
const Block& block_of_frame(const std::vector<Block>& blocks, std::int64_t frame_id);

/// Whether the folder holds a divided run.
bool is_divided_run(const std::filesystem::path& run);

/// Reads blocks.json. InputError naming file, field and value.
std::vector<Block> read_blocks(const std::filesystem::path& run);
/// Writes blocks.json whole or not at all. IoError.
void write_blocks(const std::filesystem::path& run, const std::vector<Block>& blocks);
/// Parse and make the bytes of blocks.json; `file` is for messages.
std::vector<Block> parse_blocks(std::string_view bytes, const std::filesystem::path& file);
std::string blocks_text(const std::vector<Block>& blocks);

/// Returns the options of a block: the options of the whole with the block's frames. Poses stay as
/// they are, since two blocks would correct the frames that they share differently.
TrainOptions block_options(const TrainOptions& whole, const Block& block);

}  // namespace redrive

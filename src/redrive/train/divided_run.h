// SPDX-License-Identifier: Apache-2.0
// A divided run as a whole (train/files/blocks.h), and its blocks as runs.
#pragma once

#include <functional>

#include "redrive/base/parallel.h"
#include "redrive/train/files/blocks.h"
#include "redrive/train/files/seam_exposure.h"
#include "redrive/train/memory.h"
#include "redrive/train/run.h"

namespace redrive {

/// Options, recording with the poses in use, scene and blocks belong together.
struct DividedRun {
  RunPaths paths;  ///< paths of the whole: config, masks and poses
  TrainOptions options;
  Recording recording;
  Scene scene;  ///< all cameras and frames
  std::vector<Block> blocks;

  std::filesystem::path folder(const Block& block) const { return block_folder(paths.root, block); }
};

/// The resources of its machine that a process may use for a block.
struct BlockResources {
  int threads = 1;
  std::uint64_t memory = 0;  ///< bytes
};

/// Throws UsageError unless --blocks `text` is "auto" or metres; for photographs, and for
/// --refine-poses on.
void check_divisible(const std::string& text, const TrainOptions& options,
                     const Recording& recording);
inline constexpr double kLongestCore_m = 200;  ///< most metres with --blocks auto
/// Divides as --blocks `text` asks for. With `auto` a core has kLongestCore_m at most, and less
/// where a block needs more memory than is available, with the smallest cache of images that its
/// method allows. Returns one block for a shorter drive.
std::vector<Block> divide_as_told(const std::string& text, const DividedRun& whole,
                                  const BlockResources& resources);

/// Returns the largest memory estimate of the blocks. Throws UsageError if one of them has nothing
/// to train on or needs more than is available.
MemoryEstimate check_blocks(const DividedRun& whole, const BlockResources& resources);

/// Makes the folder with config.json, blocks.json, masks/ and the files that `fill` writes, all or
/// nothing, and sets whole->paths. Masks are found in images of the whole drive, unannotated moving
/// objects in its LiDAR, in parts of 100 m or of a block where it is longer. Errors as create_run
/// and prepare_training_data.
void create_divided_run(const std::filesystem::path& root, DividedRun* whole, ThreadPool& pool,
                        const std::function<void(const RunPaths&)>& fill);

/// Throws InputError if a file is missing or cannot be used.
DividedRun open_divided_run(const std::filesystem::path& root,
                            std::optional<double> max_damaged = {});

/// Makes the run folder of a block that has none; open_block opens it.
void create_block(const DividedRun& whole, const Block& block);
/// Opens the run of a block to train it on, from its last checkpoint if it has one. The limits on
/// epochs, steps and seconds, and what it may use of the machine, are the whole's.
Run open_block(const DividedRun& whole, const Block& block);

/// The blocks' rows of metrics.jsonl.
struct BlockMetrics {
  std::vector<MetricsRow>
      rows;  ///< step, PSNR and loss: means of the blocks with a row of the step
  // Sums over all blocks, from their last rows.
  std::int64_t steps = 0;
  double seconds = 0;
};
/// Errors as read_metrics and read_blocks.
BlockMetrics read_block_metrics(const std::filesystem::path& root);

/// Compares the brightness of the blocks, all of them trained, and writes exposure.json.
SeamExposure match_exposures(const DividedRun& whole);

}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/divided_run.h"

#include <algorithm>
#include <charconv>
#include <map>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/progress.h"
#include "redrive/perception/find_moving.h"
#include "redrive/perception/masks.h"
#include "redrive/perception/moving_file.h"
#include "redrive/scene/load_views.h"
#include "redrive/train/training_data.h"

namespace redrive {
namespace {

// Gaussians and hash grids are sized for hundreds of metres; a core shorter than the overlaps of 20
// m at both ends costs more than it saves.
constexpr double kShortestCore_m = 40, kShrink = 0.8;

/// Returns the run of a block without parameters.
Run planned_run(const DividedRun& whole, const Block& block) {
  Run run;
  run.options = block_options(whole.options, block);
  run.recording = whole.recording;
  run.scene = make_scene(run.recording, scene_options(run.options));
  run.state.model = make_run_model(run.options, run.scene);
  return run;
}

/// Sets the options of a block that `redrive resume` may change to the options of the whole.
void take_limits(const TrainOptions& whole, TrainOptions* options) {
  options->epochs = whole.epochs;
  options->max_steps = whole.max_steps;
  options->max_seconds = whole.max_seconds;
  options->memory = whole.memory;
  options->gpu_memory = whole.gpu_memory;
  options->backend = whole.backend;
  options->isa = whole.isa;
  options->device = whole.device;
  options->threads = whole.threads;
}

double length_of(const std::string& text) {
  double length_m = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), length_m);
  if (error != std::errc() || end != text.data() + text.size() ||
      !(length_m > 0 && length_m <= 1e9))
    throw UsageError("--blocks", text, "must be auto, or metres above 0");
  return length_m;
}

/// Frames after which the split into training and held-out ones repeats.
int split_period(const TrainOptions& options) {
  return std::max({1, options.holdout_every, options.train_every});
}

/// Returns the parts of the drive in which moving objects are searched, as long as the longest core
/// or longer: rays of up to 8 s before and after a return tell whether it stays, however short a
/// block is, and the LiDAR of kilometres would not fit into memory.
std::vector<Block> searched_parts(const DividedRun& whole) {
  constexpr double kLeast_m = 100;
  double length_m = kLeast_m;
  for (const Block& block : whole.blocks)
    length_m = std::max(length_m, block.end_m - block.start_m);
  return divide(whole.scene.posed_frames(),
                {length_m, default_overlap_m(length_m), split_period(whole.options)});
}

/// Returns find_moving for the parts, one after the other, so that only one part's LiDAR is in
/// memory at a time.
std::vector<MovingObject> find_in_parts(const DividedRun& whole, ThreadPool& pool) {
  const std::filesystem::path folder = mask_folder(whole.options, whole.scene);
  if (!folder.empty() && std::filesystem::exists(moving_file(folder)))
    return read_moving_file(moving_file(folder));
  std::vector<MovingObject> found;
  for (const Block& part : searched_parts(whole))
    join_found(find_moving(planned_run(whole, part), pool), &found);
  return found;
}

using ImageGainsByName = std::map<std::pair<std::string, std::int64_t>, LogGains>;

/// Returns the log gains of a block's training images, with camera and frame.
ImageGainsByName image_gains_of(const DividedRun& whole, const Block& block,
                                const TrainState& state) {
  const Scene scene =
      make_scene(whole.recording, scene_options(block_options(whole.options, block)));
  ImageGainsByName gains;
  for (const View& view : scene.views)
    if (!view.held_out)
      gains[{scene.rig[view.camera].name, scene.frames[view.frame].id}] =
          image_log_gains(*state.model, scene.exposure(view));
  return gains;
}

}  // namespace

void check_divisible(const std::string& text, const TrainOptions& options,
                     const Recording& recording) {
  if (text != "auto") length_of(text);
  if (!recording.metric)
    throw UsageError("--blocks", text, "divides drives; this is a recording of photographs");
  if (options.refine_poses == "on")
    throw UsageError("--refine-poses", "on",
                     "is not for --blocks: two blocks would correct the frames that they share "
                     "differently; --align corrects all of them before");
}

std::vector<Block> divide_as_told(const std::string& text, const DividedRun& whole,
                                  const BlockResources& resources) {
  const auto divided = [&](double length_m) {
    return divide(whole.scene.posed_frames(),
                  {length_m, default_overlap_m(length_m), split_period(whole.options)});
  };
  if (text != "auto") return divided(length_of(text));
  const Progress progress("dividing the drive");
  for (double length_m = kLongestCore_m;; length_m *= kShrink) {
    std::vector<Block> blocks = divided(length_m);
    const Block& longest = blocks[longest_first(blocks, whole.scene.posed_frames()).front()];
    if (length_m * kShrink < kShortestCore_m ||
        estimate_memory(planned_run(whole, longest), resources.threads).least() <= resources.memory)
      return blocks;
  }
}

MemoryEstimate check_blocks(const DividedRun& whole, const BlockResources& resources) {
  MemoryEstimate most;
  std::uint64_t search = 0;
  for (const Block& part : searched_parts(whole))
    search = std::max(search, estimate_memory(planned_run(whole, part), resources.threads).search);
  for (const Block& block : whole.blocks) {
    const Run run = planned_run(whole, block);
    MemoryEstimate need = estimate_memory(run, resources.threads);
    need.search = search;
    check_memory(need, resources.memory, run.options);
    if (need.total() > most.total()) most = need;
  }
  return most;
}

void create_divided_run(const std::filesystem::path& root, DividedRun* whole, ThreadPool& pool,
                        const std::function<void(const RunPaths&)>& fill) {
  std::vector<Mask> masks;
  std::vector<MovingObject> found;
  if (whole->options.masks != "none") {
    const std::filesystem::path folder = mask_folder(whole->options, whole->scene);
    DamagedViews damaged;
    masks = static_masks(whole->scene, ViewLoader(whole->scene, pool, &damaged), folder, pool,
                         whole->recording.metric);
    found = find_in_parts(*whole, pool);
  }
  whole->paths = create_run(root, whole->options, [&](const RunPaths& paths) {
    for (const std::filesystem::path& folder : {paths.masks(), paths.root / "blocks"}) {
      std::error_code error;
      std::filesystem::create_directory(folder, error);
      if (error) throw IoError(folder, error.message());
    }
    if (!masks.empty()) write_masks(paths.masks(), masks, whole->scene);
    if (!found.empty()) write_moving_file(moving_file(paths.masks()), found);
    write_blocks(paths.root, whole->blocks);
    if (fill) fill(paths);
  });
}

DividedRun open_divided_run(const std::filesystem::path& root, std::optional<double> max_damaged) {
  DividedRun whole;
  whole.paths.root = root;
  whole.blocks = read_blocks(root);
  whole.options = options_from_json(read_json(whole.paths.config()), whole.paths.config());
  if (max_damaged) whole.options.max_damaged = *max_damaged;
  whole.recording = open_recording(whole.options);
  if (has_external_poses(whole.options))
    use_external_poses(read_pose_files(whole.recording, whole.paths.poses()), whole.paths.poses(),
                       whole.options, &whole.recording);
  whole.scene = make_scene(whole.recording, scene_options(whole.options));
  for (const Block& block : whole.blocks)
    for (const std::int64_t id :
         {block.first_frame, block.first_core, block.last_core, block.last_frame})
      if (whole.scene.frame_index(id) < 0)
        throw InputError(blocks_file(root), "blocks." + block.name, std::to_string(id),
                         whole.recording.root.string() + " has no such frame");
  return whole;
}

void create_block(const DividedRun& whole, const Block& block) {
  const std::filesystem::path folder = whole.folder(block);
  make_folders_within(whole.paths.root, folder.parent_path().filename());
  std::error_code error;
  if (std::filesystem::is_symlink(folder, error))
    throw IoError(folder, "is a link; nothing is written outside of the run's folder");
  if (std::filesystem::exists(folder, error)) return;
  Run run = planned_run(whole, block);
  record_hyperparameters(*run.state.model, &run.options);
  const auto link = [&](const RunPaths& paths, const std::filesystem::path& part) {
    const std::filesystem::path name = part.filename();
    std::filesystem::create_directory_symlink(std::filesystem::path("../..") / name,
                                              paths.root / name, error);
    if (error) throw IoError(paths.root / name, error.message());
  };
  create_run(
      folder, run.options,
      [&](const RunPaths& paths) {
        link(paths, whole.paths.masks());
        if (has_external_poses(run.options)) link(paths, whole.paths.poses());
      },
      run.state.model.get());
}

Run open_block(const DividedRun& whole, const Block& block) {
  Run run = open_run(whole.folder(block), /*to_resume=*/true);
  const nlohmann::json before = options_to_json(run.options);
  take_limits(whole.options, &run.options);
  if (options_to_json(run.options) != before)
    write_config(run.paths, run.options, run.state.model.get());
  return run;
}

BlockMetrics read_block_metrics(const std::filesystem::path& root) {
  BlockMetrics all;
  std::map<std::int64_t, std::pair<MetricsRow, int>> sums;  // key: step
  for (const Block& block : read_blocks(root)) {
    const std::vector<MetricsRow> rows = read_metrics({block_folder(root, block)});
    if (!rows.empty()) {
      all.steps += rows.back().step;
      all.seconds += rows.back().seconds;
    }
    for (const MetricsRow& row : rows) {
      auto& [sum, n] = sums[row.step];
      ++n;
      sum.psnr_db += row.psnr_db;
      sum.loss += row.loss;
    }
  }
  for (auto& [step, at] : sums) {
    auto& [row, n] = at;
    row.step = step;
    row.psnr_db /= n;
    row.loss /= n;
    all.rows.push_back(row);
  }
  return all;
}

SeamExposure match_exposures(const DividedRun& whole) {
  const Progress progress("comparing the brightness of blocks");
  std::vector<std::string> cameras;
  for (const RigCamera& camera : whole.scene.rig) cameras.push_back(camera.name);
  std::vector<SharedImage> shared;
  std::vector<std::vector<LidarGains>> lidar_gains;
  ImageGainsByName before;
  for (std::size_t b = 0; b < whole.blocks.size(); ++b) {
    const TrainState state = load_checkpoint(RunPaths{whole.folder(whole.blocks[b])}.checkpoint());
    lidar_gains.push_back(state.lidar_gains);
    const ImageGainsByName here = image_gains_of(whole, whole.blocks[b], state);
    for (const auto& [image, log_gains] : here)
      if (const auto there = before.find(image); there != before.end())
        shared.push_back({whole.scene.camera_index(image.first), static_cast<int>(b) - 1,
                          static_cast<int>(b), there->second, log_gains});
    before = here;
  }
  SeamExposure exposure =
      solve_seam_exposure(std::move(cameras), static_cast<int>(whole.blocks.size()), shared);
  exposure.lidar_gains = mean_gains(lidar_gains);
  write_seam_exposure(whole.paths.root, exposure);
  return exposure;
}

}  // namespace redrive

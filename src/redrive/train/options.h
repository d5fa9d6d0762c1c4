// SPDX-License-Identifier: Apache-2.0
// Everything a training run depends on. One field list (train_fields) feeds the command line, the
// help text, the resolved config in the run folder and its reading back. Order of flags never
// matters: a preset fills what was not given.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include "redrive/recording/pose_files.h"
#include "redrive/scene/scene.h"

namespace redrive {

struct TrainOptions {
  std::string recording;  ///< folder
  std::string method = "grid";
  std::string preset;  ///< "", nerf: "report-1", "report-2"; grid: "fast", "best"
  // scene/scene.h SceneOptions
  std::vector<std::string> cameras;
  std::string frames;  ///< "FIRST:LAST[:STEP]", ids inclusive, either may be empty
  int downscale = 1;
  int holdout_every = 0;
  bool undistort = false;
  bool ground_truth_poses = false;  ///< the exact poses and calibration that a made recording ships
  std::string poses;   ///< folder of other poses and another calibration (recording/pose_files.h);
                       ///< "": the recording's own
  bool align = false;  ///< those that redrive align finds
  std::vector<std::string>
      rolling_shutter;  ///< recording/readout_options.h: what the calibration does not say
  std::string refine_poses = "auto";  ///< "auto", "on", "off": while training; auto: of a drive by
                                      ///< grid, but not with ground_truth_poses
  double near_m = 0.5, far_m = 1000;
  std::string background;  ///< "", "white", "black", "random" (black): behind transparent pixels
  std::string masks = "auto";  ///< what is not the static world: "auto" finds it, "none" trains on
                               ///< it, or a folder of CAM.png
  // field and sampling
  int width = 32;        ///< hidden units, a multiple of 32 in 32..512
  int samples = 24;      ///< per ray, 3..1024
  int fine_samples = 0;  ///< per ray, 0..1024: hierarchical sampling with a second network
  // optimisation
  int batch_rays = 2048;        ///< 1..65536
  double error_rays = 0.5;      ///< share of batch_rays, 0..0.9; grid
  int lidar_rays = 512;         ///< of a step, besides; 0..65536
  double learning_rate = 2e-2;  ///< (0, 1]
  double lr_gamma = 0.1;        ///< (0, 1]: nerf: at each milestone; grid: at the end of the run
  std::vector<std::int64_t> lr_milestones;  ///< steps; empty: as milestones() says
  int epochs = 10000;                       ///< 1..10000
  std::int64_t max_steps = 0;               ///< 0: no limit
  double max_seconds = 300;                 ///< of training alone; 0: no limit
  std::uint64_t seed = 1;
  int checkpoint_every = 1000;  ///< steps; also at the end and on Ctrl-C
  // how
  int threads = 0;                 ///< 0: all
  std::string memory = "70%";      ///< that training may take: bytes, or with GiB or % behind it
  std::string gpu_memory = "90%";  ///< likewise of a GPU's, a share of what is free
  std::string backend = "auto", isa = "auto";
  int gpus = 1;  ///< 1..64, each with batch_rays and lidar_rays of a step
};

/// One option: its flag without dashes ("near"), JSON key, help with unit, range and default; parse
/// throws UsageError.
struct TrainField {
  std::string name, help;
  bool is_flag = false;                                            ///< a switch without a value
  std::function<void(TrainOptions&, const std::string&)> parse;    ///< from the command line
  std::function<void(const TrainOptions&, nlohmann::json&)> save;  ///< into json[name]
  std::function<void(TrainOptions&, const nlohmann::json&)>
      load;  ///< from json[name]; UsageError if it is of another type
  std::function<void(const TrainOptions&)> check;  ///< UsageError if out of range
};
const std::vector<TrainField>& train_fields();

/// TrainOptions{} are the defaults of grid. Sets those of nerf for it, and what the preset says,
/// except the fields named in `given`; a run whose epochs or max-steps are given has no other
/// limit. UsageError for an unknown preset, or one of another method. Recording-dependent parts
/// (setup 2's second camera) are resolved by resolve_cameras.
void apply_preset(TrainOptions* options, const std::vector<std::string>& given);
/// report-1: F_MIDLONGRANGECAM_CL. report-2: that and F_MIDRANGECAM_C, or B_MIDRANGECAM_C where the
/// recording lacks it.
void resolve_cameras(TrainOptions* options, const Recording& recording);

/// What a bounded recording asks for and is not `given`, but with a report's preset. near_m and
/// far_m, where neither is: what holds its cube seen from every frame, and of one that --method
/// grid sees from within a hundred times its half side. width, of grid where the cube is all there
/// is: surfaces like an object's take a wider network than a street's (docs/benchmarks.md).
void resolve_bounds(TrainOptions* options, const std::vector<std::string>& given,
                    const Recording& recording);

/// UsageError naming option, value and rule for the first field out of range.
void validate(const TrainOptions& options);
SceneOptions scene_options(const TrainOptions& options);
/// The recording with its own poses, true ones if the options say so; what --poses and --align name
/// is put into it by its run (train/run.h). InputError as redrive::open_recording.
Recording open_recording(const TrainOptions& options);
/// Whether a run keeps poses of its own beside the recording's: --poses or --align.
bool has_external_poses(const TrainOptions& options);
/// Those, put into the recording; readouts that --rolling-shutter gives count before theirs.
/// InputError as apply_pose_files.
void use_external_poses(const PoseFiles& files, const std::filesystem::path& folder,
                        const TrainOptions& options, Recording* recording);

/// Whether poses are refined. UsageError where they cannot be: of photographs.
bool refines_poses(const TrainOptions& options, const Scene& scene);

/// What --memory allows on a machine of so many bytes: bytes ("6000000000"), "6GiB", or a share
/// ("70%"). UsageError.
std::uint64_t allowed_memory(const TrainOptions& options, std::uint64_t machine);
/// The same of --gpu-memory, on a GPU that has so many bytes free.
std::uint64_t allowed_gpu_memory(const TrainOptions& options, std::uint64_t free);

/// Steps of the whole run: epochs, or max_steps if that is less.
std::int64_t total_steps(const TrainOptions& options, std::int64_t steps_per_epoch);
/// lr_milestones, or the default: 1/2, 3/4 and 7/8 of all steps, none if those are fewer than 8. A
/// function of steps alone, so that max_seconds, which no two runs meet at the same step, leaves
/// the schedule as it is.
std::vector<std::int64_t> milestones(const TrainOptions& options, std::int64_t steps_per_epoch);

nlohmann::json options_to_json(const TrainOptions& options);
/// InputError for an unknown or missing key, a value of another type or out of range.
TrainOptions options_from_json(const nlohmann::json& json, const std::filesystem::path& file);

}  // namespace redrive

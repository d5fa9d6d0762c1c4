// SPDX-License-Identifier: Apache-2.0
// Predicts what training a drive will cost, from measured rates and from facts that need no decoded
// image.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include "redrive/kernels/backend.h"
#include "redrive/train/run.h"

namespace redrive {

/// Seconds of one core; work is taken to be shared evenly by a rank's cores.
struct TrainingRates {
  double prepare_s = 0;  ///< to read an image and its frame's LiDAR, with masks
  double decode_s = 0;   ///< part of it: an image alone
  double start_s = 0;    ///< time for an image, for the first parameters (Trainee::initialize_from)
  double mask_s = 0;     ///< time to find a camera's static mask
  double look_s = 0;     ///< time to compare a sweep with another one (search_looks)
  double step_s = 0;     ///< a step, mean of a run
  /// The longest over the shortest time of the same work, one image decoded again and again while
  /// the others were measured: how much the machine's speed changed. The rates hold for its fastest
  /// moment.
  double spread = 1;
};

/// Steps that pass through a whole run's schedule.
struct CalibrationSteps {
  int steps = 100;  ///< maximum; kLeast or more where steps are slow
  static constexpr int kLeast = 20;
  /// Steps between changes of the number of parameters, while measuring and in the run to plan.
  /// What a step with a change takes beyond the others counts by their ratio.
  int change_every = 5, change_every_of_run = 100;
};

/// Measures the rates with `run`, whose options, recording and scene are set: prepares its data,
/// then trains. Writes nothing. Core time of other programs does not count (CoreTimer), and times
/// are divided by the speed of the machine meanwhile. `fewer`: null, or a run with a part of the
/// frames, so that start_s is the time for one more image: images at the ends of a drive are
/// matched with fewer others.
TrainingRates measure_rates(Run* run, kernels::Backend& backend,
                            const CalibrationSteps& calibration, Run* fewer = nullptr);

/// Sets mask_s and look_s, as a drive with this scene will take them; 0 without masks.
void measure_left_out(const TrainOptions& options, const Recording& recording, const Scene& scene,
                      kernels::Backend& backend, TrainingRates* rates);

/// A part of the drive that is a run of its own, or the whole drive where it is not divided.
struct PlannedBlock {
  std::string name;
  std::int64_t first_frame = 0, last_frame = 0;  ///< ids
  double length_m = 0;                           ///< length of its core, along the way driven
  std::int64_t images = 0;                       ///< for training
  std::int64_t cameras = 0, sweeps = 0;          ///< sweeps: LiDAR's (perception/seen_through.h)
  std::uint64_t image_file_bytes = 0, lidar_file_bytes = 0;
  std::uint64_t memory_bytes = 0;        ///< with all images (MemoryEstimate::total)
  std::uint64_t least_memory_bytes = 0;  ///< with the smallest cache of them (least)
  std::uint64_t checkpoint_bytes = 0;
  // Set by plan_training:
  bool streams = false;           ///< images are decoded when needed
  double prepare_s = 0;           ///< before training, with the first parameters
  double train_s = 0, steps = 0;  ///< time and number of training steps
  std::uint64_t reads_bytes = 0;  ///< from images and LiDAR files
  double seconds() const { return prepare_s + train_s; }
};

/// Machines that are alike.
struct Machines {
  int machines = 1, cores = 1;  ///< cores of each
  std::uint64_t memory = 0;     ///< bytes of each that training may use
};

/// Limits of a run; at least one is > 0.
struct TrainingLimits {
  std::int64_t max_steps = 0;
  double max_seconds = 0;  ///< as TrainOptions
  int checkpoint_every = TrainOptions().checkpoint_every;
};

struct TrainingPlan {
  std::vector<PlannedBlock> blocks;
  int ranks_per_machine = 1, cores_per_rank = 1;
  double seconds = 0;              ///< from the start to the end of the last block
  double core_seconds = 0;         ///< core time that blocks use
  double efficiency = 1;           ///< time of the blocks over the time of all ranks
  std::uint64_t memory_bytes = 0;  ///< memory of a machine, at most
  std::uint64_t reads_bytes = 0, writes_bytes = 0;
  double reads_bytes_per_s = 0;  ///< rate of all machines while ranks prepare and train, at most
  std::string limit;             ///< what more machines would not shorten
};

/// Passes over images that are not in memory, before the first step.
constexpr int kStreamedPasses = 6;

/// Returns the seconds that `ranks` take for tasks from a queue, longest first.
double queue_seconds(std::vector<double> tasks, int ranks);

/// A machine trains as many blocks at once as its memory holds, at most one a core. Throws
/// UsageError naming --memory where the largest block does not fit.
TrainingPlan plan_training(std::vector<PlannedBlock> blocks, const TrainingRates& rates,
                           const Machines& machines, const TrainingLimits& limits);

nlohmann::json to_json(const TrainingPlan& plan);

}  // namespace redrive

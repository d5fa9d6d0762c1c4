// SPDX-License-Identifier: Apache-2.0
// Everything that training changes: parameters, Adam's moments, progress. The content of a
// checkpoint.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>

#include "redrive/base/buffer.h"
#include "redrive/model/trainee.h"
#include "redrive/scene/lidar/lidar_gains.h"
#include "redrive/scene/pose_corrections.h"

namespace redrive {

/// State of the check of a start (train/start_watch.h).
struct StartWatch {
  int dead_steps = 0;    ///< in a row
  double first_mse = 0;  ///< sum over the first steps
  double late_mse = 0;   ///< sum over the steps that are compared with them
  /// variance of the colours of those steps: the error of a constant colour
  double late_variance = 0;

  bool operator==(const StartWatch&) const = default;
};

/// State of the check for divergence (train/loss_watch.h).
struct LossWatch {
  std::uint64_t conditions = 0;  ///< hash of what makes errors comparable; `best` is of these
  double rays = 0;               ///< over which `smoothed` averages
  double smoothed = 0;           ///< mean squared error of the last windows
  double best = 0;               ///< least smoothed error so far; 0 until there are enough rays
  int high = 0;                  ///< consecutive windows that were far above it

  bool operator==(const LossWatch&) const = default;
};

/// Sums since the last row of metrics.jsonl.
struct LossWindow {
  int steps = 0;  ///< applied ones
  std::int64_t rays = 0;
  double loss = 0, mse = 0, seconds = 0;
  std::array<double, kMaxLossTerms> terms{};  ///< Trainee::loss_terms, in their order

  bool operator==(const LossWindow&) const = default;
};

/// Adam's moments of some numbers.
struct AdamMoments {
  std::vector<float> first, second;
  std::int64_t updates = 0;

  AdamMoments() = default;
  explicit AdamMoments(std::size_t n) : first(n), second(n) {}
};

/// Corrections of the recording's poses (train/poses/pose_refiner.h).
struct PoseState {
  PoseCorrections corrections;  ///< values empty: poses are not refined
  AdamMoments moments;

  PoseState() = default;
  explicit PoseState(const Scene& scene) : corrections(scene), moments(corrections.size()) {}
  bool refines() const { return !corrections.values.empty(); }
};

/// Mean of the parameters over late steps (Trainee::average_every).
struct ParameterMean {
  Buffer<float> values;    ///< empty: no step counts yet
  std::int64_t steps = 0;  ///< number of steps that count
};

struct TrainState {
  std::unique_ptr<Trainee> model;
  AdamState adam;  ///< moments of model->parameters
  ParameterMean mean;
  PoseState poses;
  std::int64_t step = 0;  ///< steps done
  /// pixels drawn in the order of the epochs, without the rays of the error map
  std::uint64_t pixels_drawn = 0;
  std::uint64_t pixels = 0;             ///< pixels that train, an epoch; 0 before the first step
  std::vector<LidarGains> lidar_gains;  ///< one per LiDAR of the recording; empty: not known
  Buffer<float> cell_errors;            ///< error map, of PixelSampler::cells; empty: not used
  std::string device;      ///< kernels::identity() of the backend that wrote it; empty: not known
  double seconds = 0;      ///< time of steps, including resumed runs, and of finish_training
  std::uint64_t seed = 0;  ///< in use; differs from the option after a restart
  int restarts = 0;
  int rollbacks = 0;               ///< roll-backs of this start
  double rate_factor = 1;          ///< product of the roll-backs' factors of the learning rate
  int bad_steps = 0;               ///< consecutive non-finite steps
  std::int64_t skipped_steps = 0;  ///< non-finite steps in all
  StartWatch watch;
  LossWatch loss_watch;
  LossWindow window;
};

/// Writes safetensors, which Python reads: the model's tensors by name, "adam.first_moment",
/// "adam.second_moment" and, if any, "adam.packed", "adam.errors", "parameter_mean", "cell_errors"
/// and "poses" with "poses.first_moment" and "poses.second_moment"; method, step, seconds, seed and
/// the model's numbers in __metadata__ (strings). Written atomically (base/files/files.h).
void save_checkpoint(const std::filesystem::path& file, const TrainState& state);
/// Throws InputError naming file and field: truncated, wrong header, shape that disagrees with the
/// hyperparameters, non-finite values.
TrainState load_checkpoint(const std::filesystem::path& file);

/// Convert to and from the bytes of a file; `file` is for messages.
std::string checkpoint_bytes(const TrainState& state);
TrainState parse_checkpoint(std::string_view bytes, const std::filesystem::path& file);

/// Returns a fresh start of a model whose hyperparameters are set.
TrainState initial_state(std::unique_ptr<Trainee> model, std::uint64_t seed);

}  // namespace redrive

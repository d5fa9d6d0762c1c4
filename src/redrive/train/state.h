// SPDX-License-Identifier: Apache-2.0
// What training changes: a model's parameters, their Adam moments, and how far it came. A
// checkpoint holds exactly this.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>

#include "redrive/base/buffer.h"
#include "redrive/model/model.h"
#include "redrive/scene/pose_corrections.h"

namespace redrive {

/// What the watch over the start of training has seen (train/start_watch.h).
struct StartWatch {
  int dead_steps = 0;    ///< in a row
  double first_mse = 0;  ///< sum over the first steps
  double late_mse = 0;   ///< sum over the steps that are compared with them
  double late_variance =
      0;  ///< of the colours of those steps: what a constant colour would be worth

  bool operator==(const StartWatch&) const = default;
};

/// What the watch for a loss that rises has seen (train/loss_watch.h).
struct LossWatch {
  std::uint64_t pixels = 0;  ///< of an epoch: with others, as of edited masks, the loss is another
  double rays = 0;           ///< that `smoothed` speaks of
  double smoothed = 0;       ///< mean squared error of the last windows
  double best = 0;           ///< the least that was; 0 until there are enough rays
  int high = 0;              ///< windows on end that were far above it

  bool operator==(const LossWatch&) const = default;
};

/// Sums since the last row of metrics.jsonl.
struct LossWindow {
  int steps = 0;  ///< applied ones
  std::int64_t rays = 0;
  double loss = 0, mse = 0, seconds = 0;
  std::array<double, kMaxLossTerms> terms{};  ///< Model::loss_terms, in their order

  bool operator==(const LossWindow&) const = default;
};

/// Adam's moments of some numbers.
struct AdamMoments {
  std::vector<float> first, second;
  std::int64_t updates = 0;

  AdamMoments() = default;
  explicit AdamMoments(std::size_t n) : first(n), second(n) {}
};

/// Corrections of the recording's poses (train/pose_refiner.h).
struct PoseState {
  PoseCorrections corrections;  ///< values empty: poses are not refined
  AdamMoments moments;

  PoseState() = default;
  explicit PoseState(const Scene& scene) : corrections(scene), moments(corrections.size()) {}
  bool refines() const { return !corrections.values.empty(); }
};

struct TrainState {
  std::unique_ptr<Model> model;
  AdamState adam;  ///< of model->parameters
  PoseState poses;
  std::int64_t step = 0;           ///< steps done
  std::uint64_t pixels_drawn = 0;  ///< in the order of the epochs, without those of the error map
  Buffer<float> cell_errors;       ///< error map, of PixelSampler::cells; empty: not used
  double seconds = 0;              ///< spent in training, resumed runs added up
  std::uint64_t seed = 0;          ///< in use; differs from the option after a restart
  int restarts = 0;
  int rollbacks = 0;               ///< of this start
  double rate_factor = 1;          ///< what they left of the learning rate
  int bad_steps = 0;               ///< non-finite ones in a row
  std::int64_t skipped_steps = 0;  ///< non-finite ones in all
  StartWatch watch;
  LossWatch loss_watch;
  LossWindow window;
};

/// safetensors (so that Python reads it): the model's tensors by name, "adam.first_moment",
/// "adam.second_moment" and, if any, "cell_errors" and "poses" with "poses.first_moment" and
/// "poses.second_moment"; method, step, seconds, seed and the model's numbers in __metadata__
/// (strings). Written atomically (base/files.h).
void save_checkpoint(const std::filesystem::path& file, const TrainState& state);
/// InputError names file and field: truncated, wrong header, shape that disagrees with its config,
/// non-finite values.
TrainState load_checkpoint(const std::filesystem::path& file);

/// The same on bytes; `file` is for messages.
std::string checkpoint_bytes(const TrainState& state);
TrainState parse_checkpoint(std::string_view bytes, const std::filesystem::path& file);

/// A fresh start of a model whose numbers are set.
TrainState initial_state(std::unique_ptr<Model> model, std::uint64_t seed);

}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
// What training changes: the parameters of the coarse and, with hierarchical sampling, the fine network, their Adam
// moments, and how far it came. A checkpoint holds exactly this.
#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>

#include "redrive/base/buffer.h"
#include "redrive/field/nerf_field.h"
#include "redrive/kernels/kernels.h"
#include "redrive/scene/scene.h"

namespace redrive {

struct NerfModel {
  NerfConfig config;
  int samples = 0, fine_samples = 0;  ///< per ray
  float near_m = 0, far_m = 0;
  UnitFromWorld unit_from_world;
  Buffer<float> parameters;  ///< [networks * nerf_parameter_count]: coarse, then fine

  int networks() const { return fine_samples > 0 ? 2 : 1; }
  std::span<const float> network(int index) const;  ///< 0 coarse, 1 fine
  kernels::NerfField field(int index) const { return {config, unit_from_world, network(index)}; }
};

/// What the watch over the start of training has seen (train/start_watch.h).
struct StartWatch {
  int dead_steps = 0;        ///< in a row
  double first_mse = 0;      ///< sum over the first steps
  double late_mse = 0;       ///< sum over the steps that are compared with them
  double late_variance = 0;  ///< of the colours of those steps: what a constant colour would be worth

  bool operator==(const StartWatch&) const = default;
};

/// Sums since the last row of metrics.jsonl.
struct LossWindow {
  int steps = 0;  ///< applied ones
  std::int64_t rays = 0;
  double loss = 0, mse = 0, seconds = 0;

  bool operator==(const LossWindow&) const = default;
};

struct TrainState {
  NerfModel model;
  Buffer<float> first_moment, second_moment;  ///< as model.parameters
  std::int64_t step = 0;                      ///< steps done
  double seconds = 0;                         ///< spent in training, resumed runs added up
  std::uint64_t seed = 0;                     ///< in use; differs from the option after a restart
  int restarts = 0;
  int bad_steps = 0;               ///< non-finite ones in a row
  std::int64_t skipped_steps = 0;  ///< non-finite ones in all
  StartWatch watch;
  LossWindow window;
};

/// safetensors (so that Python reads it): "coarse.trunk.0.weight", "fine....", "adam.first_moment", "adam.second_moment";
/// step, seconds, seed and shape in __metadata__ (strings). Written atomically (base/files.h).
void save_checkpoint(const std::filesystem::path& file, const TrainState& state);
/// InputError names file and field: truncated, wrong header, shape that disagrees with its config, non-finite values.
TrainState load_checkpoint(const std::filesystem::path& file);

/// The same on bytes; `file` is for messages.
std::string checkpoint_bytes(const TrainState& state);
TrainState parse_checkpoint(std::string_view bytes, const std::filesystem::path& file);

/// A fresh network for these settings.
TrainState initial_state(const NerfConfig& config, int samples, int fine_samples, const Scene& scene,
                         std::uint64_t seed);

}  // namespace redrive

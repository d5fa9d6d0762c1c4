// SPDX-License-Identifier: Apache-2.0
// Data of a run: images with masks applied, and LiDAR returns.
#pragma once

#include "redrive/scene/lidar_returns.h"
#include "redrive/scene/masks.h"
#include "redrive/train/run.h"

namespace redrive {

/// Pixels that training and scores exclude.
struct Exclusions {
  std::vector<Mask> masks;  ///< by camera of the rig
  MovingObjects moving;     ///< those that the model does not draw
};

/// Reads masks/ of an existing run and the recording's annotated objects; nothing with --masks
/// none. Throws InputError as the readers of masks and boxes do.
Exclusions read_exclusions(const Run& run);

struct TrainingData {
  std::vector<Image8> images;  ///< of scene.views, held-out ones empty
  Exclusions left_out;         ///< of them
  LidarReturns lidar;          ///< none if the model uses none
};

/// Loads the data of an existing run.
TrainingData load_training_data(const Run& run, ThreadPool& pool);
/// Loads the data of a new run. Masks are detected, or read from the folder that options.masks
/// names; throws UsageError if that has no mask of any camera.
TrainingData prepare_training_data(const Run& run, ThreadPool& pool);
/// Writes the masks of prepare_training_data into paths.masks(), for create_run.
void write_run_masks(const RunPaths& paths, const TrainingData& training, const Scene& scene);

}  // namespace redrive

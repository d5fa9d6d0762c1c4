// SPDX-License-Identifier: Apache-2.0
// What a run trains on and is scored on: its pictures without what options.masks leaves out of
// them, and its LiDAR returns.
#pragma once

#include "redrive/scene/lidar_returns.h"
#include "redrive/scene/masks.h"
#include "redrive/train/run.h"

namespace redrive {

/// What is left out of a run's pictures.
struct Exclusions {
  std::vector<Mask> masks;  ///< by camera of the rig
  MovingObjects moving;
};

/// Of a run whose folder is there: its masks/ and the recording's annotated objects; nothing with
/// --masks none. InputError as read_mask, read_boxes.
Exclusions read_exclusions(const Run& run);

struct TrainingData {
  std::vector<Image8> images;  ///< of scene.views, held-out ones empty
  Exclusions left_out;         ///< of them
  LidarReturns lidar;          ///< none if the model uses none
};

/// Of an existing run.
TrainingData load_training_data(const Run& run, ThreadPool& pool);
/// Those of a run to be, whose masks are found, or read from the folder that options.masks names.
/// UsageError if no camera has a mask there.
TrainingData prepare_training_data(const Run& run, ThreadPool& pool);
/// Makes paths.masks() with what prepare_training_data found: for create_run.
void write_run_masks(const RunPaths& paths, const TrainingData& training, const Scene& scene);

}  // namespace redrive

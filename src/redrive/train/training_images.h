// SPDX-License-Identifier: Apache-2.0
// What a run trains on and is scored on: its pictures without what options.masks leaves out of them.
#pragma once

#include "redrive/scene/masks.h"
#include "redrive/train/run.h"

namespace redrive {

/// What is left out of a run's pictures.
struct LeftOut {
  std::vector<Mask> masks;  ///< by camera of the rig
  MovingObjects moving;
};

/// Of a run whose folder is there: its masks/ and the recording's annotated objects; nothing with --masks none. InputError as
/// read_mask, read_boxes.
LeftOut read_left_out(const Run& run);

struct TrainingImages {
  std::vector<Image8> images;  ///< of scene.views, held-out ones empty
  LeftOut left_out;            ///< of them
};

/// The pictures of an existing run.
TrainingImages load_training_images(const Run& run, ThreadPool& pool);
/// Those of a run to be, whose masks are found, or read from the folder that options.masks names. UsageError if no camera has
/// a mask there.
TrainingImages find_training_images(const Run& run, ThreadPool& pool);
/// Makes paths.masks() with what find_training_images found: for create_run.
void keep_masks(const RunPaths& paths, const TrainingImages& training, const Scene& scene);

}  // namespace redrive

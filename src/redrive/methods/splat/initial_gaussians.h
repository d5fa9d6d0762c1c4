// SPDX-License-Identifier: Apache-2.0
// First Gaussians of a scene, from every available point source: LiDAR returns and points of
// reconstructions, coloured by the images, and points triangulated from image tracks.
#pragma once

#include "redrive/base/parallel.h"
#include "redrive/model/gaussian_layout.h"
#include "redrive/model/trainee.h"

namespace redrive {

struct InitialGaussianOptions {
  float voxel = 0.014f;        ///< side of a voxel that keeps one point, as a part of its distance
  int max_gaussians = 400000;  ///< most; of more points a random choice is kept
  int max_unseen = 400000;     ///< maximum number of first Gaussians that no image sees
  int sky = 24000;             ///< number on a sphere around the scene; only those seen are made
  int random = 100000;         ///< number in the cube of a bounded scene without points
  /// share of the LiDAR returns high above the road that get one more above
  float extruded = 0.08f;
  bool tracks = true;  ///< uses points of image tracks
};

/// Returns the first Gaussians, in random order, and the number of those that no image sees, which
/// are beyond max_gaussians. Deterministic in seed; the number of threads changes nothing.
GaussianList initial_gaussians(const TrainingSet& data, const InitialGaussianOptions& options,
                               std::uint64_t seed, ThreadPool& pool, std::size_t* unseen);

}  // namespace redrive

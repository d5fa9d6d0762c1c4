// SPDX-License-Identifier: Apache-2.0
// A method's part of `redrive bench` (bench/bench.h): timings of its stages, and models whose steps
// and images are timed.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "redrive/image/image.h"
#include "redrive/kernels/backend.h"
#include "redrive/model/trainee.h"
#include "redrive/scene/scene.h"

namespace redrive::bench {

/// Four views of one 1280 x 704 pinhole, half a metre apart, near 1 m and far 10 m; images of
/// smooth stripes.
struct SyntheticDrive {
  Scene scene;
  std::vector<Image8> images;
};

/// Cost per sample, or per other item that a benchmark counts.
struct Cost {
  double flops, bytes;
};

// Bytes that a stage of the backend interface reads and writes at least, each number once, however
// often a kernel reads it. Bytes of a ray are divided among its samples, bytes of parameters among
// all samples of a run.
constexpr double kNumber = sizeof(float);
constexpr double kRayBytes = 6 * kNumber;          // origin and direction
constexpr double kColourBytes = 3 * kNumber;       // for each ray: target, or its derivative
constexpr double kRenderedRayBytes = 5 * kNumber;  // for each ray: colour, depth, opacity
// for each sample: colour and density, or their derivatives
constexpr double kRawBytes = 4 * kNumber;
constexpr double kGradientBytes = 2 * kNumber;  // added to
constexpr double kAdamBytes =
    2 * 4 * kNumber;  // gradient, parameter, two moments: read and written

class Timer {
 public:
  virtual ~Timer() = default;
  /// Times `work`, which processes `samples` samples at a cost each, if its name is wanted.
  virtual void time(const std::string& name, double samples, const Cost& cost,
                    const std::function<void()>& work) = 0;
};

/// A model that marches rays.
struct RayModelSize {
  int width = 0, samples = 0;  ///< width of its network, samples per ray: hyperparameters
  double macs = 0;             ///< multiply-adds of a sample's forward pass
  bool renders = true;         ///< its images are timed, too
};

struct MethodBenchmarks {
  std::vector<RayModelSize> sizes = {};
  /// Times the method's stages; null: none.
  void (*time_stages)(kernels::Backend&, const SyntheticDrive&, Timer*) = nullptr;
  /// Makes a model of n Gaussians along a street before the drive's cameras: flat on a road and two
  /// facades, as large as half the distance of their neighbours. A quarter of them belong to the
  /// drive's actors, if any. Null: the model has no Gaussians.
  void (*fill)(const SyntheticDrive&, int n, Trainee* model) = nullptr;
};

}  // namespace redrive::bench

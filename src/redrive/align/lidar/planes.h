// SPDX-License-Identifier: Apache-2.0
// Where the LiDAR's revolutions together see something flat. Patches are found in the points of all
// revolutions, each placed at its own time, and become unknowns of the bundle adjustment as image
// points are: what moves the poses is that all revolutions have to see one and the same plane. So
// sparse revolutions help, too, of which none alone holds a normal.
#pragma once

#include <cstdint>
#include <vector>

#include "redrive/align/bundle/cost_functions.h"
#include "redrive/align/rig/rig_model.h"
#include "redrive/base/parallel.h"
#include "redrive/recording/recording.h"
#include "redrive/scene/lidar_returns.h"
#include "redrive/scene/moving_objects.h"
#include "redrive/scene/scene.h"

namespace redrive {

/// A static return, where the body was at the point's own time.
struct LidarSample {
  Eigen::Vector3d in_body;
  std::int64_t t_ns = 0;
  std::uint16_t intensity = 0;  ///< of the sensor's own scale
};

/// Those of `returns`, of the recording in the world of `scene`, that lie between the first and the
/// last frame.
std::vector<LidarSample> lidar_samples(const Recording& recording, const Scene& scene,
                                       const LidarReturns& returns);

/// Returns between the first and the last frame but for those on the vehicle and on objects that
/// move, each once.
std::vector<LidarSample> load_lidar_samples(const Recording& recording, const Scene& scene,
                                            const MovingObjects& moving, ThreadPool& pool);

/// At most so many of them, evenly chosen, in their order.
std::vector<LidarSample> subsample_evenly(std::vector<LidarSample> samples, std::size_t most);

/// Calls use(i, in_world) for each sample where the corrections of now put it, in any order, on all
/// threads.
template <class Use>
void transform_samples(const RigModel& model, const std::vector<LidarSample>& samples,
                       ThreadPool& pool, const Use& use) {
  pool.run_ranges(samples.size(), 4096, [&](std::size_t begin, std::size_t end) {
    Rigid3d world_from_body = Rigid3d::Identity();
    std::int64_t placed_ns = -1;
    for (std::size_t i = begin; i < end; ++i) {
      if (samples[i].t_ns != placed_ns) {  // a packet's points share their time
        placed_ns = samples[i].t_ns;
        world_from_body = model.corrected(model.at(placed_ns));
      }
      use(i, Eigen::Vector3d(world_from_body * samples[i].in_body));
    }
  });
}

struct PlaneOptions {
  double
      max_cell_m = 4,
      min_cell_m =
          0.5;  ///< edges of the cubes that are looked into: each is cut in eight until it is flat
  double max_plane_sigma_m = 0.06;  ///< standard deviation from its plane, at most
  int most_terms = 60'000;          ///< samples of all patches together
};

struct PlanarPatch {
  PlaneParameters plane;
  std::vector<int> samples;  ///< on it, by index
  double sigma_m = 0;        ///< of their distances: what the poses leave, noise along the ray,
                             ///< roughness; at least 5 mm
};

/// Patches with the corrections of now. Each is seen at three times 50 ms apart or more.
std::vector<PlanarPatch> find_planar_patches(const RigModel& model,
                                             const std::vector<LidarSample>& samples,
                                             const PlaneOptions& options, ThreadPool& pool);

}  // namespace redrive

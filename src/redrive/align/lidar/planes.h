// SPDX-License-Identifier: Apache-2.0
// Planar patches in the LiDAR points of all scans, each point transformed by the pose at its own
// time. Their planes become unknowns of the bundle adjustment as image points do: the poses are
// corrected until all scans agree on one plane. So scans that are too sparse to determine a normal
// contribute, too.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "redrive/align/rig/rig_model.h"
#include "redrive/base/parallel.h"
#include "redrive/recording/core/recording.h"
#include "redrive/scene/lidar/lidar_returns.h"
#include "redrive/scene/moving_objects.h"
#include "redrive/scene/scene.h"

namespace redrive {

/// A static LiDAR return in the axes of the body at the return's own time.
struct LidarSample {
  Eigen::Vector3d in_body;  ///< without RigModel::lidar_elevation_rad
  std::int64_t t_ns = 0;
  float intensity = 0;    ///< 0..255, whatever the full scale of the recording
  std::size_t lidar = 0;  ///< index in Recording::lidars
};

/// The `returns` between the times of the recording's first and last frame.
std::vector<LidarSample> lidar_samples(const Recording& recording, const LidarReturns& returns);

/// All returns between the first and the last frame except those on the vehicle and on moving
/// objects.
std::vector<LidarSample> load_lidar_samples(const Recording& recording, const Scene& scene,
                                            const MovingObjects& moving, ThreadPool& pool);

/// At most `max_samples` of them, evenly chosen, in their order.
std::vector<LidarSample> subsample_evenly(std::vector<LidarSample> samples,
                                          std::size_t max_samples);

/// Calls use(i, in_world) for each sample with its position by the present corrections, in any
/// order, on all threads.
template <class Use>
void transform_samples(const RigModel& model, const std::vector<LidarSample>& samples,
                       ThreadPool& pool, const Use& use) {
  pool.run_ranges(samples.size(), 4096, [&](std::size_t begin, std::size_t end) {
    Rigid3d world_from_body = Rigid3d::Identity();
    std::int64_t pose_ns = -1;
    for (std::size_t i = begin; i < end; ++i) {
      if (samples[i].t_ns != pose_ns) {  // a packet's points share their time
        pose_ns = samples[i].t_ns;
        world_from_body = model.corrected_pose(model.motion_at(pose_ns));
      }
      use(i, Eigen::Vector3d(world_from_body * model.raised(samples[i].in_body, samples[i].lidar)));
    }
  });
}

struct PlaneOptions {
  double max_cell_m = 4,
         min_cell_m =
             0.5;  ///< edges of the octree cells; each is divided until its points are planar
  double max_plane_sigma_m = 0.06;  ///< largest standard deviation from the plane
  int max_terms = 60'000;           ///< samples of all patches together
};

/// n (X - centre) = h with n = axes (x, y, 1): a plane near `centre`, whose normal differs little
/// from axes.col(2).
struct PlaneParameters {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  Eigen::Matrix3d axes = Eigen::Matrix3d::Identity();
  std::array<double, 3> value{};  ///< x, y, h (m)
};

struct PlanarPatch {
  PlaneParameters plane;
  std::vector<int> samples;  ///< indices of samples on it
  /// sigma of their distances (errors of the poses, range noise, roughness); at least 5 mm
  double sigma_m = 0;
};

/// Finds patches with the present corrections. Each has samples at three times at least 50 ms
/// apart.
std::vector<PlanarPatch> find_planar_patches(const RigModel& model,
                                             const std::vector<LidarSample>& samples,
                                             const PlaneOptions& options, ThreadPool& pool);

}  // namespace redrive

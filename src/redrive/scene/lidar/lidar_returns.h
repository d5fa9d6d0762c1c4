// SPDX-License-Identifier: Apache-2.0
// The LiDAR returns of a drive as its sensor measured them: a direction in the sensor's axes, a
// range and a time. Space is free up to the range. Where a return lies in the world follows from
// the pose of the body at its time, so returns move with the poses when these are refined.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <set>
#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/recording/core/lidar_point.h"
#include "redrive/scene/lidar/lidar_rays.h"
#include "redrive/scene/moving_objects.h"
#include "redrive/scene/scene.h"

namespace redrive {

/// Structure of arrays, as RayBatch.
struct LidarReturns {
  /// A LiDAR; for a point cloud, whose points have no sensor, the scene's first camera.
  struct Sensor {
    Rigid3d body_from_sensor = Rigid3d::Identity();
    float gain = 1;                            ///< RecordedLidar::gain
    std::vector<BeamGain> beam_gains = {};     ///< RecordedLidar::beam_gains
    BlindDirections blind = {};                ///< RecordedLidar::blind
    std::vector<Eigen::Vector3f> on_ego = {};  ///< directions of dropped returns on the vehicle

    /// Whether the vehicle is in the way; `direction` in the sensor's axes.
    bool is_blind(const Eigen::Vector3d& direction) const {
      return blind.contains(body_from_sensor.linear() * direction);
    }
  };
  std::size_t n = 0;
  std::vector<Sensor> sensors = {Sensor{}};  ///< as Recording::lidars; at least one
  std::vector<float> direction;              ///< [3, n] unit, in the sensor's axes
  std::vector<float> range_m;                ///< [n] > 0: the return is at range_m * direction
  std::vector<std::int64_t> t_ns;            ///< [n] host clock
  std::vector<std::uint16_t> intensity;      ///< [n] in the sensor's own scale; 0 for point clouds
  std::vector<std::uint8_t> ring;            ///< [n] LidarPoint::ring; empty for point clouds

  /// Returns on moving objects that are known.
  struct OnObject {
    std::int64_t id = 0, t_ns = 0;  ///< MovingObject::id; host clock
    Eigen::Vector3f in_box;         ///< in the axes of its box, metres
    Eigen::Vector3f direction = Eigen::Vector3f::Zero();
    float range_m = 0;  ///< 0: the ray is unknown
    std::uint16_t intensity = 0;
    std::uint8_t ring = kNoRing;
  };
  std::vector<OnObject> on_objects;

  /// Rays without a return, where the beams of the sensor are known (scan_structure.h).
  struct LostRay {
    Eigen::Vector3f direction;
    std::int64_t t_ns = 0;
  };
  std::vector<LostRay> lost;

  /// Ends of a scan's returns; they begin where the last scan's end. Point clouds have no scans.
  struct ScanEnd {
    std::size_t returns = 0, on_objects = 0, lost = 0;
    std::size_t sensor = 0;  ///< index in `sensors`
  };
  std::vector<ScanEnd> scan_ends;

  std::size_t files = 0;  ///< scans that were read and selected

  // Numbers of dropped points, each counted under the first reason that holds.
  std::size_t unusable = 0;           ///< no numbers, at the sensor, or impossible values
  std::size_t repeated = 0;           ///< also in the previous file: revolutions overlap
  std::size_t beyond_trajectory = 0;  ///< more than 60 ms before the first or after the last pose
  std::size_t on_ego = 0;             ///< on the recording vehicle itself
  std::size_t on_moving = 0;          ///< inside the box of a moving object, grown by its margin
  std::size_t hidden = 0;             ///< occluded points of a cloud (cloud_returns.h)

  std::optional<Finding> damaged;  ///< about revolutions whose files could not be read

  Eigen::Vector3d direction_in_sensor(std::size_t i) const {
    return {direction[i], direction[n + i], direction[2 * n + i]};
  }
  /// Whether return i > 0 is of the same ray as the one before: sensors may report two surfaces.
  bool same_ray(std::size_t i) const;
  /// The returns of one ray: [first, end).
  struct Ray {
    std::size_t first = 0, end = 0;
    std::size_t strongest = 0;  ///< the return of the highest intensity, which trains
  };
  /// Returns the ray whose first return is `first`. `last`: end of its scan's returns.
  Ray ray_at(std::size_t first, std::size_t last) const;
  /// Returns the ring of return i; kNoRing for point clouds.
  std::uint8_t ring_of(std::size_t i) const { return ring.empty() ? kNoRing : ring[i]; }
  /// Returns the sensor of return i.
  std::size_t sensor_of(std::size_t i) const;
  /// Returns the intensity of each sensor that counts as 1: sensors have 8 bits or 16, and a gain.
  /// Gains of beams are not in it.
  std::vector<float> full_intensities() const;
  /// Returns the intensity of return i over what counts as 1 for its beam. `full`: what
  /// full_intensities() returned.
  float intensity_of(std::size_t i, const std::vector<float>& full) const;
  /// Returns the position of a return in the sensor's axes, metres.
  Eigen::Vector3d in_sensor(std::size_t i) const {
    return double(range_m[i]) * direction_in_sensor(i);
  }
};

/// Poses of the sensor in a scene's world when it measured returns. Keeps the last pose, since
/// consecutive returns often share their time: each thread needs an object of its own. Both
/// arguments must outlive it.
class LidarPoses {
 public:
  LidarPoses(const Scene& scene, const LidarReturns& returns, Poses which = Poses::kCorrected)
      : scene_(scene), returns_(returns), which_(which) {}

  /// Returns world_from_sensor at the time of return i.
  const Rigid3d& at(std::size_t i);
  /// Returns the position of return i in the world, metres.
  Eigen::Vector3d in_world(std::size_t i) { return at(i) * returns_.in_sensor(i); }

 private:
  const Scene& scene_;
  const LidarReturns& returns_;
  Poses which_;
  std::optional<std::int64_t> t_ns_;
  std::size_t sensor_ = 0;
  Rigid3d world_from_sensor_;
};

/// Returns as rays in the world.
LidarRays rays_in_world(const Scene& scene, const LidarReturns& returns, ThreadPool& pool,
                        Poses which = Poses::kCorrected);

/// Whether a point in a box's axes is on its object: the road below and things beside it are not.
/// `box`: grown by kBoxMargin_m.
bool is_on_object(const MovingBox& box, const Eigen::Vector3d& in_box);

/// Marks the points that are in `before`, too, with the same time and position: [n] 1 or 0.
std::vector<std::uint8_t> mark_repeated(const std::vector<LidarPoint>& points,
                                        const std::vector<LidarPoint>& before);

/// Selects revolutions. Does not apply to point clouds.
struct LidarSelection {
  std::function<bool(std::int64_t frame_id)> frame;  ///< filter of scans by frame id; empty: all
  bool repeated = false;                  ///< keeps points that the previous file has, too
  bool lost = false;                      ///< finds LidarReturns::lost
  std::optional<std::size_t> lidar = {};  ///< one of Recording::lidars alone
};

/// Reads the scans whose frame ids lie within the ids of scene.frames, or, for a recording with a
/// points_file instead, its cloud_returns. Empty where there is neither or the LiDAR's extrinsics
/// are unknown. Returns are on moving objects by the recorded poses.
/// InputError where a cloud is malformed, or more scans are damaged than allowed.
LidarReturns load_lidar_returns(const Recording& recording, const Scene& scene,
                                const MovingObjects& moving, ThreadPool& pool,
                                const LidarSelection& selection = {});

/// Returns a finding if most returns lie beyond the trajectory or on the vehicle, or their median
/// range is outside 0.5 m to 300 m. Nothing without returns.
std::optional<Finding> lost_returns(const LidarReturns& returns);
/// Returns a finding that counts returns that are not finite or out of range; nothing without any.
std::optional<Finding> unusable_returns(const LidarReturns& returns);
/// Loads a few scans, spread over the drive. `scene` belongs to the recording and may have any
/// options.
LidarReturns sample_returns(const Recording& recording, const Scene& scene, ThreadPool& pool);

/// Removes the returns in the boxes of more moving objects from the static ones, as
/// load_lidar_returns does with the objects that it knows.
void take_out(const Scene& scene, const MovingObjects& moving, LidarReturns* returns);

/// Returns the ids of the frames with a held-out view. Their scans do not train. Points that a
/// held-out scan shares with the one before do train, points that it shares with the one after do
/// not: LidarReturns::repeated counts them there.
std::set<std::int64_t> held_out_frames(const Scene& scene);

}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
// A recording or a run that Python has opened.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/rays/ray_table.h"
#include "redrive/recording/lidar/lost_rays.h"
#include "redrive/train/run.h"
#include "redrive/train/training_data.h"

namespace redrive::python {

/// A camera by itself: a lens with its place on the body.
struct NamedCamera {
  RigCamera rig;
  std::vector<std::pair<std::string, double>> intrinsics;  ///< numbers of rig.camera by name

  explicit NamedCamera(const CameraCalibration& calibration);
  /// A camera of the scene, at the size of training.
  NamedCamera(const RigCamera& rig, const CameraCalibration& calibration);
};

/// Rays of an image.
struct ImageRays {
  int width = 0, height = 0;
  bool by_column = false;            ///< a line is a column, else a row
  std::vector<float> origin;         ///< [lines, 3] metres, in the world
  std::vector<float> direction;      ///< [height, width, 3] unit; 0 where a pixel has none
  std::vector<std::int64_t> t_ns;    ///< [lines]
  std::vector<std::uint8_t> is_ray;  ///< [height, width]
};

/// The axes of points.
enum class Axes { kSensor, kBody, kWorld };

/// A scan, recorded or rendered. Empty vectors: not known.
struct Points {
  std::vector<float> position_m, intensity;  ///< [n, 3], [n]
  std::vector<std::int64_t> t_ns;            ///< [n]
  std::vector<std::uint8_t> ring;            ///< [n]
  std::vector<float> range_m, loss;          ///< [n], of rendered scans
  std::vector<std::int32_t> actor;           ///< [n], of rendered scans
  bool knows_lost = false;
  std::string why_unknown;              ///< why the lost rays of a recorded scan are not known
  std::vector<float> lost_direction;    ///< [m, 3] unit, in the sensor's axes
  std::vector<std::int64_t> lost_t_ns;  ///< [m]
  std::vector<std::uint8_t> lost_ring;  ///< [m] index of the beam, from the lowest to the highest
};

/// Usable from several threads at once.
class Opened {
 public:
  Opened(std::shared_ptr<const Run> run, int threads);
  virtual ~Opened() = default;

  const Run& run() const { return *run_; }
  const Scene& scene() const { return run_->scene; }
  const std::vector<NamedCamera>& cameras() const { return cameras_; }

  /// Index of a camera of the scene. UsageError.
  int camera_index(const std::string& name) const;
  /// An image of the scene. UsageError where there is no such frame.
  View view_of(int camera, std::int64_t frame) const;
  /// The same; UsageError where the camera has no image then.
  const View& image_of(int camera, std::int64_t frame) const;
  /// Returns a time if the recording has poses within a second of it. UsageError.
  std::int64_t checked_time(std::int64_t t_ns) const;
  /// Time of a frame. UsageError where there is none.
  std::int64_t frame_ns(std::int64_t frame) const;

  /// Calls work(pool) while no other call has the pool.
  template <class Work>
  auto with_pool(const Work& work) {
    const std::lock_guard lock(pool_mutex_);
    return work(pool_);
  }

  ImageRays rays(int camera, const View& view);
  Points scan(std::int64_t frame, Axes axes, bool lost);
  /// [height, width]: 1 where training would use the pixel. `moving`: masks boxes of moving
  /// objects, too.
  std::vector<std::uint8_t> mask(const View& view, bool moving);
  /// Annotated objects; of a run with those that the LiDAR found.
  const MovingObjects& objects();

 protected:
  std::shared_ptr<const RayTable> table(int camera);
  const std::optional<ScanStructure>& structure();

  std::shared_ptr<const Run> run_;
  std::vector<NamedCamera> cameras_;
  std::mutex pool_mutex_;  ///< the pool works for one call at a time
  ThreadPool pool_;
  std::mutex cache_mutex_;
  std::map<int, std::shared_ptr<const RayTable>> tables_;
  bool structure_is_known_ = false;
  std::optional<ScanStructure> structure_;
  std::string why_no_structure_;
  std::optional<MovingObjects> objects_;
  std::optional<std::vector<Mask>> masks_;
};

}  // namespace redrive::python

// SPDX-License-Identifier: Apache-2.0
// What a simulator asks of a renderer, in plain types. The server of a protocol, which is loaded as
// a library of its own (serve/rpc), turns its messages into these and needs nothing else of
// redrive.
//
// Frames: the local frame of a scene is the world of its run; the rig is the body (FramePose);
// CameraCalibration and LidarFirings define the axes of cameras and LiDARs.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "redrive/camera/calibration.h"
#include "redrive/camera/lenses/ftheta_intrinsics.h"
#include "redrive/math/rigid3.h"

namespace redrive::serve {

/// Why a request has no answer. Numbers of gRPC.
enum class StatusCode {
  kOk = 0,
  kCancelled = 1,
  kInvalidArgument = 3,
  kNotFound = 5,
  kResourceExhausted = 8,
  kFailedPrecondition = 9,
  kOutOfRange = 11,
  kUnimplemented = 12,
  kInternal = 13
};

class RequestError : public std::runtime_error {
 public:
  RequestError(StatusCode code, const std::string& message)
      : std::runtime_error(message), code(code) {}
  StatusCode code;
};

/// Largest message to a client, and from one.
constexpr std::size_t kMaxReplyBytes = 64 << 20, kMaxRequestBytes = 4 << 20;
/// Most images and scans of one request.
constexpr std::size_t kMaxItems = 1000;

/// Poses at the start and at the end of a frame.
struct PosePair {
  Rigid3d start = Rigid3d::Identity(), end = Rigid3d::Identity();
};

/// An object that drives: its id in the recording, and the centre of its box in the local frame.
struct TrackPose {
  std::string track;
  PosePair local_from_box;
};

/// Order in which a sensor's pixels are exposed. Numbers of the protocol.
enum class Shutter {
  kUnknown = 0,
  kTopToBottom = 1,
  kLeftToRight = 2,
  kBottomToTop = 3,
  kRightToLeft = 4,
  kGlobal = 5
};

/// Numbers of the protocol; others are refused.
enum class ImageFormat { kPng = 1, kJpeg = 2, kPlanar = 4 };

/// A lens with its image size and shutter.
struct Lens {
  /// `name` says which camera it is. `model` empty: the lens of the scene's camera of that name.
  /// Principal points are OpenCV's.
  CameraCalibration camera;
  Shutter shutter = Shutter::kUnknown;
  double max_angle_rad = 0;  ///< edge of the valid region, where the service names a fisheye
  /// Instead of the camera's model and parameters; of a scene's f-theta camera, besides.
  std::optional<FThetaIntrinsics> ftheta;
  std::optional<WindshieldPolynomials> windshield;  ///< before the f-theta lens
};

/// What images and scans have in common. The named objects alone are drawn; where none is named,
/// all drive as recorded.
struct SensorQuery {
  std::string scene;
  std::int64_t start_ns = 0, end_ns = 0;
  PosePair local_from_sensor;
  std::vector<TrackPose> objects;
};

struct ImageQuery : SensorQuery {
  Lens lens;
  int width = 0, height = 0;  ///< size of the image, to which the lens is scaled; 0: the lens's
  int format = 0;             ///< ImageFormat
  float quality = 0;          ///< JPEG quality, 1..100; 0: 92
  bool ego_mask = false;
};

struct ScanQuery : SensorQuery {
  std::string sensor;  ///< one of known_lidar_sensors
};

/// An encoded image, or why there is none.
struct ImageAnswer {
  StatusCode code = StatusCode::kOk;
  std::string bytes;  ///< the error where `code` is not kOk
};

/// Points in the sensor's axes at the end of the frame, metres; intensities 0..1.
struct ScanAnswer {
  std::vector<float> xyz, intensity;
};

struct SceneCamera {
  Lens lens;
  Rigid3d rig_from_camera;
};

struct TimedPose {
  std::int64_t t_ns = 0;
  Rigid3d local_from_rig;
};

/// Whether the client has given up.
using Cancelled = std::function<bool()>;

/// Usable from several threads at once. Functions throw RequestError.
class SensorService {
 public:
  virtual ~SensorService() = default;
  virtual std::vector<std::string> scenes() const = 0;
  virtual std::vector<std::string> loaded_scenes() const = 0;
  virtual std::vector<SceneCamera> cameras(const std::string& scene) = 0;
  virtual std::vector<TimedPose> trajectory(const std::string& scene) = 0;
  /// Returns an answer to each. Throws where all of them fail alike: cancelled, too large together.
  virtual std::vector<ImageAnswer> images(std::span<const ImageQuery> queries,
                                          const Cancelled& cancelled) = 0;
  virtual ScanAnswer scan(const ScanQuery& query, const Cancelled& cancelled) = 0;
};

}  // namespace redrive::serve

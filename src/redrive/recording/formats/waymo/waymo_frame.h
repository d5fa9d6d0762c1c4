// SPDX-License-Identifier: Apache-2.0
// Frames of the Waymo Open Dataset: the fields of waymo_open_dataset/dataset.proto and label.proto
// that are read, without the contents of images and range images.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "redrive/camera/calibration.h"
#include "redrive/recording/core/recording.h"
#include "redrive/recording/parse/proto_reader.h"

namespace redrive::waymo {

/// Farthest place in the world and in the body.
constexpr double kMaxCoordinate_m = 1e7;

struct CameraContext {
  CameraCalibration calibration;  ///< without times, but for readout_by_column
  int direction = 0;              ///< sign of readout_ns; 0: a global shutter
};

struct LaserContext {
  Rigid3d body_from_laser = Rigid3d::Identity();
  std::vector<double> inclinations_rad;  ///< one for each beam, ascending; empty: evenly spaced
  double least_rad = 0, most_rad = 0;    ///< inclinations where they are evenly spaced
};

/// Calibrations by the numbers that cameras and lasers have.
struct Context {
  std::string name;
  std::map<int, CameraContext> cameras;
  std::map<int, LaserContext> lasers;
};

struct Image {
  int camera = 0;
  ByteSpan jpeg = {};
  Rigid3d world_from_body;  ///< at pose_ns
  std::int64_t pose_ns = 0;
  double shutter_s = 0, trigger_s = 0, done_s = 0;  ///< exposure; both as seconds since 1970
};

struct RangeImage {
  int laser = 0;
  ByteSpan first = {};  ///< zlib, a matrix of range, intensity, elongation, zone
  ByteSpan poses = {};  ///< zlib, a matrix of poses; empty: none
  bool has_second = false;
};

struct LabelledBox {
  std::string id, type;
  Rigid3d body_from_box;
  Eigen::Vector3d size_m = Eigen::Vector3d::Zero();
};

struct Frame {
  std::string context_name;
  std::int64_t t_ns = 0;
  Rigid3d world_from_body;
  std::vector<Image> images;
  std::vector<RangeImage> range_images;
  std::vector<LabelledBox> boxes;
  std::size_t no_label_zones = 0;
};

/// Names of cameras and lasers: "FRONT", "SIDE_LEFT", ...
std::string camera_name(int camera);
std::string laser_name(int laser);

/// Reads the calibrations of a frame. InputError.
Context parse_context(const ByteSource& bytes, ByteSpan frame, const std::filesystem::path& file,
                      std::vector<Finding>* findings);

/// Reads a frame. Boxes that cannot be go to `impossible`, in words; images and scans that cannot,
/// to `damaged`, with the number of the record. InputError.
Frame parse_frame(const ByteSource& bytes, ByteSpan frame, std::int64_t record,
                  const std::filesystem::path& file, std::vector<std::string>* impossible,
                  std::vector<DamagedRecord>* damaged);

/// A matrix of floats of up to 2^24 values, row by row.
struct Matrix {
  std::vector<std::int64_t> dims;
  std::vector<float> values;
};
/// Reads a packed matrix, whose name is for messages. InputError.
Matrix parse_matrix(const ByteSource& bytes, ByteSpan packed, const std::filesystem::path& file,
                    const std::string& name);

}  // namespace redrive::waymo

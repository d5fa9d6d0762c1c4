// SPDX-License-Identifier: Apache-2.0
// Cameras of a run as calibrations, at the size that it renders.
#pragma once

#include <algorithm>
#include <array>

#include "redrive/train/run.h"

namespace redrive {

/// Returns the calibration of a camera of the run's rig, with the run's corrections; without
/// distortion where training undistorted.
inline CameraCalibration calibration_of(const Run& run, const RigCamera& rig) {
  const Camera& camera = rig.camera;
  CameraCalibration out = run.recording.find_camera(rig.name)->calibration;
  if (camera.info().name != out.model) {  // undistorted
    out.model = camera.info().name;
    out.parameters.assign(4 + camera.info().distortion.size(), 0.0);
  }
  std::ranges::copy(std::array{camera.fx, camera.fy, camera.cx, camera.cy}, out.parameters.begin());
  out.width = camera.width;
  out.height = camera.height;
  out.body_from_sensor = rig.body_from_sensor;
  out.time_offset_ns = rig.time_offset_ns;
  out.readout_ns = rig.readout_ns;
  out.readout_by_column = rig.readout_by_column;
  return out;
}

}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
#include "redrive/camera/camera.h"

#include "redrive/base/error.h"

namespace redrive {

std::optional<Eigen::Vector2d> Camera::project(const Eigen::Vector3d& point) const {
  return std::visit(
      [&](const auto& m) -> std::optional<Eigen::Vector2d> {
        const auto distorted = m.template project<double>({point.x(), point.y(), point.z()});
        if (!distorted) return std::nullopt;
        return Eigen::Vector2d(fx * (*distorted)[0] + cx, fy * (*distorted)[1] + cy);
      },
      model);
}

std::optional<Eigen::Vector3d> Camera::unproject(const Eigen::Vector2d& pixel) const {
  const Eigen::Vector2d distorted((pixel.x() - cx) / fx, (pixel.y() - cy) / fy);
  const auto direction = std::visit([&](const auto& m) { return m.unproject(distorted); }, model);
  if (!direction) return std::nullopt;
  return direction->normalized();
}

Camera Camera::downscaled(int factor) const {
  REDRIVE_CHECK_OP(factor, >=, 1);
  Camera small = *this;
  small.fx = fx / factor;
  small.fy = fy / factor;
  small.cx = (cx + 0.5) / factor - 0.5;
  small.cy = (cy + 0.5) / factor - 0.5;
  small.width = width / factor;
  small.height = height / factor;
  return small;
}

Camera Camera::undistorted() const {
  REDRIVE_CHECK(info().perspective);
  Camera plain = *this;
  plain.model = OpenCvPinhole{};
  return plain;
}

double Camera::covered_radius() const {
  return std::visit([](const auto& m) { return m.covered_radius(); }, model);
}

Camera make_camera(const CameraCalibration& calibration) {
  const CameraModelInfo* model = find_camera_model(calibration.model);
  if (!model)
    throw InputError("calibration", calibration.name + ".model", calibration.model,
                     "known are " + camera_model_names());
  REDRIVE_CHECK_OP(calibration.parameters.size(), ==,
                   4 + model->distortion.size() + model->other.size());
  Camera camera;
  camera.model = model->make(std::span(calibration.parameters).subspan(4));
  camera.fx = calibration.fx();
  camera.fy = calibration.fy();
  camera.cx = calibration.cx();
  camera.cy = calibration.cy();
  camera.width = calibration.width;
  camera.height = calibration.height;
  REDRIVE_CHECK(camera.fx > 0 && camera.fy > 0);  // readers of calibrations have checked it
  return camera;
}

}  // namespace redrive

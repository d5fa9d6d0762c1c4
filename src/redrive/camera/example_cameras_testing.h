// SPDX-License-Identifier: Apache-2.0
// Cameras that the tests walk: at least one of every model, of every character.
#pragma once

#include <cmath>
#include <string>
#include <vector>

#include "redrive/camera/camera.h"

namespace redrive {

struct ExampleCamera {
  std::string name;
  Camera camera;
};

inline std::vector<ExampleCamera> example_cameras() {
  const auto make = [](const char* name, const char* model, std::array<double, 5> distortion,
                       double xi, double fx, double fy) {
    CameraCalibration c;
    c.name = name;
    c.model = model;
    c.distortion = distortion;
    c.xi = xi;
    c.fx = fx;
    c.fy = fy;
    c.cx = 163.25;
    c.cy = 98.5;
    c.width = 320;
    c.height = 200;
    return ExampleCamera{name, make_camera(c)};
  };
  return {
      make("plain pinhole", "opencv_pinhole", {0, 0, 0, 0, 0}, 0, 300, 260),
      make("barrel", "opencv_pinhole", {-0.3, 0.08, 0.002, 0.0006, 0}, 0, 293, 250),
      make("wide barrel", "opencv_pinhole", {-0.33, 0.1, -0.001, 0.0013, 0}, 0, 161, 162),
      make("barrel that folds in the image", "opencv_pinhole", {-0.4, 0, 0, 0, 0}, 0, 180, 190),
      make("tangential fold in the image", "opencv_pinhole", {-0.4, 0.01, 0.004, -0.003, 0}, 0, 180,
           190),
      make("sixth order", "opencv_pinhole", {0.1, -0.05, 0.001, 0.001, -0.04}, 0, 130, 140),
      make("fisheye", "mei", {0.03, -0.08, 0, 0, 0}, 1.02, 144, 126),
      make("fisheye with tangential terms", "mei", {-0.05, 0.01, 0.001, -0.002, 0}, 0.8, 110, 120),
      make("fisheye beyond its sphere", "mei", {0, 0, 0, 0, 0}, 1.5, 120, 120),
      make("parabolic mirror", "mei", {0, 0, 0, 0, 0}, 1, 60, 60),
      make("mei as a pinhole", "mei", {-0.2, 0.05, 0, 0, 0.001}, 0, 250, 250),
      make("equidistant", "opencv_fisheye", {0, 0, 0, 0, 0}, 0, 100, 100),
      make("Kannala-Brandt", "opencv_fisheye", {0.03, 0.005, 0.0007, -0.0001, 0}, 0, 110, 112),
      make("Kannala-Brandt fold in the image", "opencv_fisheye", {-0.1, 0, 0, 0, 0}, 0, 90, 90),
  };
}

/// The lens of a pinhole or mei camera; null for others.
inline const BrownConrady* brown_conrady_of(const Camera& camera) {
  return std::visit(
      [](const auto& m) -> const BrownConrady* {
        if constexpr (requires { m.distortion; })
          return &m.distortion;
        else
          return nullptr;
      },
      camera.model);
}

/// Whether directions before the model's own limit are refused because the distortion folds back.
inline bool folds(const Camera& camera) {
  if (const BrownConrady* lens = brown_conrady_of(camera)) return std::isfinite(lens->max_radius);
  return std::get<OpenCvFisheye>(camera.model).max_angle_rad < 3.14;
}

/// Distance from the principal point, normalised, within which every pixel is seen. NaN or less
/// than 0 where the model has no edge. Along a pixel's own direction the edge of a Brown-Conrady
/// disc is r g away, less 6 |p| r^2 for the tangential terms.
inline double covered_radius(const Camera& camera) {
  const BrownConrady* lens = brown_conrady_of(camera);
  if (!lens) {
    const OpenCvFisheye& fisheye = std::get<OpenCvFisheye>(camera.model);
    return fisheye.distort(fisheye.max_angle_rad);
  }
  const double r = lens->max_radius, s = r * r;
  return r * (1 + s * (lens->k1 + s * (lens->k2 + s * lens->k3))) -
         6 * std::hypot(lens->p1, lens->p2) * s;
}

}  // namespace redrive

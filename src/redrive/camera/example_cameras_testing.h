// SPDX-License-Identifier: Apache-2.0
// Cameras for tests that hold for every model: each of the registry, and lenses of every character.
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
  std::vector<ExampleCamera> cameras;
  const auto add = [&](std::string name, std::string_view model,
                       const std::vector<double>& parameters, double fx, double fy) {
    CameraCalibration c{name, std::string(model), {fx, fy, 163.25, 98.5}, 320, 200};
    c.parameters.insert(c.parameters.end(), parameters.begin(), parameters.end());
    cameras.push_back({std::move(name), make_camera(c)});
  };
  add("plain pinhole", "opencv_pinhole", {0, 0, 0, 0, 0}, 300, 260);
  add("barrel", "opencv_pinhole", {-0.3, 0.08, 0.002, 0.0006, 0}, 293, 250);
  add("wide barrel", "opencv_pinhole", {-0.33, 0.1, -0.001, 0.0013, 0}, 161, 162);
  add("barrel that folds in the image", "opencv_pinhole", {-0.4, 0, 0, 0, 0}, 180, 190);
  add("tangential fold in the image", "opencv_pinhole", {-0.4, 0.01, 0.004, -0.003, 0}, 180, 190);
  add("sixth order", "opencv_pinhole", {0.1, -0.05, 0.001, 0.001, -0.04}, 130, 140);
  add("fisheye", "mei", {0.03, -0.08, 0, 0, 0, 1.02}, 144, 126);
  add("fisheye with tangential terms", "mei", {-0.05, 0.01, 0.001, -0.002, 0, 0.8}, 110, 120);
  add("fisheye beyond its sphere", "mei", {0, 0, 0, 0, 0, 1.5}, 120, 120);
  add("parabolic mirror", "mei", {0, 0, 0, 0, 0, 1}, 60, 60);
  add("mei as a pinhole", "mei", {-0.2, 0.05, 0, 0, 0.001, 0}, 250, 250);
  add("equidistant", "opencv_fisheye", {0, 0, 0, 0}, 100, 100);
  add("Kannala-Brandt", "opencv_fisheye", {0.03, 0.005, 0.0007, -0.0001}, 110, 112);
  add("Kannala-Brandt fold in the image", "opencv_fisheye", {-0.1, 0, 0, 0}, 90, 90);
  add("rational", "opencv_rational", {0.2, -0.1, 0.001, -0.0005, 0.01, 0.5, -0.08, 0.02}, 290, 280);
  add("rational as barrel", "opencv_rational", {-0.3, 0.08, 0.002, 0.0006, 0, 0, 0, 0}, 293, 250);
  add("rational that folds in the image", "opencv_rational", {-0.4, 0, 0, 0, 0, 0.1, 0, 0}, 180,
      190);
  add("pinhole with a prism", "opencv_thin_prism",
      {0.2, -0.1, 0.001, -0.0005, 0.01, 0.5, -0.08, 0.02, 0.004, -0.002, -0.003, 0.001}, 290, 280);
  add("pinhole with a prism that folds in the image", "opencv_thin_prism",
      {-0.4, 0, 0, 0, 0, 0.1, 0, 0, 0.01, 0.01, -0.01, 0.02}, 180, 190);
  add("field of view", "fov", {0.9}, 300, 260);
  add("field of view of a pinhole", "fov", {0}, 300, 260);
  add("wide field of view, sphere's edge in the image", "fov", {2.2}, 150, 150);
  add("thin prism", "thin_prism_fisheye",
      {0.03, 0.005, 0.0002, -0.0003, 0.0007, -0.0001, 0.0004, -0.0002}, 110, 112);
  add("thin prism fold in the image", "thin_prism_fisheye", {-0.1, 0, 0.001, 0, 0, 0, 0.002, 0}, 90,
      90);
  add("f-theta", "ftheta", {0.02, -0.05, 0.01, -0.002, 0.001, -0.0008, 2.4}, 110, 112);
  add("f-theta fold in the image", "ftheta", {0, -0.12, 0, 0, 0, 0, 3}, 80, 80);
  add("inverse f-theta", "ftheta_inverse", {-0.02, 0.06, -0.01, 0.002, 0.001, -0.0008, 2.4}, 110,
      112);
  add("inverse f-theta fold in the image", "ftheta_inverse", {0, -0.12, 0, 0, 0, 0, 3}, 80, 80);
  add("Usenko", "double_sphere", {-0.2, 0.59}, 110, 112);
  add("Usenko, sphere's edge in the image", "double_sphere", {0.3, 0.7}, 60, 62);
  add("Usenko as a unified model", "double_sphere", {0, 0.5}, 90, 90);
  add("Usenko as a pinhole", "double_sphere", {0, 0}, 250, 250);
  add("Khomutenko", "eucm", {0.6, 1.1}, 110, 112);
  add("Khomutenko, sphere's edge in the image", "eucm", {0.8, 0.9}, 70, 72);
  add("Khomutenko that sees ahead", "eucm", {0.3, 2}, 110, 110);
  std::vector<double> glass(find_camera_model("ftheta_windshield")->typical.begin(),
                            find_camera_model("ftheta_windshield")->typical.end());
  add("windshield", "ftheta_windshield", glass, 175, 172);
  glass[6] = -0.6;  // h_20
  add("windshield fold in the image", "ftheta_windshield", glass, 120, 120);
  for (const CameraModelInfo& model : camera_models())
    add("typical " + std::string(model.name), model.name,
        {model.typical.begin(), model.typical.end()}, 250, 240);
  return cameras;
}

/// n directions over the whole sphere, none on an axis: a spiral of equal areas.
inline std::vector<Eigen::Vector3d> directions(int n) {
  std::vector<Eigen::Vector3d> all;
  for (int i = 0; i < n; ++i) {
    const double z = 1 - (2 * i + 1.0) / n, r = std::sqrt(1 - z * z), angle = 2.399963229728653 * i;
    all.emplace_back(r * std::cos(angle), r * std::sin(angle), z);
  }
  return all;
}

}  // namespace redrive

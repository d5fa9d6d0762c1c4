// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <map>

#include <pybind11/stl.h>

#include "redrive/base/did_you_mean.h"
#include "redrive/base/error.h"
#include "redrive/python/arrays.h"
#include "redrive/python/bindings.h"
#include "redrive/python/calls.h"
#include "redrive/recording/formats/calibration_fields.h"

namespace redrive::python {
namespace {

using Numbers = py::array_t<double, py::array::c_style | py::array::forcecast>;

/// Throws UsageError unless the last axis has `n` elements.
void require_last(const Numbers& array, const char* argument, py::ssize_t n) {
  if (array.ndim() == 0 || array.shape(array.ndim() - 1) != n)
    throw UsageError(argument, "", "must have " + std::to_string(n) + " numbers on its last axis");
}

Shape with_last(const Numbers& array, py::ssize_t last) {
  Shape shape(array.shape(), array.shape() + array.ndim());
  shape.back() = last;
  return shape;
}

/// Maps the vectors of `n` numbers on the last axis to `m` numbers, NaN where `map` has nothing.
template <int n, int m, class Map>
py::array mapped(const Numbers& in, const char* argument, const Map& map) {
  require_last(in, argument, n);
  const auto count = static_cast<std::size_t>(in.size() / n);
  const double* const from = in.data();
  std::vector<double> out(m * count, std::numeric_limits<double>::quiet_NaN());
  without_lock([&] {
    for (std::size_t i = 0; i < count; ++i)
      if (const auto to = map(Eigen::Matrix<double, n, 1>(from + n * i)))
        std::copy_n(to->data(), m, out.data() + m * i);
  });
  return taken(std::move(out), with_last(in, m));
}

/// Throws UsageError where no camera can have a number (recording/formats/calibration_fields.h).
template <class Read>
double checked(const char* argument, const std::string& name, double value, const Read& read) {
  try {
    const nlohmann::json document = value;
    return read(JsonField(document, argument));
  } catch (const InputError& error) {
    throw UsageError(argument, name + " = " + std::to_string(value), error.rule);
  }
}

NamedCamera make_named(const std::string& name, const std::string& model, int width, int height,
                       const std::map<std::string, double>& intrinsics,
                       const py::object& rig_from_camera, std::int64_t time_offset_ns,
                       std::int64_t readout_ns, bool readout_by_column) {
  const CameraModelInfo* const info = find_camera_model(model);
  if (!info) throw UsageError("model", model, "unknown; known are " + camera_model_names());
  if (width < 1 || height < 1 || width > 16384 || height > 16384)
    throw UsageError("width, height", std::to_string(width) + ", " + std::to_string(height),
                     "must be 1 to 16384 pixels");
  constexpr double kMaxOffset_ns = 1e9, kMaxReadout_ns = 1e9 * kMaxReadout_s;
  if (std::abs(static_cast<double>(time_offset_ns)) > kMaxOffset_ns)
    throw UsageError("time_offset_ns", std::to_string(time_offset_ns), "must be at most a second");
  if (std::abs(static_cast<double>(readout_ns)) > kMaxReadout_ns)
    throw UsageError("readout_ns", std::to_string(readout_ns), "must be at most 0.2 seconds");
  std::vector<std::string> names = {"fx", "fy", "cx", "cy"};
  std::vector<CameraParameter> of_model;
  for (const auto* parameters : {&info->distortion, &info->other})
    for (const CameraParameter& parameter : *parameters) {
      names.emplace_back(parameter.name);
      of_model.push_back(parameter);
    }
  CameraCalibration calibration{name, model};
  for (const auto& [given, value] : intrinsics)
    if (std::ranges::find(names, given) == names.end())
      throw UsageError("intrinsics", given, unknown_name(given, names));
  for (std::size_t i = 0; i < names.size(); ++i) {
    const auto given = intrinsics.find(names[i]);
    if (given == intrinsics.end() && i < 4) throw UsageError("intrinsics", names[i], "is missing");
    const double value = given == intrinsics.end() ? 0 : given->second;
    if (given != intrinsics.end())
      checked("intrinsics", names[i], value, [&](const JsonField& field) {
        if (i >= 4) return parameter_from_json(field, of_model[i - 4]);
        if (i >= 2) return principal_point_from_json(field, i == 2 ? width : height);
        return focal_length_from_json(field);
      });
    calibration.parameters.push_back(value);
  }
  calibration.width = width;
  calibration.height = height;
  calibration.body_from_sensor = rig_from_camera.is_none()
                                     ? Rigid3d::Identity()
                                     : rigid_argument("rig_from_camera", rig_from_camera);
  calibration.time_offset_ns = time_offset_ns;
  calibration.readout_ns = readout_ns;
  calibration.readout_by_column = readout_by_column;
  return NamedCamera(calibration);
}

}  // namespace

void bind_camera(py::module_& module) {
  py::class_<NamedCamera>(
      module, "Camera",
      "A camera: lens, place on the body, times. Cameras of a recording or a run have its "
      "images' size; one of your own is for Run.render.")
      .def(py::init(&make_named), py::arg("name"), py::arg("model"), py::arg("width"),
           py::arg("height"), py::arg("intrinsics"), py::arg("rig_from_camera") = py::none(),
           py::arg("time_offset_ns") = 0, py::arg("readout_ns") = 0,
           py::arg("readout_by_column") = false,
           "model: opencv_pinhole, mei, opencv_fisheye, opencv_rational, opencv_thin_prism, fov, "
           "thin_prism_fisheye, ftheta, ftheta_inverse, both with _windshield, double_sphere or "
           "eucm. intrinsics: fx, fy, cx, cy in pixels and the model's coefficients by name, 0 "
           "where left out. rig_from_camera: [4, 4], default: identity.")
      .def_property_readonly(
          "name", [](const NamedCamera& c) { return c.rig.name; }, "str")
      .def_property_readonly(
          "model", [](const NamedCamera& c) { return std::string(c.rig.camera.info().name); },
          "str, as COLMAP and OpenCV name it: \"opencv_pinhole\", ...")
      .def_property_readonly(
          "width", [](const NamedCamera& c) { return c.rig.camera.width; }, "int, pixels")
      .def_property_readonly(
          "height", [](const NamedCamera& c) { return c.rig.camera.height; }, "int, pixels")
      .def_property_readonly(
          "intrinsics",
          [](const NamedCamera& c) {
            py::dict all;
            for (const auto& [name, value] : c.intrinsics) all[py::str(name)] = value;
            return all;
          },
          "dict of float: fx, fy, cx, cy in pixels, then the model's coefficients")
      .def_property_readonly(
          "rig_from_camera", [](const NamedCamera& c) { return matrix(c.rig.body_from_sensor); },
          "[4, 4] float64: the camera's place on the body, metres")
      .def_property_readonly(
          "time_offset_ns", [](const NamedCamera& c) { return c.rig.time_offset_ns; },
          "int: exposure of the middle row minus the frame's time")
      .def_property_readonly(
          "readout_ns", [](const NamedCamera& c) { return c.rig.readout_ns; },
          "int: from the first row's exposure to the last's; 0: global shutter, negative: from "
          "the lowest row up")
      .def_property_readonly(
          "readout_by_column", [](const NamedCamera& c) { return c.rig.readout_by_column; },
          "bool: the shutter rolls from the left column to the right one instead")
      .def(
          "project",
          [](const NamedCamera& c, const Numbers& points) {
            return mapped<3, 2>(points, "points", [&](const Eigen::Vector3d& point) {
              return c.rig.camera.project(point);
            });
          },
          py::arg("points"),
          "Pixels [..., 2] of points [..., 3] in camera axes; NaN outside the lens's valid region.")
      .def(
          "unproject",
          [](const NamedCamera& c, const Numbers& pixels) {
            return mapped<2, 3>(pixels, "pixels", [&](const Eigen::Vector2d& pixel) {
              return c.rig.camera.unproject(pixel);
            });
          },
          py::arg("pixels"),
          "Unit directions [..., 3] in camera axes of pixels [..., 2]; NaN where there are none.")
      .def("__repr__", [](const NamedCamera& c) {
        return "<redrive.Camera " + c.rig.name + ": " + std::string(c.rig.camera.info().name) +
               ", " + std::to_string(c.rig.camera.width) + " x " +
               std::to_string(c.rig.camera.height) + ">";
      });
}

}  // namespace redrive::python

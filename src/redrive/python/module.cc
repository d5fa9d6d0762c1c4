// SPDX-License-Identifier: Apache-2.0
// The Python module: `import redrive`.
#include <pybind11/pybind11.h>

#include "redrive/base/error.h"
#include "redrive/python/arrays.h"
#include "redrive/python/bindings.h"

namespace redrive::python {
namespace {

/// Makes an exception class with these bases.
py::object error_class(py::module_& module, const char* name, const py::tuple& bases,
                       const char* help) {
  py::dict fields;
  fields["__doc__"] = help;
  fields["__module__"] = "redrive";
  const py::object made = py::reinterpret_steal<py::object>(
      PyErr_NewException(("redrive." + std::string(name)).c_str(), bases.ptr(), fields.ptr()));
  module.attr(name) = made;
  return made;
}

/// Classes live as long as the interpreter.
struct ErrorClasses {
  py::handle input, usage, io, data, device;
};
ErrorClasses& classes() {
  static ErrorClasses all;
  return all;
}

/// Sets the exception with these attributes.
template <class... Fields>
void set_error(const py::handle& type, const char* message, const Fields&... fields) {
  const py::object error = type(message);
  (py::setattr(error, fields.first, py::str(fields.second)), ...);
  PyErr_SetObject(type.ptr(), error.ptr());
}

void translate(std::exception_ptr thrown) {
  using Field = std::pair<const char*, const std::string&>;
  try {
    std::rethrow_exception(thrown);
  } catch (const InputError& error) {
    set_error(classes().input, error.what(), Field("file", error.file), Field("field", error.field),
              Field("value", error.value), Field("rule", error.rule));
  } catch (const UsageError& error) {
    set_error(classes().usage, error.what(), Field("option", error.option),
              Field("value", error.value), Field("rule", error.rule));
  } catch (const IoError& error) {
    set_error(classes().io, error.what());
  } catch (const InsufficientDataError& error) {
    set_error(classes().data, error.what());
  } catch (const DeviceError& error) {
    set_error(classes().device, error.what());
  } catch (const Interrupted& error) {
    // Python's handler has seen the signal by now; other threads than its main one raise it here.
    if (PyErr_CheckSignals() == 0) PyErr_SetString(PyExc_KeyboardInterrupt, error.what());
  }
}

}  // namespace

void bind_errors(py::module_& module) {
  const auto of = [](PyObject* type) { return py::reinterpret_borrow<py::object>(type); };
  const py::object error = error_class(module, "Error", py::make_tuple(of(PyExc_Exception)),
                                       "Base class of redrive's errors.");
  const py::tuple value_error = py::make_tuple(error, of(PyExc_ValueError));
  ErrorClasses& all = classes();
  all.input = error_class(module, "InputError", value_error,
                          "A recording, run or file that cannot be used. Attributes, all text: "
                          "file; field, \"\" for the whole file; value; rule, which it breaks.")
                  .release();
  all.usage = error_class(module, "UsageError", value_error,
                          "An argument or option that cannot be used. Attributes, all text: "
                          "option, value, rule.")
                  .release();
  all.io = error_class(module, "IoError", py::make_tuple(error, of(PyExc_OSError)),
                       "A file or folder that could not be written.")
               .release();
  all.data = error_class(module, "InsufficientDataError", value_error,
                         "Valid data that does not determine the result.")
                 .release();
  all.device = error_class(module, "DeviceError", py::make_tuple(error, of(PyExc_RuntimeError)),
                           "A GPU that failed, was lost or has no memory left.")
                   .release();
  py::register_exception_translator(translate);
}

Axes axes_of(const std::string& name) {
  if (name == "sensor") return Axes::kSensor;
  if (name == "body") return Axes::kBody;
  if (name == "world") return Axes::kWorld;
  throw UsageError("axes", name, "must be sensor, body or world");
}

std::vector<Rigid3d> rigid_arguments(const char* argument, const py::handle& matrices) {
  const auto array = py::array_t<double, py::array::c_style | py::array::forcecast>::ensure(
      py::reinterpret_borrow<py::object>(matrices));
  if (!array) PyErr_Clear();
  const py::ssize_t axes = array ? array.ndim() : 0;
  if ((axes != 2 && axes != 3) || array.shape(axes - 2) != 4 || array.shape(axes - 1) != 4 ||
      array.size() == 0)
    throw UsageError(argument, "", "must be a [4, 4] matrix, or [n, 4, 4]");
  std::vector<Rigid3d> poses(static_cast<std::size_t>(array.size() / 16));
  for (std::size_t i = 0; i < poses.size(); ++i) {
    const Eigen::Matrix4d pose =
        Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(array.data() + 16 * i);
    if (const std::string obstacle = rigid_obstacle(pose); !obstacle.empty())
      throw UsageError(argument, "", "must be a rigid transform: " + obstacle);
    poses[i].matrix() = pose;
  }
  return poses;
}

Rigid3d rigid_argument(const char* argument, const py::handle& matrix) {
  const std::vector<Rigid3d> poses = rigid_arguments(argument, matrix);
  if (poses.size() != 1) throw UsageError(argument, "", "must be one [4, 4] matrix");
  return poses[0];
}

}  // namespace redrive::python

PYBIND11_MODULE(redrive, module) {
  module.doc() =
      "Recordings of sensor cars as numpy arrays, and the radiance fields that redrive trains on "
      "them.\n\n"
      "redrive.open(path) opens a recording of any format that `redrive inspect` knows: images,\n"
      "poses, rays of every pixel, LiDAR scans, boxes. redrive.train(path, out) trains a run,\n"
      "redrive.load(run) opens one: it renders cameras and LiDARs at any pose and time.\n\n"
      "Poses are [4, 4] matrices named a_from_b: x_in_a = a_from_b @ x_in_b. Lengths are metres,\n"
      "times whole nanoseconds of the recording's clock. Axes: camera x right, y down, z forward;\n"
      "body x forward, y left, z up, its origin on the ground under the rear axle; LiDAR x\n"
      "forward, y left, z up; the world has the body's axes at the first frame. Pixel (0, 0) is\n"
      "the centre of the upper left one. Work goes on without the interpreter's lock, and Ctrl-C\n"
      "ends it.";
  redrive::python::bind_errors(module);
  redrive::python::bind_camera(module);
  redrive::python::bind_recording(module);
  redrive::python::bind_run(module);
  redrive::python::bind_training(module);
}

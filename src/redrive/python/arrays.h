// SPDX-License-Identifier: Apache-2.0
// numpy arrays of what the libraries return, without copies where the memory can be handed over.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include "redrive/math/rigid3.h"

namespace redrive::python {

namespace py = pybind11;

using Shape = std::vector<py::ssize_t>;

/// Returns an array that owns the vector's memory. `shape` has as many elements as the vector.
template <class T>
py::array taken(std::vector<T>&& values, const Shape& shape) {
  auto* const owned = new std::vector<T>(std::move(values));
  const py::capsule owner(owned, [](void* memory) { delete static_cast<std::vector<T>*>(memory); });
  return py::array(py::dtype::of<T>(), shape, owned->data(), owner);
}

/// Returns a read-only array that repeats the elements of `values` along axes of stride 0.
inline py::array repeated(const py::array& values, const Shape& shape, const Shape& strides) {
  py::array view(values.dtype(), shape, strides, values.data(), values);
  view.attr("setflags")(py::arg("write") = false);
  return view;
}

/// Returns a read-only array over memory that `owner`, a Python object, keeps.
template <class T>
py::array shown(const std::vector<T>& values, const Shape& shape, const py::handle& owner) {
  py::array view(py::dtype::of<T>(), shape, values.data(), owner);
  view.attr("setflags")(py::arg("write") = false);
  return view;
}

/// Returns [n, 4, 4] matrices; a single pose without an axis of its own if `single`.
inline py::array matrices(const std::vector<Rigid3d>& poses, bool single = false) {
  std::vector<double> values;
  values.reserve(16 * poses.size());
  for (const Rigid3d& pose : poses)
    for (int row = 0; row < 4; ++row)
      for (int column = 0; column < 4; ++column) values.push_back(pose.matrix()(row, column));
  const auto n = static_cast<py::ssize_t>(poses.size());
  return taken(std::move(values), single ? Shape{4, 4} : Shape{n, 4, 4});
}

inline py::array matrix(const Rigid3d& pose) { return matrices({pose}, true); }

}  // namespace redrive::python

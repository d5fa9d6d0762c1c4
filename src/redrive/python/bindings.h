// SPDX-License-Identifier: Apache-2.0
// The parts of the module.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include <pybind11/pybind11.h>

#include "redrive/python/opened.h"

namespace redrive::python {

void bind_errors(pybind11::module_& module);
void bind_camera(pybind11::module_& module);
/// Recording and what it returns; redrive.open.
void bind_recording(pybind11::module_& module);
/// Run; redrive.load.
void bind_run(pybind11::module_& module);
/// redrive.train.
void bind_training(pybind11::module_& module);

/// Returns the axes of this name. UsageError.
Axes axes_of(const std::string& name);

/// Writes a recording or a run as a drive in a data set's layout; returns remarks. UsageError
/// naming `to`.
std::vector<std::string> export_drive(Opened& opened, const std::filesystem::path& out,
                                      const std::string& to, bool force);

/// A rigid transform from a [4, 4] array. UsageError naming `argument`.
Rigid3d rigid_argument(const char* argument, const pybind11::handle& matrix);
/// One or more, from [4, 4] or [n, 4, 4].
std::vector<Rigid3d> rigid_arguments(const char* argument, const pybind11::handle& matrices);

}  // namespace redrive::python

// SPDX-License-Identifier: Apache-2.0
// Work of the libraries on behalf of Python.
#pragma once

#include <pybind11/pybind11.h>

#include "redrive/base/processes/interruption.h"

namespace redrive::python {

/// Runs `work`, which may not touch Python's objects, without the interpreter's lock. Ctrl-C ends
/// it by Interrupted, or with `looks` sets InterruptibleCall::came.
template <class Work>
auto without_lock(const Work& work, bool looks = false) {
  const pybind11::gil_scoped_release released;
  const InterruptibleCall call(looks);
  return work();
}

}  // namespace redrive::python

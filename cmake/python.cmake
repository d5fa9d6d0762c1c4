# SPDX-License-Identifier: Apache-2.0
# The Python module (src/redrive/python) for Debian's python3, built where the headers of Python,
# numpy and pybind11 are installed; not with sanitizers, which python3 lacks. It links the program's
# libraries, which are position independent for it; -fno-semantic-interposition: their functions are
# inlined and called as before.
option(REDRIVE_PYTHON "Build the Python module, where its headers are installed" ON)
set(REDRIVE_HAS_PYTHON OFF)
if(REDRIVE_PYTHON AND NOT REDRIVE_SANITIZE)
  set(Python_EXECUTABLE /usr/bin/python3)  # not one of a user's own
  find_package(Python QUIET COMPONENTS Interpreter Development.Module NumPy)
  find_package(pybind11 QUIET)
  if(Python_FOUND AND pybind11_FOUND)
    set(REDRIVE_HAS_PYTHON ON)
    add_compile_options(-fPIC -fno-semantic-interposition)
  else()
    message(STATUS "python: left out, python3-dev, python3-numpy or pybind11-dev is missing")
  endif()
endif()

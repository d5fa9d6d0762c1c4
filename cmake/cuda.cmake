# SPDX-License-Identifier: Apache-2.0
# The CUDA backend (src/redrive/kernels/device) is in a build if there is nvcc: REDRIVE_CUDA=AUTO.
# ON wants it, OFF leaves it out. Sets REDRIVE_HAVE_CUDA. No GPU is needed to build it.
set(REDRIVE_CUDA AUTO CACHE STRING "The CUDA backend: AUTO (where there is nvcc), ON or OFF")
set(REDRIVE_HAVE_CUDA OFF)
if(REDRIVE_CUDA STREQUAL "OFF")
  message(STATUS "CUDA backend: left out (REDRIVE_CUDA=OFF)")
  return()
endif()

# Machine code for these, and PTX that a driver compiles for what comes after.
if(NOT DEFINED CMAKE_CUDA_ARCHITECTURES)
  set(CMAKE_CUDA_ARCHITECTURES 75-real 80-real 86-real 89-real 90-real 90-virtual)
endif()
include(CheckLanguage)
find_program(REDRIVE_NVCC nvcc HINTS ENV CUDA_PATH /usr/local/cuda PATH_SUFFIXES bin)
if(REDRIVE_NVCC AND NOT DEFINED ENV{CUDACXX})
  set(ENV{CUDACXX} ${REDRIVE_NVCC})
endif()
check_language(CUDA)
if(CMAKE_CUDA_COMPILER)
  enable_language(CUDA)
  if(NOT CMAKE_CUDA20_STANDARD_COMPILE_OPTION)  # CMake 3.25 does not know that nvcc has C++20
    set(CMAKE_CUDA20_STANDARD_COMPILE_OPTION -std=c++20)
    set(CMAKE_CUDA20_EXTENSION_COMPILE_OPTION -std=c++20)
  endif()
  set(REDRIVE_HAVE_CUDA ON)
  message(STATUS
    "CUDA backend: nvcc ${CMAKE_CUDA_COMPILER_VERSION}, architectures ${CMAKE_CUDA_ARCHITECTURES}")
elseif(REDRIVE_CUDA STREQUAL "AUTO")
  message(STATUS "CUDA backend: left out, there is no nvcc that works (REDRIVE_CUDA=ON says why)")
else()
  message(FATAL_ERROR
    "REDRIVE_CUDA=ON, but there is no nvcc that works: set CUDACXX to it; see CMakeError.log")
endif()

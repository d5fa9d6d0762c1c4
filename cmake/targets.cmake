# SPDX-License-Identifier: Apache-2.0
# Parsing Eigen, JSON and GoogleTest takes most of a file's compile time: precompiled once for the libraries and once for
# the tests. Kernels have ISA flags of their own and stay without.
file(WRITE ${CMAKE_BINARY_DIR}/pch.cc.new "")
file(COPY_FILE ${CMAKE_BINARY_DIR}/pch.cc.new ${CMAKE_BINARY_DIR}/pch.cc ONLY_IF_DIFFERENT)
set(redrive_headers <algorithm> <array> <cmath> <cstdint> <filesystem> <fstream> <functional> <memory> <optional> <span>
  <string> <vector> <Eigen/Geometry> <nlohmann/json.hpp>)
add_library(redrive_pch OBJECT ${CMAKE_BINARY_DIR}/pch.cc)
target_link_libraries(redrive_pch PRIVATE Eigen3::Eigen nlohmann_json::nlohmann_json)
target_precompile_headers(redrive_pch PRIVATE ${redrive_headers})
if(REDRIVE_TESTS)
  # Tests are compiled once for every run: no time for optimisation, and alignment is the libraries' to keep.
  set(redrive_test_options $<$<CONFIG:Release>:-O1>)
  if(REDRIVE_SANITIZE MATCHES "undefined")
    list(APPEND redrive_test_options -fno-sanitize=alignment)
  endif()
  add_library(redrive_test_pch OBJECT ${CMAKE_BINARY_DIR}/pch.cc)
  target_link_libraries(redrive_test_pch PRIVATE Eigen3::Eigen nlohmann_json::nlohmann_json GTest::gtest GTest::gmock)
  target_compile_options(redrive_test_pch PRIVATE ${redrive_test_options})
  target_precompile_headers(redrive_test_pch PRIVATE ${redrive_headers} <gmock/gmock.h> <gtest/gtest.h>)
endif()

# Compiles a target's files together: what they share, templates above all, is compiled once. For what is built whole; a change of one
# file compiles all. Names in a folder's anonymous namespaces must differ.
set(REDRIVE_UNITY "" CACHE STRING "What is compiled together: nothing, `tests` (those marked TOGETHER), or `all` (libraries, too)")
function(redrive_unity_build target)
  set_target_properties(${target} PROPERTIES UNITY_BUILD ON UNITY_BUILD_BATCH_SIZE 8)
endfunction()

# Done by redrive_library; a program with heavy headers asks for it.
function(redrive_precompile target)
  if(NOT REDRIVE_FUZZ)
    target_precompile_headers(${target} REUSE_FROM redrive_pch)
  endif()
endfunction()

# One folder is one library: redrive_library(camera SOURCES pinhole.cc DEPENDS redrive::math)
function(redrive_library name)
  cmake_parse_arguments(ARG "" "" "SOURCES;DEPENDS" ${ARGN})
  if(ARG_SOURCES)
    add_library(redrive_${name} STATIC ${ARG_SOURCES})
    target_include_directories(redrive_${name} PUBLIC ${CMAKE_SOURCE_DIR}/src)
    target_link_libraries(redrive_${name} PUBLIC ${ARG_DEPENDS})
    if(NOT name MATCHES "^kernels")
      redrive_precompile(redrive_${name})
      if(REDRIVE_UNITY STREQUAL "all")
        redrive_unity_build(redrive_${name})
      endif()
    endif()
  else()
    add_library(redrive_${name} INTERFACE)
    target_include_directories(redrive_${name} INTERFACE ${CMAKE_SOURCE_DIR}/src)
    target_link_libraries(redrive_${name} INTERFACE ${ARG_DEPENDS})
  endif()
  add_library(redrive::${name} ALIAS redrive_${name})
endfunction()

# Unit tests sit beside the source: redrive_test(camera SOURCES mei_test.cc DEPENDS redrive::camera [LABELS threads] [GPU pattern] [TOGETHER])
# makes the program test_camera; labelled `slow` it is not in builds with a sanitizer. Those of its tests that the pattern names are labelled
# `gpu` instead. The paths of the shipped samples and of the optional private recordings are compiled in; a test that needs the latter skips
# visibly where they are not.
function(redrive_test name)
  cmake_parse_arguments(ARG "TOGETHER" "GPU" "SOURCES;DEPENDS;LABELS" ${ARGN})
  if(NOT REDRIVE_TESTS OR (REDRIVE_SANITIZE AND "slow" IN_LIST ARG_LABELS))
    return()
  endif()
  add_executable(test_${name} ${ARG_SOURCES})
  target_link_libraries(test_${name} PRIVATE ${ARG_DEPENDS} GTest::gtest GTest::gmock GTest::gtest_main)
  target_compile_options(test_${name} PRIVATE ${redrive_test_options})
  target_precompile_headers(test_${name} REUSE_FROM redrive_test_pch)
  if(ARG_TOGETHER AND REDRIVE_UNITY MATCHES "^(tests|all)$")
    redrive_unity_build(test_${name})
  endif()
  target_compile_definitions(test_${name} PRIVATE
    REDRIVE_SAMPLES="${CMAKE_SOURCE_DIR}/samples" REDRIVE_SHARED="${CMAKE_SOURCE_DIR}/../shared"
    REDRIVE_SOURCE="${CMAKE_SOURCE_DIR}" REDRIVE_BINARY="${CMAKE_BINARY_DIR}/redrive")
  if(REDRIVE_SANITIZE MATCHES "thread")
    target_sources(test_${name} PRIVATE ${CMAKE_SOURCE_DIR}/cmake/tsan_suppressions.cc)
  endif()
  foreach(label ${ARG_LABELS})  # target tests_threads: builds the tests labelled `threads`, nothing else
    if(NOT TARGET tests_${label})
      add_custom_target(tests_${label})
    endif()
    add_dependencies(tests_${label} test_${name})
  endforeach()
  set(properties TIMEOUT 600)
  if(ARG_LABELS)  # an empty one would take the next word for its value
    list(APPEND properties LABELS "${ARG_LABELS}")
  endif()
  set(others "")
  if(ARG_GPU)
    set(others TEST_FILTER "-${ARG_GPU}")
    gtest_discover_tests(test_${name} TEST_FILTER "${ARG_GPU}" DISCOVERY_TIMEOUT 60 PROPERTIES TIMEOUT 600 LABELS gpu)
  endif()
  gtest_discover_tests(test_${name} ${others} DISCOVERY_TIMEOUT 60 PROPERTIES ${properties})
endfunction()

# SPDX-License-Identifier: Apache-2.0
# Parsing Eigen, JSON and GoogleTest takes most of a file's compile time: precompiled once for the
# libraries and once for the tests. Kernels have ISA flags of their own and stay without.
# libFuzzer's targets look at the coverage of what has the libraries' precompiled header.
file(WRITE ${CMAKE_BINARY_DIR}/pch.cc.new "")
file(COPY_FILE ${CMAKE_BINARY_DIR}/pch.cc.new ${CMAKE_BINARY_DIR}/pch.cc ONLY_IF_DIFFERENT)
set(redrive_headers <algorithm> <array> <cmath> <cstdint> <filesystem> <fstream> <functional>
  <memory> <optional> <span>
  <string> <vector> <Eigen/Geometry> <nlohmann/json.hpp>)
add_library(redrive_pch OBJECT ${CMAKE_BINARY_DIR}/pch.cc)
target_link_libraries(redrive_pch PRIVATE Eigen3::Eigen nlohmann_json::nlohmann_json)
target_precompile_headers(redrive_pch PRIVATE ${redrive_headers})
set(redrive_coverage "$<$<BOOL:${REDRIVE_FUZZ}>:-fsanitize=fuzzer-no-link>")
target_compile_options(redrive_pch PRIVATE ${redrive_coverage})
if(REDRIVE_TESTS)
  # Tests are compiled once for every run: no time for optimisation, least of all with sanitizers,
  # which need 1.6 times as long for -O1. Without sanitizers -O0 saves a sixth of their compile time
  # and loses it when they run.
  set(redrive_test_options $<$<CONFIG:Release>:-O1>)
  if(REDRIVE_SANITIZE)
    set(redrive_test_options -O0)
  endif()
  add_library(redrive_test_pch OBJECT ${CMAKE_BINARY_DIR}/pch.cc)
  target_link_libraries(redrive_test_pch PRIVATE Eigen3::Eigen nlohmann_json::nlohmann_json
    GTest::gtest GTest::gmock)
  target_compile_options(redrive_test_pch PRIVATE ${redrive_test_options})
  target_precompile_headers(redrive_test_pch PRIVATE ${redrive_headers} <gmock/gmock.h>
    <gtest/gtest.h>)
endif()

# Presets that are built whole set CMAKE_UNITY_BUILD: a target's files are compiled together, and
# what they share, templates above all, once. Names in a folder's anonymous namespaces must differ.

# Done by redrive_library; a program with heavy headers asks for it.
function(redrive_precompile target)
  target_precompile_headers(${target} REUSE_FROM redrive_pch)
  target_compile_options(${target} PRIVATE ${redrive_coverage})
endfunction()

# One folder is one library: redrive_library(camera SOURCES pinhole.cc DEPENDS redrive::math)
function(redrive_library name)
  cmake_parse_arguments(ARG "" "" "SOURCES;DEPENDS" ${ARGN})
  if(ARG_SOURCES)
    add_library(redrive_${name} STATIC ${ARG_SOURCES})
    target_include_directories(redrive_${name} PUBLIC ${CMAKE_SOURCE_DIR}/src)
    target_link_libraries(redrive_${name} PUBLIC ${ARG_DEPENDS})
    if(name MATCHES "^kernels")
      set_target_properties(redrive_${name} PROPERTIES UNITY_BUILD OFF)
    else()
      redrive_precompile(redrive_${name})
    endif()
  else()
    add_library(redrive_${name} INTERFACE)
    target_include_directories(redrive_${name} INTERFACE ${CMAKE_SOURCE_DIR}/src)
    target_link_libraries(redrive_${name} INTERFACE ${ARG_DEPENDS})
  endif()
  add_library(redrive::${name} ALIAS redrive_${name})
endfunction()

# The target `tests` builds all tests of a preset.
if(REDRIVE_TESTS)
  add_custom_target(tests)
endif()

# ceres::Jet is a header; tests that differentiate with it need not link Ceres.
if(REDRIVE_TESTS)
  add_library(redrive_jet INTERFACE)
  target_include_directories(redrive_jet SYSTEM INTERFACE
    $<TARGET_PROPERTY:Ceres::ceres,INTERFACE_INCLUDE_DIRECTORIES>)
  target_link_libraries(redrive_jet INTERFACE Eigen3::Eigen)
  add_library(redrive::jet ALIAS redrive_jet)
endif()

# Unit tests sit beside the source:
#   redrive_test(camera SOURCES mei_test.cc DEPENDS redrive::camera
#     [SANITIZE address|thread...] [ADDRESS_TESTS FILTER] [THREAD_TESTS FILTER] [APART] [OPTIMISED])
# makes the program test_camera. A build with a sanitizer has only the tests that name it and the
# libraries that these need: `address` is for what parses bytes from outside and for kernels, which
# index by hand, `thread` for what runs on several threads. ADDRESS_TESTS and THREAD_TESTS are
# filters of GoogleTest: the tests that run with that sanitizer, where others are trainings or
# references at length, have one thread, or run the same threads again. APART: its files, whose
# names are alike, are never compiled together. OPTIMISED: computes so much itself that it is
# optimised with sanitizers, too, and has no precompiled header there. The paths of the shipped
# samples and of the optional private recordings are compiled in; a test that needs the latter skips
# visibly where they are not.
function(redrive_test name)
  cmake_parse_arguments(ARG "APART;OPTIMISED" "ADDRESS_TESTS;THREAD_TESTS"
    "SOURCES;DEPENDS;SANITIZE" ${ARGN})
  if(ARG_UNPARSED_ARGUMENTS)
    message(FATAL_ERROR "redrive_test(${name}): unknown arguments ${ARG_UNPARSED_ARGUMENTS}")
  endif()
  string(REGEX MATCH "address|thread" sanitizer "${REDRIVE_SANITIZE}")
  if(NOT REDRIVE_TESTS OR (sanitizer AND NOT sanitizer IN_LIST ARG_SANITIZE))
    return()
  endif()
  add_executable(test_${name} ${ARG_SOURCES})
  if(ARG_APART)
    set_target_properties(test_${name} PROPERTIES UNITY_BUILD OFF)
  endif()
  target_link_libraries(test_${name} PRIVATE ${ARG_DEPENDS} GTest::gtest GTest::gmock
    GTest::gtest_main)
  target_compile_options(test_${name} PRIVATE ${redrive_test_options})
  if(REDRIVE_SANITIZE AND ARG_OPTIMISED)
    target_compile_options(test_${name} PRIVATE -O1)
  else()
    target_precompile_headers(test_${name} REUSE_FROM redrive_test_pch)
  endif()
  target_compile_definitions(test_${name} PRIVATE
    REDRIVE_SAMPLES="${CMAKE_SOURCE_DIR}/samples" REDRIVE_SHARED="${CMAKE_SOURCE_DIR}/../shared"
    REDRIVE_SOURCE="${CMAKE_SOURCE_DIR}" REDRIVE_BINARY="${CMAKE_BINARY_DIR}/redrive")
  add_dependencies(tests test_${name})
  set(filter "")
  if(sanitizer)
    string(TOUPPER ${sanitizer} sanitizer)
    set(filter "${ARG_${sanitizer}_TESTS}")
  endif()
  gtest_discover_tests(test_${name} TEST_FILTER "${filter}" DISCOVERY_TIMEOUT 60
    PROPERTIES TIMEOUT 600)
endfunction()

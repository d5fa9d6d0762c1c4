# SPDX-License-Identifier: Apache-2.0
# One folder is one library: redrive_library(camera SOURCES pinhole.cc DEPENDS redrive::math)
function(redrive_library name)
  cmake_parse_arguments(ARG "" "" "SOURCES;DEPENDS" ${ARGN})
  if(ARG_SOURCES)
    add_library(redrive_${name} STATIC ${ARG_SOURCES})
    target_include_directories(redrive_${name} PUBLIC ${CMAKE_SOURCE_DIR}/src)
    target_link_libraries(redrive_${name} PUBLIC ${ARG_DEPENDS})
  else()
    add_library(redrive_${name} INTERFACE)
    target_include_directories(redrive_${name} INTERFACE ${CMAKE_SOURCE_DIR}/src)
    target_link_libraries(redrive_${name} INTERFACE ${ARG_DEPENDS})
  endif()
  add_library(redrive::${name} ALIAS redrive_${name})
endfunction()

# Unit tests sit beside the source: redrive_test(camera SOURCES mei_test.cc DEPENDS redrive::camera [LABELS threads])
# makes the program test_camera. The paths of the shipped samples and of the optional private
# recordings are compiled in; a test that needs the latter skips visibly where they are not.
function(redrive_test name)
  cmake_parse_arguments(ARG "" "" "SOURCES;DEPENDS;LABELS" ${ARGN})
  if(NOT REDRIVE_TESTS)
    return()
  endif()
  add_executable(test_${name} ${ARG_SOURCES})
  target_link_libraries(test_${name} PRIVATE ${ARG_DEPENDS} GTest::gtest GTest::gmock GTest::gtest_main)
  target_compile_definitions(test_${name} PRIVATE
    REDRIVE_SAMPLES="${CMAKE_SOURCE_DIR}/samples" REDRIVE_SHARED="${CMAKE_SOURCE_DIR}/../shared"
    REDRIVE_SOURCE="${CMAKE_SOURCE_DIR}" REDRIVE_BINARY="${CMAKE_BINARY_DIR}/redrive")
  foreach(label ${ARG_LABELS})  # target tests_threads: builds the tests labelled `threads`, nothing else
    if(NOT TARGET tests_${label})
      add_custom_target(tests_${label})
    endif()
    add_dependencies(tests_${label} test_${name})
  endforeach()
  gtest_discover_tests(test_${name} DISCOVERY_TIMEOUT 60 PROPERTIES LABELS "${ARG_LABELS}" TIMEOUT 600)
endfunction()

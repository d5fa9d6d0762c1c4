# SPDX-License-Identifier: Apache-2.0
# The Debian packages (scripts/package): redrive has what src/redrive/cli installs, redrive-samples
# the sample street, redrive-mpi the library for several processes, which alone depends on MPI,
# redrive-serve the gRPC server, python3-redrive the Python module.
install(FILES LICENSE DESTINATION ${CMAKE_INSTALL_DOCDIR} RENAME copyright COMPONENT program)
install(FILES README.md CHANGELOG.md DESTINATION ${CMAKE_INSTALL_DOCDIR} COMPONENT program)
install(DIRECTORY samples/street DESTINATION ${CMAKE_INSTALL_DATADIR}/redrive/samples 
  COMPONENT samples)
install(FILES samples/street/LICENSE DESTINATION ${CMAKE_INSTALL_DATADIR}/doc/redrive-samples 
  RENAME copyright COMPONENT samples)

set(CPACK_GENERATOR DEB)
set(CPACK_PACKAGE_CONTACT "redrive maintainers")
set(CPACK_PACKAGING_INSTALL_PREFIX /usr)
set(CPACK_STRIP_FILES ON)
set(CPACK_COMPONENTS_ALL program samples)
if(TARGET redrive_mpi)
  list(APPEND CPACK_COMPONENTS_ALL mpi)
  set(CPACK_DEBIAN_MPI_PACKAGE_NAME redrive-mpi)
  set(CPACK_DEBIAN_MPI_FILE_NAME DEB-DEFAULT)
  set(CPACK_DEBIAN_MPI_PACKAGE_SHLIBDEPS ON)
  set(CPACK_DEBIAN_MPI_PACKAGE_DEPENDS "redrive (= ${PROJECT_VERSION}), openmpi-bin")
  set(CPACK_COMPONENT_MPI_DESCRIPTION "several processes of redrive by MPI
 The library that redrive loads when mpirun starts it.")
endif()
if(TARGET redrive_grpc)
  list(APPEND CPACK_COMPONENTS_ALL serve)
  set(CPACK_DEBIAN_SERVE_PACKAGE_NAME redrive-serve)
  set(CPACK_DEBIAN_SERVE_FILE_NAME DEB-DEFAULT)
  set(CPACK_DEBIAN_SERVE_PACKAGE_SHLIBDEPS ON)
  set(CPACK_DEBIAN_SERVE_PACKAGE_DEPENDS "redrive (= ${PROJECT_VERSION})")
  set(CPACK_COMPONENT_SERVE_DESCRIPTION "renders for driving simulators by gRPC
 The library that redrive serve loads.")
endif()
if(TARGET redrive_python)
  list(APPEND CPACK_COMPONENTS_ALL python)
  set(CPACK_DEBIAN_PYTHON_PACKAGE_NAME python3-redrive)
  set(CPACK_DEBIAN_PYTHON_FILE_NAME DEB-DEFAULT)
  set(CPACK_DEBIAN_PYTHON_PACKAGE_SECTION python)
  set(CPACK_DEBIAN_PYTHON_PACKAGE_SHLIBDEPS ON)
  math(EXPR after "${Python_VERSION_MINOR} + 1")
  set(CPACK_DEBIAN_PYTHON_PACKAGE_DEPENDS
    "python3 (>= 3.${Python_VERSION_MINOR}), python3 (<< 3.${after}), python3-numpy")
  set(CPACK_COMPONENT_PYTHON_DESCRIPTION "recordings and radiance fields of redrive in Python
 Images, poses, rays, LiDAR and boxes of recordings as numpy arrays; training and rendering.")
endif()
# What scripts/package builds.
add_custom_target(packaged DEPENDS redrive_cli)
if(TARGET redrive_python)
  add_dependencies(packaged redrive_python)
endif()
set(CPACK_DEB_COMPONENT_INSTALL ON)
set(CPACK_DEBIAN_PACKAGE_SECTION science)
set(CPACK_DEBIAN_PROGRAM_PACKAGE_NAME redrive)
set(CPACK_DEBIAN_PROGRAM_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_PROGRAM_PACKAGE_SHLIBDEPS ON)
set(CPACK_DEBIAN_PROGRAM_PACKAGE_RECOMMENDS "gnuplot-nox, fonts-dejavu-core")  # redrive figures
if(REDRIVE_FFMPEG_PACKAGES)  # redrive render path
  string(APPEND CPACK_DEBIAN_PROGRAM_PACKAGE_RECOMMENDS ", ${REDRIVE_FFMPEG_PACKAGES}")
endif()
set(CPACK_DEBIAN_PROGRAM_PACKAGE_SUGGESTS "redrive-samples, redrive-mpi, redrive-serve, libvulkan1")
set(CPACK_COMPONENT_PROGRAM_DESCRIPTION "radiance fields from the recordings of sensor cars
 Turns cameras, LiDAR and egomotion of a drive into a radiance field and renders new images of it.")
set(CPACK_DEBIAN_SAMPLES_PACKAGE_NAME redrive-samples)
set(CPACK_DEBIAN_SAMPLES_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_SAMPLES_PACKAGE_ARCHITECTURE all)
set(CPACK_COMPONENT_SAMPLES_DESCRIPTION "sample recording for redrive
 A street of 48 frames, with LiDAR and with ground truth beside the car's own path.")
include(CPack)

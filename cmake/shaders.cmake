# SPDX-License-Identifier: Apache-2.0
# Compute shaders: GLSL compiled by glslangValidator, made small by spirv-opt, checked by spirv-val
# and embedded as words. REDRIVE_VULKAN says whether these programs and Vulkan's headers are there.
option(REDRIVE_VULKAN "Build the backend for GPUs, where its programs and headers are installed" ON)
if(REDRIVE_VULKAN)
  find_program(REDRIVE_GLSLANG glslangValidator)
  find_program(REDRIVE_SPIRV_OPT spirv-opt)
  find_program(REDRIVE_SPIRV_VAL spirv-val)
  find_path(REDRIVE_VULKAN_HEADERS vulkan/vulkan.h)
  if(NOT REDRIVE_GLSLANG OR NOT REDRIVE_SPIRV_OPT OR NOT REDRIVE_SPIRV_VAL
      OR NOT REDRIVE_VULKAN_HEADERS)
    set(REDRIVE_VULKAN OFF)
    message(STATUS "gpu: left out, glslang-tools, spirv-tools or libvulkan-dev is missing")
  endif()
endif()

# Compiles a shader to ${CMAKE_CURRENT_BINARY_DIR}/shaders/${name}.spv and adds it to `library`:
#   redrive_shader(LIBRARY NAME SOURCE [DEFINES PASS=1...] [INCLUDES FOLDER...] [DEPENDS FILE...])
# INCLUDES: folders of included files; DEPENDS: those among them that the build writes.
function(redrive_shader library name source)
  cmake_parse_arguments(ARG "" "" "DEFINES;INCLUDES;DEPENDS" ${ARGN})
  set(out ${CMAKE_CURRENT_BINARY_DIR}/shaders/${name}.spv)
  list(TRANSFORM ARG_DEFINES PREPEND -D)
  list(TRANSFORM ARG_INCLUDES PREPEND -I)
  cmake_path(ABSOLUTE_PATH source)
  file(MAKE_DIRECTORY ${CMAKE_CURRENT_BINARY_DIR}/shaders)
  add_custom_command(OUTPUT ${out} VERBATIM
    COMMAND ${REDRIVE_GLSLANG} --quiet -V --target-env vulkan1.2 ${ARG_DEFINES} ${ARG_INCLUDES}
      --depfile ${out}.d -o ${out} ${source}
    COMMAND ${REDRIVE_SPIRV_OPT} -O --strip-debug ${out} -o ${out}
    COMMAND ${REDRIVE_SPIRV_VAL} --target-env vulkan1.2 ${out}
    DEPENDS ${source} ${ARG_DEPENDS} DEPFILE ${out}.d COMMENT "Compiling the shader ${name}")
  set_property(DIRECTORY APPEND PROPERTY redrive_shaders_${library} ${out})
endfunction()

# Makes the library of all shaders that were added to it: kernels/gaussian/vulkan/shaders.h.
function(redrive_shader_library library)
  get_property(files DIRECTORY PROPERTY redrive_shaders_${library})
  set(out ${CMAKE_CURRENT_BINARY_DIR}/${library}.cc)
  add_custom_command(OUTPUT ${out} VERBATIM
    COMMAND ${CMAKE_COMMAND} -D OUTPUT=${out} "-D FILES=${files}"
      -P ${CMAKE_SOURCE_DIR}/cmake/embed_shaders.cmake
    DEPENDS ${files} ${CMAKE_SOURCE_DIR}/cmake/embed_shaders.cmake
    COMMENT "Embedding the shaders of ${library}")
  add_library(redrive_${library} OBJECT ${out})
  target_include_directories(redrive_${library} PRIVATE ${CMAKE_SOURCE_DIR}/src)
endfunction()

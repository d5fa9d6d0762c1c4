# SPDX-License-Identifier: Apache-2.0
# Bundles the pages of `redrive view` and `redrive export --to html` (src/redrive/view/page) and
# compresses their files:
#   cmake -D NODE=... -D NPM=... -D SOURCE=... -D OUTPUT=... -D TESTS=ON|OFF -P view_page.cmake
# npm installs what package-lock.json names into OUTPUT/node_modules, with TESTS also what the tests
# of the page need. Where that is not possible, the files are empty, OUTPUT/missing says why, and
# the build goes on.
file(MAKE_DIRECTORY ${OUTPUT})
file(REMOVE ${OUTPUT}/missing)

function(leave_out why)
  message("viewer: left out, ${why}")
  file(WRITE ${OUTPUT}/missing "${why}\n")
  foreach(file index.html viewer.js viewer.css scene.html scene.js)
    file(WRITE ${OUTPUT}/${file}.gz "")
  endforeach()
endfunction()

if(NOT NODE OR NOT NPM)
  leave_out("there is no node or no npm (scripts/setup installs them)")
  return()
endif()
file(SHA256 ${SOURCE}/package-lock.json lock)
set(installed "")
if(EXISTS ${OUTPUT}/node_modules/.installed)
  file(READ ${OUTPUT}/node_modules/.installed installed)
endif()
if(NOT installed STREQUAL "${lock} ${TESTS}")
  file(COPY ${SOURCE}/package.json ${SOURCE}/package-lock.json ${SOURCE}/.npmrc
    DESTINATION ${OUTPUT})
  set(omit "")
  if(NOT TESTS)
    set(omit --omit=dev)
  endif()
  execute_process(WORKING_DIRECTORY ${OUTPUT} RESULT_VARIABLE failed
    COMMAND ${NPM} ci --ignore-scripts ${omit}
    OUTPUT_FILE ${OUTPUT}/npm.log ERROR_FILE ${OUTPUT}/npm.log)
  if(failed)
    leave_out("npm could not install its packages, see ${OUTPUT}/npm.log")
    return()
  endif()
  file(WRITE ${OUTPUT}/node_modules/.installed "${lock} ${TESTS}")
endif()

# NODE_PATH: packages are where they are built, not beside the source.
foreach(name viewer scene)
  execute_process(RESULT_VARIABLE failed ERROR_VARIABLE why
    COMMAND ${CMAKE_COMMAND} -E env NODE_PATH=${OUTPUT}/node_modules
      ${NODE} ${OUTPUT}/node_modules/esbuild/bin/esbuild ${SOURCE}/${name}.ts --bundle --minify
      --format=iife --target=es2022 --log-level=warning --outfile=${OUTPUT}/${name}.js)
  if(failed)
    message(FATAL_ERROR "viewer: ${why}")
  endif()
endforeach()
file(COPY ${SOURCE}/index.html ${SOURCE}/viewer.css ${SOURCE}/scene.html DESTINATION ${OUTPUT})
foreach(file index.html viewer.js viewer.css scene.html scene.js)
  execute_process(COMMAND gzip -9nc ${OUTPUT}/${file} OUTPUT_FILE ${OUTPUT}/${file}.gz
    COMMAND_ERROR_IS_FATAL ANY)
endforeach()

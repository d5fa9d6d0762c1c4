// SPDX-License-Identifier: Apache-2.0
// The page's files, embedded in the program when it is built.
#pragma once

#include <span>
#include <string_view>

#include "redrive/view/server/server.h"

namespace redrive::view {

/// Returns the files; none where the build had no node or npm, or could not install what
/// src/redrive/view/page/package-lock.json names.
std::span<const PageFile> page_files();

/// The files of scene_page.h, compressed by gzip; empty where page_files() is.
struct ScenePageFiles {
  std::string_view html_gz, script_gz;
};
ScenePageFiles scene_page_files();

}  // namespace redrive::view

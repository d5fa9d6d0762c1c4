// SPDX-License-Identifier: Apache-2.0
// The page's files, embedded in the program when it is built.
#pragma once

#include <span>

#include "redrive/view/server.h"

namespace redrive::view {

/// Returns the files; none where the build had no node or npm, or could not install what
/// src/redrive/view/page/package-lock.json names.
std::span<const PageFile> page_files();

}  // namespace redrive::view

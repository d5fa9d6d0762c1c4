// SPDX-License-Identifier: Apache-2.0
// Libraries that are built with the program and loaded by what needs them, so that the rest runs
// without what they link.
#pragma once

#include <string>

namespace redrive {

/// Loads a library from the program's folder, as built, or from where it is installed, with flags
/// of dlopen. Returns null where there is none, or, with the reason in `why`, where it cannot be
/// loaded.
void* load_own_library(const char* name, int flags, std::string* why);

}  // namespace redrive

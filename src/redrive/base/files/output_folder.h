// SPDX-License-Identifier: Apache-2.0
// Writes a folder that an option names, whole or not at all.
#pragma once

#include <filesystem>
#include <functional>

namespace redrive {

/// Throws UsageError naming `option` if `folder` exists, unless `force` allows to replace it and
/// write_output_folder made it: no other folder is ever removed.
void check_output_folder(const char* option, const std::filesystem::path& folder, bool force);

/// Checks the folder as above, writes it by `fill` (write_folder in base/files/unfinished.h) and
/// marks it as made here.
void write_output_folder(const char* option, const std::filesystem::path& folder, bool force,
                         const std::function<void(const std::filesystem::path&)>& fill);

}  // namespace redrive

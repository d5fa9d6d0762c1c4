// SPDX-License-Identifier: Apache-2.0
// A folder that is written whole or not at all.
#pragma once

#include <filesystem>
#include <functional>

namespace redrive {

/// Throws UsageError naming `option` if `folder` exists, unless `force` allows to replace it and
/// write_output_folder made it: no other folder is ever removed.
void check_output_folder(const char* option, const std::filesystem::path& folder, bool force);

/// Makes the folder beside its final place, calls `fill` with it, marks it as made here, and moves
/// it there. An existing one, which check_output_folder allowed, is removed then. If anything
/// throws, everything is as before. IoError.
void write_output_folder(const std::filesystem::path& folder,
                         const std::function<void(const std::filesystem::path&)>& fill);

}  // namespace redrive

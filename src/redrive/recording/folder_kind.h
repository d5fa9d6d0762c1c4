// SPDX-License-Identifier: Apache-2.0
// Describes a folder, for messages about a recording that is given as a run, the other way round,
// or one folder too high or too deep.
#pragma once

#include <filesystem>
#include <string>

namespace redrive {

/// Returns the format of the recording that the folder looks like (recording/registry.cc); empty:
/// none.
std::string recording_format(const std::filesystem::path& folder);

enum class FolderKind {
  kUnknown,
  kRecording,
  kRun,   ///< that redrive train made
  kPoses  ///< that redrive align wrote
};
FolderKind kind_of_folder(const std::filesystem::path& folder);

/// Describes a folder without its name: "a recording (kitti)". Empty for an unknown one.
std::string describe_folder(const std::filesystem::path& folder);

/// Returns "did you mean A (a recording (kitti)), ...?" with folders above the path, or else below
/// it or beside a missing one, each up to two levels away. Empty if there is none.
std::string did_you_mean(const std::filesystem::path& path);

}  // namespace redrive

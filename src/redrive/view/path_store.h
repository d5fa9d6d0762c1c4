// SPDX-License-Identifier: Apache-2.0
// Camera paths that pages save in RUN/paths: the only files that the viewer writes.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include "redrive/render/camera_path.h"
#include "redrive/train/run.h"
#include "redrive/view/server/messages.h"

namespace redrive::view {

class PathStore {
 public:
  explicit PathStore(const Run& run) : run_(run) {}  ///< `run` must outlive it

  /// Returns the names of the saved paths, sorted; the first 1000.
  std::vector<std::string> names() const;

  /// Returns the poses of keyframes. InputError where the run has no such camera or frame.
  std::vector<PathKey> keys(const std::vector<PathKeyframe>& keyframes) const;

  /// Writes RUN/paths/NAME.json, whole or not at all: the keyframes, and the part of nerfstudio's
  /// layout that other programs read (edit/camera_path_file.h). InputError where it exists and
  /// must not be overwritten, has more than 20000 images, or would be the 101st; IoError.
  void save(const PathMessage& path) const;

  /// Returns {"fps", "keyframes"} of a saved path. InputError where there is none, or none with
  /// keyframes.
  nlohmann::json load(const std::string& name) const;

 private:
  std::filesystem::path folder() const { return run_.paths.root / "paths"; }
  std::filesystem::path file(const std::string& name) const;

  const Run& run_;
};

}  // namespace redrive::view

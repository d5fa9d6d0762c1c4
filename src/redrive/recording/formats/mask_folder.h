// SPDX-License-Identifier: Apache-2.0
// Masks of photographs in the folder `masks` or `mask` beside their images: black is masked.
#pragma once

#include <filesystem>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "redrive/recording/core/recording.h"

namespace redrive {

class MaskFolder {
 public:
  explicit MaskFolder(const std::filesystem::path& root);

  /// Returns the mask of an image by its name, relative to the folder of the images: for a/1.jpg
  /// the first of a/1.jpg.png, as COLMAP asks for, then a/1.png, a/1.jpg, a/1_mask.png and
  /// a/1.mask.png, in any case.
  MaskFile find(const std::string& image);

  /// Notes that a file is used as the mask of an image found by other means.
  void use(const std::filesystem::path& file);

  /// A finding counts the files that no image has.
  void report_unused(std::vector<Finding>* findings) const;

 private:
  std::filesystem::path folder_;
  std::map<std::string, std::filesystem::path> files_;  ///< key: name, relative and in lower case
  std::set<std::filesystem::path> used_;
};

/// The image files below a folder, relative to it, sorted. None if there is no such folder.
std::vector<std::string> images_below(const std::filesystem::path& folder);

}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/mask_folder.h"

#include <algorithm>
#include <cctype>

#include "redrive/base/files/files.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/frame_files.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;

std::string lower_case(std::string text) {
  std::ranges::transform(text, text.begin(), [](unsigned char c) { return std::tolower(c); });
  return text;
}

}  // namespace

std::vector<std::string> images_below(const fs::path& folder) {
  std::vector<std::string> names;
  std::error_code error;
  fs::recursive_directory_iterator it(folder, error);
  for (const fs::recursive_directory_iterator end; !error && it != end; it.increment(error)) {
    const std::string name = it->path().lexically_relative(folder).string();
    if (has_extension(name, {".jpg", ".jpeg", ".png"})) names.push_back(name);
  }
  std::ranges::sort(names);
  return names;
}

MaskFolder::MaskFolder(const fs::path& root) {
  for (const char* name : {"masks", "mask"})
    if (folder_.empty() && is_folder(root / name)) folder_ = root / name;
  if (folder_.empty()) return;
  for (const std::string& name : images_below(folder_))
    files_.emplace(lower_case(name), (folder_ / name).lexically_normal());
}

MaskFile MaskFolder::find(const std::string& image) {
  if (files_.empty()) return {};
  const fs::path name = lower_case(image);
  const std::string stem = (name.parent_path() / name.stem()).string();
  for (const std::string& base : {name.string(), stem, stem + "_mask", stem + ".mask"})
    for (const char* extension : {".png", ".jpg", ".jpeg"})
      if (const auto found = files_.find(base + extension); found != files_.end()) {
        used_.insert(found->second);
        return {found->second, true};
      }
  return {};
}

void MaskFolder::use(const fs::path& file) { used_.insert(file.lexically_normal()); }

void MaskFolder::report_unused(std::vector<Finding>* findings) const {
  std::vector<std::string> unused;
  for (const auto& [name, path] : files_)
    if (!used_.contains(path)) unused.push_back(name);
  if (!unused.empty())
    findings->push_back({folder_.filename().string(), counted(unused.size(), "file") +
                                                          " not used, as they are named after no " +
                                                          "image: " + first_few(unused)});
}

}  // namespace redrive

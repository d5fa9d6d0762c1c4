// SPDX-License-Identifier: Apache-2.0
#include "redrive/view/run_watch.h"

#include <sys/stat.h>

#include <algorithm>
#include <exception>

#include "redrive/base/error.h"
#include "redrive/render/open_to_render.h"
#include "redrive/train/files/blocks.h"
#include "redrive/train/files/seam_exposure.h"

namespace redrive::view {

RunWatch::RunWatch(const std::filesystem::path& root, std::optional<double> max_damaged)
    : paths_{root},
      max_damaged_(max_damaged),
      opened_(stamp()),
      run_(std::make_shared<const Run>(open_to_render(root, max_damaged))) {}

std::vector<std::filesystem::path> RunWatch::files() const {
  if (!is_divided_run(paths_.root)) return {paths_.checkpoint()};
  std::vector<std::filesystem::path> files{blocks_file(paths_.root), exposure_file(paths_.root)};
  try {
    for (const Block& block : read_blocks(paths_.root))
      files.push_back(RunPaths{block_folder(paths_.root, block)}.checkpoint());
  } catch (const InputError&) {  // opening the run throws it again
  }
  return files;
}

RunWatch::Stamp RunWatch::stamp() const {
  Stamp all;
  for (const std::filesystem::path& file : files()) {
    struct stat status {};
    if (stat(file.c_str(), &status) != 0) continue;
    if (!all) all.emplace();
    auto& [inode, size, written_ns] = *all;
    inode += static_cast<std::uint64_t>(status.st_ino);
    size += static_cast<std::uint64_t>(status.st_size);
    written_ns = std::max<std::int64_t>(
        written_ns, 1000000000ll * status.st_mtim.tv_sec + status.st_mtim.tv_nsec);
  }
  return all;
}

RunNews RunWatch::look() {
  const Stamp now = stamp();
  if (!now) {
    std::error_code error;
    const bool has_folder = std::filesystem::is_directory(paths_.root, error);
    opened_ = std::nullopt;
    problem_ = (has_folder ? paths_.checkpoint() : paths_.root).string() +
               " is gone; the page shows what was loaded";
  } else if (now != opened_) {
    opened_ = now;
    try {
      run_ = std::make_shared<const Run>(open_to_render(paths_.root, max_damaged_));
      problem_.clear();
      return {run_, ""};
    } catch (const std::exception& error) {
      problem_ = std::string("the newer checkpoint cannot be shown: ") + error.what();
    }
  }
  return {nullptr, problem_};
}

}  // namespace redrive::view

// SPDX-License-Identifier: Apache-2.0
#include "redrive/view/run_watch.h"

#include <sys/stat.h>

#include <exception>

namespace redrive::view {

RunWatch::RunWatch(const std::filesystem::path& root)
    : paths_{root}, opened_(stamp()), run_(std::make_shared<const Run>(open_run(root))) {}

RunWatch::Stamp RunWatch::stamp() const {
  struct stat status {};
  if (stat(paths_.checkpoint().c_str(), &status) != 0) return std::nullopt;
  return std::tuple(
      static_cast<std::uint64_t>(status.st_ino), static_cast<std::uint64_t>(status.st_size),
      1000000000ll * status.st_mtim.tv_sec + static_cast<std::int64_t>(status.st_mtim.tv_nsec));
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
      run_ = std::make_shared<const Run>(open_run(paths_.root));
      problem_.clear();
      return {run_, ""};
    } catch (const std::exception& error) {
      problem_ = std::string("the newer checkpoint cannot be shown: ") + error.what();
    }
  }
  return {nullptr, problem_};
}

}  // namespace redrive::view

// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/folder_kind.h"

#include <algorithm>
#include <vector>

#include "redrive/base/error.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/frame_files.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kMaxSearched = 300;  // folders of a level

/// Folders in a folder by name; none if it cannot be listed.
std::vector<fs::path> folders_in(const fs::path& folder) {
  std::vector<fs::path> found;
  std::error_code error;
  fs::directory_iterator it(folder, error);
  for (const fs::directory_iterator end; !error && it != end; it.increment(error))
    if (it->is_directory(error) && it->path().filename().string().front() != '.')
      found.push_back(it->path());
  std::ranges::sort(found);
  if (found.size() > kMaxSearched) found.resize(kMaxSearched);
  return found;
}

std::vector<std::string> named(const std::vector<fs::path>& folders) {
  std::vector<std::string> texts;
  for (const fs::path& folder : folders)
    if (const std::string kind = describe_folder(folder); !kind.empty())
      texts.push_back(folder.string() + ", " + kind);
  return texts;
}

std::string question(const std::vector<std::string>& texts) {
  if (texts.size() == 1) return "did you mean " + texts[0] + "?";
  return "did you mean one of " + first_few(texts) + "?";
}

}  // namespace

FolderKind kind_of_folder(const fs::path& folder) {
  if (is_there(folder / "config.json") &&
      (is_there(folder / "checkpoint.safetensors") || is_there(folder / "blocks.json")))
    return FolderKind::kRun;
  const bool has_poses =
      is_there(folder / "egomotion.json") ||
      (is_there(folder / "sensor/gnssins/egomotion2.json") && !is_there(folder / "sensor/camera"));
  if (has_poses && is_there(folder / "report.html")) return FolderKind::kPoses;
  try {
    return recording_format(folder).empty() ? FolderKind::kUnknown : FolderKind::kRecording;
  } catch (const InputError&) {  // a folder in it cannot be listed
    return FolderKind::kUnknown;
  }
}

std::string describe_folder(const fs::path& folder) {
  switch (kind_of_folder(folder)) {
    case FolderKind::kRun: return "a run of redrive train";
    case FolderKind::kPoses: return "poses that redrive align wrote";
    case FolderKind::kRecording: return "a recording (" + recording_format(folder) + ")";
    case FolderKind::kUnknown: break;
  }
  return "";
}

std::string did_you_mean(const fs::path& path) {
  fs::path whole = fs::absolute(path / "").lexically_normal().parent_path();
  const fs::path above = whole.parent_path();
  for (const fs::path& folder : {above, above.parent_path()})
    if (const auto texts = named({folder}); !texts.empty()) return question(texts);
  std::vector<fs::path> below = folders_in(is_folder(whole) ? whole : above);
  if (const auto texts = named(below); !texts.empty()) return question(texts);
  if (!is_folder(whole)) return "";
  std::vector<std::string> texts;
  for (const fs::path& folder : below)
    for (const std::string& text : named(folders_in(folder))) texts.push_back(text);
  return texts.empty() ? "" : question(texts);
}

}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/frame_files.h"

#include <algorithm>
#include <cctype>
#include <charconv>
#include <set>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/recording/core/wording.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;

/// Returns the id of <prefix><id><extension>, or -1.
std::int64_t frame_id_from_name(const fs::path& path, const std::string& prefix,
                                std::initializer_list<std::string_view> extensions) {
  std::string stem = path.filename().string();
  std::ranges::transform(stem, stem.begin(), [](unsigned char c) { return std::tolower(c); });
  const auto extension = std::ranges::find_if(
      extensions, [&](std::string_view other) { return stem.ends_with(other); });
  if (extension == extensions.end()) return -1;
  stem = path.filename().string().substr(0, stem.size() - extension->size());
  if (!stem.starts_with(prefix)) return -1;
  const char *const begin = stem.data() + prefix.size(), *const end = stem.data() + stem.size();
  if (begin == end || !std::all_of(begin, end, [](unsigned char c) { return std::isdigit(c); }))
    return -1;
  std::int64_t id = -1;
  const auto [last, error] = std::from_chars(begin, end, id);
  return error == std::errc() && last == end ? id : -1;
}

}  // namespace

// Overloads without error_code would report a folder without permission as an internal error.
bool is_there(const fs::path& path) {
  std::error_code error;
  return fs::exists(path, error);
}
bool is_folder(const fs::path& path) {
  std::error_code error;
  return fs::is_directory(path, error);
}

bool lies_outside(const fs::path& file, const fs::path& folder) {
  const auto plain = [](const fs::path& path) { return fs::absolute(path).lexically_normal(); };
  const fs::path within = plain(file).lexically_relative(plain(folder));
  return within.empty() || *within.begin() == "..";
}

std::vector<fs::path> list_folder(const fs::path& folder) {
  std::vector<fs::path> entries;
  std::error_code error;
  if (!fs::exists(folder, error) && !error) return entries;
  fs::directory_iterator it(folder, error);
  for (const fs::directory_iterator end; !error && it != end; it.increment(error)) {
    if (it->path().filename().string().front() != '.') entries.push_back(it->path());
  }
  if (error) throw InputError(folder, "", error.message(), "the folder cannot be listed");
  std::sort(entries.begin(), entries.end());
  return entries;
}

std::vector<FrameFile> list_frame_files(const fs::path& folder, const std::string& prefix,
                                        std::initializer_list<std::string_view> extensions,
                                        const std::string& subject, std::vector<Finding>* findings,
                                        std::initializer_list<std::string_view> besides) {
  std::vector<FrameFile> files;
  std::vector<std::string> unexpected;
  for (const fs::path& path : list_folder(folder)) {
    const std::int64_t id = frame_id_from_name(path, prefix, extensions);
    const std::string name = path.filename().string();
    if (id < 0) {
      if (std::ranges::find(besides, name) == besides.end()) unexpected.push_back(name);
    } else {
      files.push_back({id, path});
    }
  }
  std::sort(files.begin(), files.end(),
            [](const auto& a, const auto& b) { return a.frame_id < b.frame_id; });
  for (std::size_t i = 1; i < files.size(); ++i) {
    if (files[i].frame_id == files[i - 1].frame_id) {
      throw InputError(
          files[i].path, "frame id", std::to_string(files[i].frame_id),
          "a second file of this frame, beside " + files[i - 1].path.filename().string());
    }
  }
  if (!unexpected.empty()) {
    std::string expected = prefix + "<id>";
    for (const std::string_view& extension : extensions) {
      if (&extension != extensions.begin())
        expected += &extension + 1 == extensions.end() ? " or " : ", ";
      expected += extension;
    }
    findings->push_back({subject, counted(unexpected.size(), "file") + " not named " + expected +
                                      " ignored: " + first_few(unexpected)});
  }
  return files;
}

bool has_file_of(const std::vector<FrameFile>& files, std::int64_t frame_id) {
  return std::ranges::binary_search(files, frame_id, {}, &FrameFile::frame_id);
}

std::vector<ImageFile> images_with_poses(std::vector<FrameFile> images, const std::string& camera,
                                         const std::vector<FramePose>& frames,
                                         std::vector<Finding>* findings) {
  if (images.empty()) return {};

  std::set<std::int64_t> posed;
  for (const FramePose& frame : frames) posed.insert(frame.id);
  std::vector<std::int64_t> without_pose;
  std::vector<ImageFile> kept;
  for (FrameFile& image : images) {
    if (posed.contains(image.frame_id)) {
      kept.push_back({std::move(image)});
    } else {
      without_pose.push_back(image.frame_id);
    }
  }
  if (!without_pose.empty()) {
    findings->push_back({camera, counted(without_pose.size(), "image") +
                                     " dropped, the egomotion has no pose for frame " +
                                     first_few(without_pose)});
  }
  return kept;
}

void require_cameras(const Recording& recording) {
  if (!recording.cameras.empty()) return;
  std::string why;
  for (const Finding& finding : recording.findings)
    why += "; " + finding.subject + ": " + finding.what;
  if (!recording.damaged.empty()) why += "; " + recording.damaged.front().why;
  throw InputError(recording.root, "", "",
                   "empty recording: no image of a frame with a pose" + why);
}

void refuse_ground_truth(const std::filesystem::path& root, PoseSource source) {
  if (source == PoseSource::kGroundTruth)
    throw InputError(root, "", "", "this format ships no other, exact poses");
}

void share_files(Recording* recording) {
  const std::vector<FrameFile> files = recording->lidar_files;
  for (std::size_t k = 1; k < recording->lidars.size(); ++k)
    for (const FrameFile& file : files)
      recording->lidar_files.push_back({file.frame_id, file.path, k});
}

}  // namespace redrive

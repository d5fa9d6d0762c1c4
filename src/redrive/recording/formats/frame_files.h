// SPDX-License-Identifier: Apache-2.0
// Lists the files of a drive that has one file for each frame of a sensor, for readers of any
// format.
#pragma once

#include <filesystem>
#include <initializer_list>
#include <string>
#include <string_view>
#include <vector>

#include "redrive/recording/core/recording.h"

namespace redrive {

/// Returns false where nothing exists, and where a folder above cannot be read.
bool is_there(const std::filesystem::path& path);
bool is_folder(const std::filesystem::path& path);

/// Returns the entries of a folder by name, without hidden ones; none if there is no such folder.
/// InputError if it cannot be listed.
std::vector<std::filesystem::path> list_folder(const std::filesystem::path& folder);

/// Returns the files <prefix><id><extension> of a folder by id, one per frame. A finding about
/// `subject` lists files of other names, but `besides`. InputError for two files of one frame.
std::vector<FrameFile> list_frame_files(const std::filesystem::path& folder,
                                        const std::string& prefix,
                                        std::initializer_list<std::string_view> extensions,
                                        const std::string& subject, std::vector<Finding>* findings,
                                        std::initializer_list<std::string_view> besides = {});

/// Whether one of the files, by id, is of the frame.
bool has_file_of(const std::vector<FrameFile>& files, std::int64_t frame_id);

/// Returns a camera's images of frames with a pose. A finding lists the images that are dropped.
std::vector<ImageFile> images_with_poses(std::vector<FrameFile> images, const std::string& camera,
                                         const std::vector<FramePose>& frames,
                                         std::vector<Finding>* findings);

/// Whether the path, without following links, leads out of the folder.
bool lies_outside(const std::filesystem::path& file, const std::filesystem::path& folder);

/// InputError, with the findings, if no camera has an image that can be used.
void require_cameras(const Recording& recording);

/// InputError if exact poses are requested from a format that ships none.
void refuse_ground_truth(const std::filesystem::path& root, PoseSource source);

/// Gives each of the recording's LiDARs the scans of the first: their files have all.
void share_files(Recording* recording);

}  // namespace redrive

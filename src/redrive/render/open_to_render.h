// SPDX-License-Identifier: Apache-2.0
// Opens a run, a divided run (train/files/blocks.h) or a scene bundle
// (export/bundle/scene_bundle.h) for rendering, or a recording in its place.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "redrive/train/run.h"

namespace redrive {

/// Opens a run as open_run, or a divided run as one: with the whole drive's recording and scene and
/// a DividedField (render/divided_field.h), whose blocks are loaded when an image needs them.
/// Blocks in memory have a quarter of what --memory allows together. Where moving objects are
/// drawn, each block is opened once for its corrections of their tracks. The run of a scene bundle
/// is read in place, and mounted (base/files/file_container.h). Errors as open_run; a block that is
/// missing or damaged is an InputError when it is needed.
Run open_to_render(const std::filesystem::path& root, std::optional<double> max_damaged = {});

/// Folder of redrive's run within a scene bundle.
inline constexpr const char* kRunOfBundle = "redrive";
/// Member of a scene bundle that has its sequence_id.
inline constexpr const char* kDataInfo = "data_info.json";
/// Whether the path is a file .usdz.
bool is_scene_bundle(const std::filesystem::path& path);

/// Returns what a run or a scene bundle lacks to be rendered, by the names of its files; nothing:
/// all is there. InputError for a damaged zip.
std::optional<std::string> missing_part(const std::filesystem::path& root);

/// Returns the files that hold a run's field: a scene bundle, or checkpoints, sorted.
std::vector<std::filesystem::path> field_files(const std::filesystem::path& root);

/// Whether the folder is a run rather than a recording.
bool is_run_folder(const std::filesystem::path& folder);

/// What to open in place of a run.
struct WithoutModel {
  std::filesystem::path folder;
  int downscale = 1;
  std::string frames = "",
              poses = "";  ///< recording/core/frame_range.h; a folder of pose files, or ""
  bool outside_files = false;
  double max_damaged = kMostDamagedPercent;
  std::size_t whole = 0;                  ///< DamageCheck::whole
  std::vector<std::string> cameras = {};  ///< empty: all
  PoseSource source = PoseSource::kRecorded;
};

/// Returns a recording, with its poses replaced and without damaged records, as a run without a
/// model, over white where its images are transparent. Throws InputError as open_recording and
/// apply_pose_files, UsageError as make_scene.
Run open_without_model(const WithoutModel& from);

}  // namespace redrive

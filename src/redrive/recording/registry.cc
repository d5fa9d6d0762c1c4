// SPDX-License-Identifier: Apache-2.0
// The registry of recording formats.
#include <algorithm>

#include "redrive/base/error.h"
#include "redrive/base/progress.h"
#include "redrive/recording/core/excerpt.h"
#include "redrive/recording/core/recording.h"
#include "redrive/recording/folder_kind.h"
#include "redrive/recording/formats/aimotive/aimotive.h"
#include "redrive/recording/formats/argoverse2/argoverse2.h"
#include "redrive/recording/formats/kitti/kitti.h"
#include "redrive/recording/formats/kitti360/kitti360.h"
#include "redrive/recording/formats/mapping.h"
#include "redrive/recording/formats/ncore/ncore.h"
#include "redrive/recording/formats/nuscenes/nuscenes.h"
#include "redrive/recording/formats/pandaset/pandaset.h"
#include "redrive/recording/formats/photographs/colmap.h"
#include "redrive/recording/formats/photographs/transforms.h"
#include "redrive/recording/formats/repeated_images.h"
#include "redrive/recording/formats/rosbag/rosbag.h"
#include "redrive/recording/formats/waymo/waymo.h"

namespace redrive {
namespace {

struct Format {
  const char* name;
  const char* looks_for;  ///< listed by the error for an unknown folder
  bool (*looks_like)(const std::filesystem::path& root);
  Recording (*open)(const std::filesystem::path& root, PoseSource source);
  Mapping (*mapping)(const std::filesystem::path& root) = nullptr;  ///< null: none is needed
};

// CONTRIBUTING.md says how to add one.
constexpr Format kFormats[] = {
    {"aimotive", "sensor/calibration, sensor/camera or sensor/gnssins", aimotive::looks_like,
     aimotive::open},
    {"kitti360", "data_2d_raw, or a drive in it", kitti360::looks_like, kitti360::open},
    {"kitti-tracking", "oxts/NNNN.txt, or calib/NNNN.txt with image_02/NNNN",
     kitti::looks_like_tracking, kitti::open_tracking},
    {"kitti", "oxts, velodyne_points or image_00/data to image_03/data", kitti::looks_like,
     kitti::open},
    {"kitti-odometry", "calib.txt or times.txt with velodyne or image_0 to image_3",
     kitti::looks_like_odometry, kitti::open_odometry},
    {"nuscenes", "v1.0-mini, v1.0-trainval or v1.0-test with its tables", nuscenes::looks_like,
     nuscenes::open},
    {"pandaset", "camera with lidar/poses.json or front_camera/poses.json", pandaset::looks_like,
     pandaset::open},
    {"argoverse2", "city_SE3_egovehicle.feather or calibration/egovehicle_SE3_sensor.feather",
     argoverse2::looks_like, argoverse2::open},
    {"ncore", "stores .ncore4.zarr.itar or .ncore4.zarr", ncore::looks_like, ncore::open},
    {"rosbag", "files .mcap or .db3 of ROS 2", rosbag::looks_like, rosbag::open, rosbag::mapping},
    {"waymo", "a segment .tfrecord", waymo::looks_like, waymo::open},
    {"blender", "transforms_train.json", transforms::looks_like_blender, transforms::open_blender},
    {"transforms", "transforms.json", transforms::looks_like, transforms::open},
    {"colmap", "cameras and images, .bin or .txt, in sparse/0, sparse or the folder itself",
     colmap::looks_like, colmap::open},
};

}  // namespace

std::string recording_format(const std::filesystem::path& folder) {
  const auto found = std::ranges::find_if(
      kFormats, [&](const Format& format) { return format.looks_like(folder); });
  return found == std::end(kFormats) ? "" : found->name;
}

std::optional<Mapping> mapping_of(const std::filesystem::path& root) {
  const auto format = std::ranges::find(kFormats, recording_format(root), &Format::name);
  if (format == std::end(kFormats) || !format->mapping) return std::nullopt;
  return format->mapping(root);
}

namespace {

/// Reports why a path is no recording, and which one may have been meant.
[[noreturn]] void refuse_folder(const std::filesystem::path& root) {
  const std::string hint = did_you_mean(root);
  const auto refusal = [&](const std::string& rule) {
    return InputError(root, "", "", rule + (hint.empty() ? "" : "; " + hint));
  };
  std::error_code error;
  if (!std::filesystem::exists(root, error)) throw refusal("no such folder");
  if (!std::filesystem::is_directory(root, error))
    throw refusal("a recording is a folder, this is none");
  const FolderKind kind = kind_of_folder(root);
  if (kind == FolderKind::kRun || kind == FolderKind::kPoses)
    throw InputError(root, "", "",
                     "is no recording but " + describe_folder(root) +
                         (kind == FolderKind::kRun ? ": redrive render, view, eval and figures "
                                                     "take it, train a recording"
                                                   : ": --poses takes it, beside the recording"));
  if (!hint.empty()) throw refusal("not a recording of a known format");
  std::string sought;
  for (const Format& format : kFormats)
    sought += (sought.empty() ? "" : "; ") + std::string(format.name) + ": " + format.looks_for;
  throw refusal("not a recording of a known format; looked for " + sought);
}

}  // namespace

Recording open_recording(const std::filesystem::path& root, PoseSource source, bool outside_files) {
  const Progress progress("reading the recording");
  const std::string name = recording_format(root);
  const auto format = std::ranges::find(kFormats, name, &Format::name);
  if (format == std::end(kFormats) || kind_of_folder(root) != FolderKind::kRecording)
    refuse_folder(root);
  Recording recording = format->open(root, source);
  recording.format = format->name;
  if (!outside_files && !recording.outside_file.empty())
    throw InputError(root, "", recording.outside_file.string(),
                     "lies outside of the recording's folder, which names it; "
                     "--outside-files reads it");
  leave_out_repeated_images(&recording);
  leave_out_empty_frames(&recording);
  report_gaps(&recording);
  return recording;
}

}  // namespace redrive

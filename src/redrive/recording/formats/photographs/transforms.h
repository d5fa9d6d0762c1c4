// SPDX-License-Identifier: Apache-2.0
// Photographs with poses: transforms.json of instant-ngp and nerfstudio, and the original NeRF's
// Blender sets, transforms_train.json beside transforms_test.json (or transforms_val.json). Both
// are one dialect:
//   {"fl_x", "fl_y", "cx", "cy", "w", "h", "k1".., "p1", "p2", "camera_model" or "is_fisheye",
//   "camera_angle_x",
//    "aabb_scale", "scale", "offset", "aabb", "train_filenames", "val_filenames", "test_filenames",
//    "ply_file_path", "frames": [{"file_path", "transform_matrix", "mask_path", and any of the
//    first line, which takes precedence}]}
// - transform_matrix: camera to world, OpenGL camera axes (x right, y up, z backward).
// - cx, cy are relative to the image's corner, where pixel centres are at + 0.5; everywhere else
// coordinates start at the first pixel's centre. The default is the middle of the image.
// - Each image that exists is a frame of the recording. Ids count in file-name order, numbers in
//   names as numbers. The body is at the camera, its x axis along the camera's z.
#pragma once

#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "redrive/recording/core/damaged_text.h"
#include "redrive/recording/core/recording.h"
#include "redrive/recording/formats/image_size.h"

namespace redrive::transforms {

bool looks_like(const std::filesystem::path& root);          ///< transforms.json
bool looks_like_blender(const std::filesystem::path& root);  ///< transforms_train.json

Recording open(const std::filesystem::path& root, PoseSource source);
/// Images of the test (or val) file are held out. aabb_scale is 1 where missing, as in instant-ngp.
Recording open_blender(const std::filesystem::path& root, PoseSource source);

/// An entry of "frames".
struct FrameEntry {
  std::string file;  ///< file_path, normal, with / for \, relative to the folder of the JSON file
  std::string mask;  ///< mask_path, relative as the image's; empty: none; black is masked
  Rigid3d global_from_body;  ///< GlobalFrame::kArbitrary: the file's world
  std::optional<CameraCalibration>
      camera;  ///< without a name; nothing if `size_of` returned nothing
};

struct TransformsFile {
  std::vector<FrameEntry> entries;                           ///< as listed
  std::string points;                                        ///< ply_file_path; empty: none
  std::optional<BoundingCube> bounds;                        ///< if aabb_scale or aabb is present
  std::optional<std::vector<std::string>> train, val, test;  ///< lists of names, if present
};

/// `size_of` returns the size of an image for which neither its entry nor the file has w and h, or
/// nothing if there is no such image. InputError: fields that are missing or of another type,
/// unsupported models and effects (rolling shutter, ftheta, equirectangular, k4 to k6 of OPENCV, p1
/// and p2 of OPENCV_FISHEYE, ...), an image listed twice. Entries whose transform_matrix is none go
/// to `damaged`; without it they are errors.
TransformsFile parse(
    std::string_view text, const std::filesystem::path& file,
    const std::function<std::optional<ImageSize>(const std::string& file_path)>& size_of,
    const DamagedList* damaged = nullptr);

/// Returns instant-ngp's cube in the coordinates of the file. It is 0.5 +- aabb_scale / 2 in the
/// coordinates scale x + offset: center (0.5 - offset) / scale, half side 0.5 aabb_scale / scale.
BoundingCube instant_ngp_cube(double aabb_scale, double scale = 0.33,
                              const Eigen::Vector3d& offset = Eigen::Vector3d::Constant(0.5));

}  // namespace redrive::transforms

// SPDX-License-Identifier: Apache-2.0
// Sets of photographs with poses: transforms.json as instant-ngp and nerfstudio write it, and
// Blender sets, the original NeRF's transforms_train.json beside transforms_test.json
// (transforms_val.json where there is none). One dialect:
//   {"fl_x", "fl_y", "cx", "cy", "w", "h", "k1".., "p1", "p2", "camera_model" or "is_fisheye",
//   "camera_angle_x",
//    "aabb_scale", "scale", "offset", "aabb", "train_filenames", "val_filenames", "test_filenames",
//    "frames": [{"file_path", "transform_matrix", "mask_path", and any of the first line, which
//    then counts}]}
// - transform_matrix: camera to world, camera axes of OpenGL (x right, y up, z backward).
// - cx, cy count from the image's corner, where a pixel's centre is at + 0.5; ours from the first
// pixel's centre. Without them,
//   and for camera_angle_x, the principal point is the image's middle.
// - A frame of the recording is an image that is there; ids count in file-name order, numbers in
// names as numbers. The body stands at the
//   camera, its x axis along the camera's z.
#pragma once

#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "redrive/recording/recording.h"

namespace redrive::transforms {

bool looks_like(const std::filesystem::path& root);          ///< transforms.json
bool looks_like_blender(const std::filesystem::path& root);  ///< transforms_train.json

Recording open(const std::filesystem::path& root, PoseSource source);
/// Images of the test (or val) file are held out. Bounded as instant-ngp bounds what has no
/// aabb_scale: by 1.
Recording open_blender(const std::filesystem::path& root, PoseSource source);

/// One of "frames".
struct Picture {
  std::string
      file;  ///< file_path, normal and with / for \, relative to the folder of the JSON file
  std::string mask;  ///< mask_path likewise, empty if there is none: what is black is left out
  Rigid3d world_from_body;  ///< the world of the file
  std::optional<CameraCalibration>
      camera;  ///< without a name; nothing where `size_of` knew no size
};

struct TransformsFile {
  std::vector<Picture> pictures;                             ///< as listed
  std::optional<BoundingCube> bounds;                        ///< where aabb_scale or aabb is given
  std::optional<std::vector<std::string>> train, val, test;  ///< the lists of names, where given
};

struct ImageSize {
  int width = 0, height = 0;
};

/// `size_of` is asked for the image of a frame that has neither its own nor a common w and h;
/// nothing: there is no image. InputError: what is missing, of another type or no camera; models
/// and effects that are not supported (rolling shutter, ftheta, equirectangular, k4 to k6 of
/// OPENCV, p1 and p2 of OPENCV_FISHEYE, ...); a picture listed twice.
TransformsFile parse(
    std::string_view text, const std::filesystem::path& file,
    const std::function<std::optional<ImageSize>(const std::string& file_path)>& size_of);

/// instant-ngp's cube of 0.5 +- aabb_scale / 2 in the coordinates scale x + offset, here in those
/// of the file: center (0.5 - offset) / scale, half side 0.5 aabb_scale / scale; scale 0.33 and
/// offset 0.5 unless given.
BoundingCube instant_ngp_cube(double aabb_scale, double scale = 0.33,
                              const Eigen::Vector3d& offset = Eigen::Vector3d::Constant(0.5));

}  // namespace redrive::transforms

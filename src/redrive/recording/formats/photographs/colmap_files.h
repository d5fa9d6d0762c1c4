// SPDX-License-Identifier: Apache-2.0
// Files of a COLMAP model, as text and as binary
// (https://colmap.github.io/format.html#sparse-reconstruction). Poses are cam_from_world as a
// quaternion w x y z and a translation; camera axes are x right, y down, z forward.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Core>

#include "redrive/math/rigid3.h"
#include "redrive/recording/formats/photographs/colmap_cameras.h"

namespace redrive::colmap {

/// An entry of images.txt or images.bin. The features of the image are skipped.
struct ImageRecord {
  std::int64_t id = 0;
  Rigid3d camera_from_world;
  std::int64_t camera_id = 0;
  std::string name;              ///< relative to the folder of the images, normal
  double quaternion_length = 1;  ///< in the file; camera_from_world is normalised
  std::string damage;            ///< why the pose is impossible; empty: it is possible
};

/// An entry of points3D.txt or points3D.bin.
struct PointRecord {
  Eigen::Vector3d in_world;  ///< may be not finite
  std::array<std::uint8_t, 3> rgb{};
  std::vector<std::int64_t> images;  ///< images of the track, each once, in its order
};

// Each throws InputError, which names record, field and value: a file that ends early or does not
// end, numbers that are not finite, ids that come twice, camera models that redrive does not have
// (their names are listed), names of images that are empty or lead out of the folder. In text, a
// name may have blanks. Poses with numbers that are not finite, quaternions of a length near 0 and
// positions beyond 1e7 are no errors (ImageRecord::damage).
std::vector<CameraRecord> parse_cameras_text(std::string_view text,
                                             const std::filesystem::path& file);
std::vector<CameraRecord> parse_cameras_binary(std::string_view bytes,
                                               const std::filesystem::path& file);
std::vector<ImageRecord> parse_images_text(std::string_view text,
                                           const std::filesystem::path& file);
std::vector<ImageRecord> parse_images_binary(std::string_view bytes,
                                             const std::filesystem::path& file);
std::vector<PointRecord> parse_points_text(std::string_view text,
                                           const std::filesystem::path& file);
std::vector<PointRecord> parse_points_binary(std::string_view bytes,
                                             const std::filesystem::path& file);

/// The three files of a model.
struct ModelFiles {
  std::string cameras, images, points;
};
// Return the files that the parsers above read back, poses to rounding. Images have no features, so
// tracks name feature 0, and errors of points are -1, COLMAP's word for unknown.
ModelFiles make_text(const std::vector<CameraRecord>& cameras,
                     const std::vector<ImageRecord>& images,
                     const std::vector<PointRecord>& points);
ModelFiles make_binary(const std::vector<CameraRecord>& cameras,
                       const std::vector<ImageRecord>& images,
                       const std::vector<PointRecord>& points);

}  // namespace redrive::colmap

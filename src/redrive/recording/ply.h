// SPDX-License-Identifier: Apache-2.0
// Point clouds: PLY 1.0 (G. Turk, "The PLY Polygon File Format", 1994), ascii or
// binary_little_endian. Of the element `vertex` the properties x, y and z are read, float or
// double; other scalar properties and later elements are passed over. A recording's points.ply
// holds its static world, metres, in the body axes of the first frame, which is the world of the
// scene. Debian packages no PLY reader but assimp's, a mesh loader that repairs what it cannot
// read.
#pragma once

#include <filesystem>
#include <string_view>
#include <vector>

#include <Eigen/Core>

namespace redrive {

/// |coordinate| <= 1e6 m. InputError for anything else than the above, and for a file that ends too
/// early, has more than 1e8 points, or coordinates that are not finite.
std::vector<Eigen::Vector3d> parse_ply(std::string_view bytes, const std::filesystem::path& file);
std::vector<Eigen::Vector3d> read_ply(const std::filesystem::path& file);

}  // namespace redrive

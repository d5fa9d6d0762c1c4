// SPDX-License-Identifier: Apache-2.0
// Point clouds from PLY 1.0 (G. Turk, "The PLY Polygon File Format", 1994), ascii or binary of
// either byte order. Reads the properties x, y and z of the element `vertex`, float or double, and
// skips other scalar properties and other elements. A recording's points.ply holds its static
// world in metres, in the body axes of the first frame, which are the scene's world axes. Debian's
// only PLY reader is assimp's, a mesh loader that repairs damaged files instead of rejecting them.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Core>

namespace redrive {

/// Returns the points, |coordinate| <= 1e7 in the file's unit. Others, such as the NaN of organised
/// clouds, are dropped and counted in `left_out`. InputError for other versions and formats,
/// truncated files, more than 1e8 points, and files without a usable point.
std::vector<Eigen::Vector3d> parse_ply(std::string_view bytes, const std::filesystem::path& file,
                                       std::size_t* left_out = nullptr);
std::vector<Eigen::Vector3d> read_ply(const std::filesystem::path& file,
                                      std::size_t* left_out = nullptr);

struct PlyPoint {
  Eigen::Vector3f position, normal;
  std::array<std::uint8_t, 3> rgb{};
};
using Triangle = std::array<std::uint32_t, 3>;  ///< indices of vertices
/// Returns a binary_little_endian PLY with x y z, nx ny nz if `normals`, and red green blue; with
/// `triangles`, which may be empty, it has faces, too. Positions are floats; with an `origin` that
/// is not 0, which is added to each, they are doubles.
std::string make_ply(std::span<const PlyPoint> points, bool normals,
                     std::span<const Triangle> triangles = {},
                     const Eigen::Vector3d& origin = Eigen::Vector3d::Zero());

}  // namespace redrive

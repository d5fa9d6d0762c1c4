// SPDX-License-Identifier: Apache-2.0
// A truncated signed distance function (TSDF) of the surfaces that depth images show: Curless and
// Levoy, "A Volumetric Method for Building Complex Models from Range Images", SIGGRAPH 1996. Only
// blocks near a surface are stored.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <unordered_map>
#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/export/depth_image.h"

namespace redrive {

/// Sample points of the volume are integers; their places in the world are voxel_m times these.
using VoxelIndex = Eigen::Vector3i;

/// 8 x 8 x 8 sample points. Numbers of a point outside every image are 0.
struct TsdfBlock {
  static constexpr int kSide = 8, kPoints = kSide * kSide * kSide;

  VoxelIndex first;                                 ///< its lowest point, a multiple of 8
  std::array<float, kPoints> distance_m{};          ///< positive in front of a surface
  std::array<float, kPoints> weight{};              ///< 0: unknown
  std::array<std::array<float, 3>, kPoints> rgb{};  ///< in [0, 255]
  std::array<float, kPoints> rgb_weight{};          ///< 0: no colour

  /// Returns the offset of a point, 0 <= x, y, z < 8: z changes fastest.
  static int offset(int x, int y, int z) { return (x * kSide + y) * kSide + z; }
};

class TsdfVolume {
 public:
  /// Surfaces bend and are noisy by some voxels; 4 leave room for both.
  static constexpr double kTruncationVoxels = 4;

  /// `voxel_m` > 0. Blocks take at most `most_bytes`, including the extracted mesh.
  TsdfVolume(double voxel_m, std::uint64_t most_bytes);

  double voxel_m() const { return voxel_m_; }
  double truncation_m() const { return kTruncationVoxels * voxel_m_; }
  const std::vector<std::unique_ptr<TsdfBlock>>& blocks() const { return blocks_; }

  /// A sample point; null if its block is not stored.
  struct Point {
    TsdfBlock* block;
    int offset;
    explicit operator bool() const { return block != nullptr; }
    float distance_m() const { return block->distance_m[offset]; }
    bool known() const { return block && block->weight[offset] > 0; }
  };
  Point find(const VoxelIndex& index) const;
  /// Stores the point's block if it is not. Throws UsageError naming --voxel if memory is short.
  Point add(const VoxelIndex& index);

  /// Adds images: stores the blocks within the truncation of their surfaces up to `range_m` from
  /// the camera, then averages at each point the distance to the plane of the pixel that sees it,
  /// with weight (cosine of the angle of incidence) / (distance to the camera)^2, which falls to 0
  /// behind the surface. Points further behind it than the truncation are hidden. Results do not
  /// depend on the number of threads. UsageError as add().
  void fuse(std::span<const DepthImage> images, double range_m, ThreadPool& pool);

 private:
  double voxel_m_;
  std::size_t most_blocks_;
  std::vector<std::unique_ptr<TsdfBlock>> blocks_;
  std::unordered_map<std::uint64_t, TsdfBlock*> of_key_;
};

}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
// Chooses the blocks of a divided run (train/files/blocks.h) that render a camera, by its position
// along the way.
#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include <Eigen/Core>

namespace redrive {

/// Around the border of two cores both blocks render over this length of the way; less where a core
/// is shorter than twice that.
constexpr double kSeam_m = 6;

struct BlockWeight {
  int block = 0;
  double weight = 1;  ///< 0..1
};

/// The driven way, cut into the cores of blocks.
class BlockWay {
 public:
  /// A point of the way.
  struct Place {
    std::size_t frame = 0;  ///< nearest one
    double along_m = 0;     ///< position of the nearest point along the way, from the first frame
  };

  /// positions: the frames' in the drive's world, in their order, at least one; last_core: for each
  /// block the index of the last frame of its core, ascending; the last block ends with the last
  /// frame. A border is half way between the frames of two cores.
  BlockWay(std::span<const Eigen::Vector3d> positions, std::span<const std::size_t> last_core);

  int blocks() const { return static_cast<int>(last_core_.size()); }

  /// Returns the place nearest to a point of the world: on the nearest frame's two pieces of the
  /// way. So where the way passes twice, the pass whose frame is nearer counts.
  Place place(const Eigen::Vector3d& in_world) const;

  int block_of_frame(std::size_t frame) const;
  /// Returns the block whose core holds the place.
  int block_at(const Place& place) const;
  /// Returns one block, or the two at a border near by. Weights add up to 1 and change along the
  /// way with a continuous derivative: 3 u^2 - 2 u^3 with u the fraction of the seam.
  std::vector<BlockWeight> weights(const Place& place) const;

  double start_m(int block) const { return block == 0 ? 0 : borders_m_[block - 1]; }
  double end_m(int block) const {
    return block + 1 == blocks() ? along_m_.back() : borders_m_[block];
  }

 private:
  static constexpr std::size_t kChunk = 32;  ///< frames that a search skips together
  struct Chunk {
    Eigen::Vector3d centre;
    double radius_m;
  };

  std::vector<Eigen::Vector3d> positions_;
  std::vector<double> along_m_;  ///< one per frame
  std::vector<std::size_t> last_core_;
  std::vector<double> borders_m_;  ///< between blocks i and i + 1
  std::vector<Chunk> chunks_;
};

}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
#include "redrive/render/block_way.h"

#include <algorithm>
#include <limits>

#include "redrive/base/error.h"

namespace redrive {

BlockWay::BlockWay(std::span<const Eigen::Vector3d> positions,
                   std::span<const std::size_t> last_core)
    : positions_(positions.begin(), positions.end()),
      last_core_(last_core.begin(), last_core.end()) {
  REDRIVE_CHECK(!positions_.empty() && !last_core_.empty());
  REDRIVE_CHECK_OP(last_core_.back() + 1, ==, positions_.size());
  along_m_.push_back(0);
  for (std::size_t i = 1; i < positions_.size(); ++i)
    along_m_.push_back(along_m_.back() + (positions_[i] - positions_[i - 1]).norm());
  for (std::size_t b = 0; b + 1 < last_core_.size(); ++b) {
    REDRIVE_CHECK_OP(last_core_[b], <, last_core_[b + 1]);
    borders_m_.push_back((along_m_[last_core_[b]] + along_m_[last_core_[b] + 1]) / 2);
  }
  for (std::size_t first = 0; first < positions_.size(); first += kChunk) {
    const std::span<const Eigen::Vector3d> part =
        std::span(positions_).subspan(first, std::min(kChunk, positions_.size() - first));
    Chunk chunk{part[part.size() / 2], 0};
    for (const Eigen::Vector3d& at : part)
      chunk.radius_m = std::max(chunk.radius_m, (at - chunk.centre).norm());
    chunks_.push_back(chunk);
  }
}

BlockWay::Place BlockWay::place(const Eigen::Vector3d& in_world) const {
  Place place;
  double nearest_m = std::numeric_limits<double>::infinity();
  for (std::size_t c = 0; c < chunks_.size(); ++c) {
    if ((in_world - chunks_[c].centre).norm() - chunks_[c].radius_m >= nearest_m) continue;
    const std::size_t end = std::min((c + 1) * kChunk, positions_.size());
    for (std::size_t i = c * kChunk; i < end; ++i)
      if (const double distance_m = (in_world - positions_[i]).norm(); distance_m < nearest_m) {
        nearest_m = distance_m;
        place.frame = i;
      }
  }
  place.along_m = along_m_[place.frame];
  for (const std::size_t end : {place.frame, place.frame + 1}) {  // the pieces before and after it
    if (end == 0 || end == positions_.size()) continue;
    const Eigen::Vector3d piece = positions_[end] - positions_[end - 1];
    const double length2 = piece.squaredNorm();
    if (length2 == 0) continue;
    const double part = std::clamp((in_world - positions_[end - 1]).dot(piece) / length2, 0.0, 1.0);
    const double distance_m = (in_world - positions_[end - 1] - part * piece).norm();
    if (distance_m < nearest_m) {
      nearest_m = distance_m;
      place.along_m = along_m_[end - 1] + part * (along_m_[end] - along_m_[end - 1]);
    }
  }
  return place;
}

int BlockWay::block_of_frame(std::size_t frame) const {
  return static_cast<int>(std::ranges::lower_bound(last_core_, frame) - last_core_.begin());
}

int BlockWay::block_at(const Place& place) const {
  return static_cast<int>(std::ranges::upper_bound(borders_m_, place.along_m) - borders_m_.begin());
}

std::vector<BlockWeight> BlockWay::weights(const Place& place) const {
  const int block = block_at(place);
  for (const int border : {block - 1, block}) {
    if (border < 0 || border + 1 >= blocks()) continue;
    const double shortest_m =
        std::min(end_m(border) - start_m(border), end_m(border + 1) - start_m(border + 1));
    const double seam_m = std::min(kSeam_m, shortest_m / 2);
    const double u = seam_m > 0 ? (place.along_m - borders_m_[border]) / seam_m + 0.5 : -1;
    if (u <= 0 || u >= 1) continue;
    const double after = u * u * (3 - 2 * u);
    return {{border, 1 - after}, {border + 1, after}};
  }
  return {{block, 1}};
}

}  // namespace redrive

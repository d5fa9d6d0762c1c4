// SPDX-License-Identifier: Apache-2.0
// Scores how well edges of LiDAR depth lie on edges of the images: a check of extrinsics, poses and
// time offsets together that needs neither tracks nor ground truth. Where the LiDAR steps from a
// near surface to a far one, the image usually has an edge, too.
#pragma once

#include <optional>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "redrive/align/lidar/contrast.h"
#include "redrive/align/rig/rig_model.h"
#include "redrive/base/opencv_threads.h"
#include "redrive/base/parallel.h"

namespace redrive {

/// A step of depth between two returns of one revolution that are neighbours in the image.
struct DepthEdge {
  Eigen::Vector2d near_px, far_px;
};

/// A return in an image.
struct ProjectedReturn {
  Eigen::Vector2d pixel;
  double distance_m = 0;
};

/// Steps between returns that are neighbours in a row or column of cells of 2 pixels, at most 6
/// pixels apart, to a distance that is larger by a third and 1 m: the road between two scan lines
/// does not step as far. On both sides the next return has to continue the surface, which leaves
/// out leaves and fences.
std::vector<DepthEdge> find_depth_edges(const std::vector<ProjectedReturn>& returns,
                                        const cv::Size& image);

/// How much an image changes across depth edges and across parallels up to 10 pixels beside them.
struct EdgeScore {
  int edges = 0;
  double on_edges = 0, beside = 0;  ///< sums over edges; of the parallels' mean
  /// 0 to 1: 1 if the image changes only at depth edges, 0.5 if image and depth are unrelated.
  double score() const {
    const double all = on_edges + beside;
    return all > 0 ? on_edges / all : 0.5;
  }
};

/// `grey`: 8 bits; `usable`: same size, 0 where pixels do not count. `shift`: shift of all edges,
/// pixels, to see where they would lie better.
EdgeScore score_depth_edges(const cv::Mat& grey, const cv::Mat& usable,
                            const std::vector<DepthEdge>& edges,
                            const Eigen::Vector2d& shift = Eigen::Vector2d::Zero());

/// Returns the score of each camera over at most 16 of its images, downscaled to at most 640 pixels
/// of width, with the returns within 50 ms of each. Nothing where there are less than 200 edges:
/// the LiDAR is too sparse.
std::vector<std::optional<EdgeScore>> depth_edge_scores(const RigModel& model,
                                                        const ContrastData& source,
                                                        ThreadPool& pool);

}  // namespace redrive

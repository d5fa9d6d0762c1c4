// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/lidar/depth_edges.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include <opencv2/imgproc.hpp>

#include "redrive/base/opencv_threads.h"

namespace redrive {
namespace {

constexpr int kImagesScored = 16;  // images of a camera, at most
constexpr int kMaxWidth = 640;
constexpr std::int64_t kAround_ns = 50'000'000;  // half a revolution at 10 Hz
constexpr double kClosestEdge_m = 2, kFarthestEdge_m = 60;
constexpr int kEdgeCell_px = 2;
constexpr int kMaxCells = 3;  // between the two returns of an edge
constexpr double kMinRatio = 4.0 / 3, kMinStep_m = 1;
// largest step between neighbouring returns of one surface, as a part of the distance
constexpr double kSameSurface = 0.08;
constexpr double kSmooth_px = 1;                          // sd of the filter before gradients
constexpr std::array<double, 4> kBeside_px{4, 6, 8, 10};  // from an edge to its parallels
constexpr double kStep_px = 0.5;
constexpr int kMinParallels = 4;
constexpr int kMinEdges = 200;

/// Gradient of the smoothed image.
struct Gradient {
  cv::Mat_<float> dx, dy;
  explicit Gradient(const cv::Mat& grey) {
    cv::Mat smooth;
    grey.convertTo(smooth, CV_32F);
    cv::GaussianBlur(smooth, smooth, {}, kSmooth_px);
    cv::Sobel(smooth, dx, CV_32F, 1, 0, 1, 0.5);
    cv::Sobel(smooth, dy, CV_32F, 0, 1, 1, 0.5);
  }
  /// Returns the largest slope along `direction` between two pixels; nothing where that leaves the
  /// usable area.
  std::optional<double> strongest(const cv::Mat& usable, const Eigen::Vector2d& from,
                                  const Eigen::Vector2d& direction, double length_px) const {
    double most = 0;
    for (double at = 0; at <= length_px; at += kStep_px) {
      const Eigen::Vector2d pixel = from + at * direction;
      const auto x = static_cast<int>(std::lround(pixel.x())),
                 y = static_cast<int>(std::lround(pixel.y()));
      if (x < 0 || y < 0 || x >= usable.cols || y >= usable.rows ||
          usable.at<std::uint8_t>(y, x) == 0)
        return std::nullopt;
      most = std::max(most, std::abs(dx(y, x) * direction.x() + dy(y, x) * direction.y()));
    }
    return most;
  }
};

/// The nearest return of each cell of kEdgeCell_px, by index; -1 where there is none.
cv::Mat_<int> nearest_by_cell(const std::vector<ProjectedReturn>& returns, const cv::Size& image) {
  cv::Mat_<int> cells((image.height + kEdgeCell_px - 1) / kEdgeCell_px,
                      (image.width + kEdgeCell_px - 1) / kEdgeCell_px, -1);
  for (std::size_t i = 0; i < returns.size(); ++i) {
    const auto x = static_cast<int>(std::floor((returns[i].pixel.x() + 0.5) / kEdgeCell_px)),
               y = static_cast<int>(std::floor((returns[i].pixel.y() + 0.5) / kEdgeCell_px));
    if (x < 0 || y < 0 || x >= cells.cols || y >= cells.rows) continue;
    int& cell = cells(y, x);
    if (cell < 0 || returns[i].distance_m < returns[cell].distance_m) cell = static_cast<int>(i);
  }
  return cells;
}

/// Static returns within kAround_ns of an image.
std::vector<ProjectedReturn> project(const RigModel& model, const RigImages& images,
                                     const std::vector<LidarSample>& samples,
                                     const std::vector<Eigen::Vector3f>& in_world, int camera,
                                     int frame) {
  const std::int64_t t_ns =
      model.initial_frames[frame].t_ns + std::llround(1e9 * model.cameras[camera].offset_s);
  const Rigid3d camera_from_world = model.world_from_camera(camera, frame).inverse(Eigen::Isometry);
  const Camera lens = model.camera(camera).downscaled(images.factor[camera]);
  const auto moving = images.moving_at(camera, frame);
  std::vector<ProjectedReturn> returns;
  for (std::size_t i = 0; i < samples.size(); ++i) {
    if (std::abs(samples[i].t_ns - t_ns) > kAround_ns) continue;
    const Eigen::Vector3d in_camera = camera_from_world * in_world[i].cast<double>();
    const double distance_m = in_camera.norm();
    if (!(distance_m >= kClosestEdge_m && distance_m <= kFarthestEdge_m)) continue;
    const auto pixel = lens.project(in_camera);
    if (pixel && images.may_be_static(camera, frame, *pixel, moving))
      returns.push_back({*pixel, distance_m});
  }
  return returns;
}

}  // namespace

std::vector<DepthEdge> find_depth_edges(const std::vector<ProjectedReturn>& returns,
                                        const cv::Size& image) {
  const cv::Mat_<int> cells = nearest_by_cell(returns, image);
  std::vector<DepthEdge> edges;
  std::vector<int> line;  // filled cells of a row or column, -1 at gaps
  const auto find_on_line = [&] {
    for (std::size_t k = 0; k + 3 < line.size(); ++k) {
      std::array<int, 4> four{line[k], line[k + 1], line[k + 2], line[k + 3]};
      if (std::ranges::find(four, -1) != four.end()) continue;
      if (returns[four[1]].distance_m > returns[four[2]].distance_m) std::ranges::reverse(four);
      const ProjectedReturn &near = returns[four[1]], &far = returns[four[2]];
      const auto continues = [&](const ProjectedReturn& a, const ProjectedReturn& b) {
        return std::abs(a.distance_m - b.distance_m) < kSameSurface * a.distance_m;
      };
      if (far.distance_m > kMinRatio * near.distance_m &&
          far.distance_m > near.distance_m + kMinStep_m && continues(near, returns[four[0]]) &&
          continues(far, returns[four[3]]))
        edges.push_back({near.pixel, far.pixel});
    }
    line.clear();
  };
  int empty = 0;
  const auto append = [&](int cell) {
    empty = cell < 0 ? empty + 1 : 0;
    if (cell >= 0 || empty == kMaxCells) line.push_back(cell);
  };
  for (int y = 0; y < cells.rows; ++y) {
    for (int x = 0; x < cells.cols; ++x) append(cells(y, x));
    find_on_line();
  }
  for (int x = 0; x < cells.cols; ++x) {
    for (int y = 0; y < cells.rows; ++y) append(cells(y, x));
    find_on_line();
  }
  return edges;
}

EdgeScore score_depth_edges(const cv::Mat& grey, const cv::Mat& usable,
                            const std::vector<DepthEdge>& edges, const Eigen::Vector2d& shift) {
  const Gradient gradient(grey);
  EdgeScore score;
  for (const DepthEdge& edge : edges) {
    const double length_px = (edge.far_px - edge.near_px).norm();
    const Eigen::Vector2d direction = (edge.far_px - edge.near_px) / length_px,
                          from = edge.near_px + shift;
    const auto own = gradient.strongest(usable, from, direction, length_px);
    if (!own) continue;
    double beside = 0;
    int parallels = 0;
    for (const double beside_px : kBeside_px)
      for (const double side : {-1.0, 1.0}) {
        const auto other = gradient.strongest(
            usable, from + side * (length_px + beside_px) * direction, direction, length_px);
        if (!other) continue;
        ++parallels;
        beside += *other;
      }
    if (parallels < kMinParallels) continue;
    ++score.edges;
    score.on_edges += *own;
    score.beside += beside / parallels;
  }
  return score;
}

std::vector<std::optional<EdgeScore>> depth_edge_scores(const RigModel& model,
                                                        const ContrastData& source,
                                                        ThreadPool& pool) {
  const RigImages images = downscaled_to_width(source.images, kMaxWidth, 0, pool);
  std::vector<Eigen::Vector3f> in_world(source.samples.size());
  transform_samples(model, source.samples, pool, [&](std::size_t i, const Eigen::Vector3d& point) {
    in_world[i] = point.cast<float>();
  });
  std::vector<std::pair<int, int>> jobs;  // camera, frame
  for (int c = 0; c < images.cameras(); ++c) {
    std::vector<int> frames;
    for (int f = 0; f < images.frames(); ++f)
      if (!images.grey[c][f].empty()) frames.push_back(f);
    const int count = static_cast<int>(frames.size()), n = std::min(kImagesScored, count);
    for (int i = 0; i < n; ++i) jobs.emplace_back(c, frames[(2 * i + 1) * count / (2 * n)]);
  }
  std::vector<EdgeScore> of_image(jobs.size());
  pool.run(static_cast<int>(jobs.size()), [&](int j) {
    const auto [c, f] = jobs[j];
    const cv::Mat& grey = images.grey[c][f];
    of_image[j] = score_depth_edges(
        grey, images.usable[c][f],
        find_depth_edges(project(model, images, source.samples, in_world, c, f), grey.size()));
  });
  std::vector<EdgeScore> sums(images.cameras());
  for (std::size_t j = 0; j < jobs.size(); ++j) {
    EdgeScore& sum = sums[jobs[j].first];
    sum.edges += of_image[j].edges;
    sum.on_edges += of_image[j].on_edges;
    sum.beside += of_image[j].beside;
  }
  std::vector<std::optional<EdgeScore>> scores;
  for (const EdgeScore& sum : sums)
    scores.push_back(sum.edges < kMinEdges ? std::nullopt : std::optional(sum));
  return scores;
}

}  // namespace redrive

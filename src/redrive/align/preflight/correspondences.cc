// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/preflight/correspondences.h"

#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>

#include "redrive/base/opencv_threads.h"

namespace redrive {
namespace {

constexpr int kWindow = 17, kLevels = 4;
constexpr double kReturn_px = 0.5;
constexpr double kNearest_m = 0.3, kBelowGround_m = 1;
constexpr double kMinMove_px = 0.25;  // less is dirt, a reflection, or infinitely far
constexpr double kMaxEpipolar_px = 1;
// Least mean square of the gradient in its weaker direction, for 2 grey levels a pixel, in OpenCV's
// unit: its derivatives are 32 times too large, their squares 2^20 times too small.
constexpr double kMinEigenvalue = 2.0 * 2.0 * 32 * 32 / (1 << 20);
constexpr double kQuality = 0.005;  // quality of a corner, relative to the image's best

std::vector<cv::Mat> pyramid_of(const cv::Mat& grey) {
  std::vector<cv::Mat> pyramid;
  cv::buildOpticalFlowPyramid(grey, pyramid, {kWindow, kWindow}, kLevels);
  return pyramid;
}

/// Returns the next image, at most options.max_frames away, after min_driven_m; -1 if there is
/// none.
int partner(const RigImages& images, int camera, int a, const CorrespondenceOptions& options) {
  const auto position = [&](int frame) -> Eigen::Vector3d {
    return images.scene.world_from_body(images.scene.frames[frame].t_ns).translation();
  };
  for (int b = a + 1; b < images.frames() && b <= a + options.max_frames; ++b) {
    if (images.grey[camera][b].empty()) return -1;
    const double path_length_m = (position(b) - position(a)).norm();
    if (path_length_m >= options.min_driven_m || b == a + options.max_frames) return b;
  }
  return -1;
}

/// Tracks points of image a to image b through all images between; lost points lie far outside.
std::vector<cv::Point2f> follow(const RigImages& images, int camera, int a, int b,
                                const std::vector<cv::Point2f>& start) {
  const cv::TermCriteria until(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 30, 0.01);
  std::vector<cv::Point2f> at = start;
  std::vector<cv::Mat> from = pyramid_of(images.grey[camera][a]);
  for (int f = a + 1; f <= b; ++f) {
    std::vector<cv::Mat> to = pyramid_of(images.grey[camera][f]);
    std::vector<cv::Point2f> next, back;
    std::vector<std::uint8_t> there, returned;
    std::vector<float> error;
    cv::calcOpticalFlowPyrLK(from, to, at, next, there, error, {kWindow, kWindow}, kLevels, until,
                             0, kMinEigenvalue);
    cv::calcOpticalFlowPyrLK(to, from, next, back, returned, error, {kWindow, kWindow}, kLevels,
                             until, 0, kMinEigenvalue);
    for (std::size_t i = 0; i < at.size(); ++i)
      if (!there[i] || !returned[i] || !(cv::norm(back[i] - at[i]) < kReturn_px))
        next[i] = {-1e6f, -1e6f};  // lost: outside the image
    at = next;
    from = std::move(to);
  }
  return at;
}

/// Returns the pairs that agree with the relative pose fitted to them, independent of calibration
/// and poses; none where less than half of them do.
std::vector<RayPair> consistent(const std::vector<RayPair>& pairs) {
  std::vector<Rigid3d> starts;
  for (int axis = 0; axis < 3; ++axis)  // an epipolar error has no sign
    starts.push_back(Rigid3d(Eigen::Translation3d(Eigen::Vector3d::Unit(axis))));
  const auto pose = fit_relative_pose(pairs, starts);
  std::vector<RayPair> kept;
  if (!pose) return kept;
  for (const RayPair& pair : pairs)
    if (std::abs(sampson_error_px(pair, *pose)) < kMaxEpipolar_px) kept.push_back(pair);
  if (2 * kept.size() < pairs.size()) kept.clear();
  return kept;
}

}  // namespace

std::vector<Correspondence> find_correspondences(const RigImages& images, int camera,
                                                 const CorrespondenceOptions& options) {
  const auto& frames = images.scene.frames;
  const auto margin_ns = static_cast<std::int64_t>(options.margin_s * 1e9);
  std::vector<std::pair<int, int>> pairs;
  for (int a = 0; a < images.frames(); ++a) {
    if (images.grey[camera][a].empty() || frames[a].t_ns < frames.front().t_ns + margin_ns)
      continue;
    const int b = partner(images, camera, a, options);
    if (b >= 0 && frames[b].t_ns <= frames.back().t_ns - margin_ns) pairs.emplace_back(a, b);
  }
  std::vector<Correspondence> sights;
  const Camera& model = images.camera(camera);
  const int n = std::min(options.pairs, static_cast<int>(pairs.size()));
  for (int i = 0; i < n; ++i) {
    const auto [a, b] = pairs[(2 * i + 1) * pairs.size() / (2 * n)];
    const cv::Mat& grey = images.grey[camera][a];
    std::vector<cv::Point2f> corners;
    const double apart = 0.7 * std::sqrt(double(grey.total()) / options.points_per_image);
    cv::goodFeaturesToTrack(grey, corners, options.points_per_image, kQuality, apart,
                            images.usable[camera][a], 5);
    if (corners.empty()) continue;
    const std::vector<cv::Point2f> found = follow(images, camera, a, b, corners);
    const auto moving_a = images.moving_at(camera, a), moving_b = images.moving_at(camera, b);
    std::vector<RayPair> all;
    for (std::size_t k = 0; k < corners.size(); ++k) {
      const Eigen::Vector2d pixel_a(corners[k].x, corners[k].y), pixel_b(found[k].x, found[k].y);
      if (!images.may_be_static(camera, a, pixel_a, moving_a) ||
          !images.may_be_static(camera, b, pixel_b, moving_b))
        continue;
      if ((pixel_b - pixel_a).norm() < kMinMove_px) continue;
      if (const auto rays = make_ray_pair(model, pixel_a, model, pixel_b)) all.push_back(*rays);
    }
    for (const RayPair& rays : consistent(all)) sights.push_back({a, b, rays});
  }
  return sights;
}

double correspondence_error_px(const RayPair& rays, const PairGeometry& pose) {
  const Eigen::Vector3d far = pose.b_from_a.linear() * rays.ray_a, t = pose.b_from_a.translation();
  // The point at inverse depth w lies along far + w t: the allowed w whose direction is nearest to
  // ray_b.
  const Eigen::Vector3d off = far.cross(rays.ray_b), step = t.cross(rays.ray_b);
  const double down = -rays.ray_a.dot(pose.up_in_a), most = 1 / kNearest_m;
  const double least = std::clamp(down / std::max(0.3, pose.height_m + kBelowGround_m), 0.0, most);
  double w = least;
  if (step.squaredNorm() > 0) w = std::clamp(-off.dot(step) / step.squaredNorm(), least, most);
  const auto error_at = [&](double inverse_depth) {
    const Eigen::Vector3d seen = far + inverse_depth * t;
    return std::atan2(seen.cross(rays.ray_b).norm(), seen.dot(rays.ray_b));
  };
  // Where the nearest point on the line lies opposite to ray_b, an end of the interval is nearer.
  return rays.px_per_rad_b * std::min({error_at(w), error_at(least), error_at(most)});
}

}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
#include "redrive/perception/track_points.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <span>
#include <utility>

#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>

#include "redrive/base/error.h"
#include "redrive/base/opencv_threads.h"
#include "redrive/perception/feature_flow.h"
#include "redrive/perception/nearest_to_rays.h"

namespace redrive {
namespace {

constexpr int kLength = 14;          // images of a track
constexpr int kMinObservations = 4;  // three would not show an outlier along the epipolar line
// images between starts; more where there would be more than kMaxStarts
constexpr int kStartEvery = 2;
constexpr int kMaxStarts = 400;  // about 10 s on two cores
// Every kProbeEvery-th start is tracked first. The others follow where at least kLeastYield of the
// camera's corners have become points, hence not where corners are noise.
constexpr int kProbeEvery = 8;
constexpr double kLeastYield = 0.05;
constexpr int kBatch = kMostTrackImages - kLength;  // images of a batch
constexpr std::size_t kCornersOfTask = 1024;        // few, so that no thread waits long for others
// A larger window takes the depth of things in front of or beside its centre.
constexpr int kWindow_px = 7, kBlock_px = 5, kMargin_px = 4;
constexpr int kMinCell_px = 5, kMaxCells = 20'000;  // one corner a cell
constexpr double kCornerLevels =
    0.57;  // least gradient in a corner's weaker direction, grey levels per pixel
constexpr double kCornerNoises = 1.5;  // least gradient in standard deviations of the noise
constexpr int kMaxPixels = 1'000'000;  // larger images are reduced: they are seldom as sharp
// Where a track starts, the next image is searched from the positions of points so far away that
// the baseline spans these angles (rad). Lucas-Kanade finds corners within some 30 pixels.
constexpr std::array<double, 3> kParallaxes{0, 0.07, 0.18};
constexpr int kLevelsWithPoint = 1;  // pyramid levels searched for a track that has a point
constexpr float kForwardBackward_px = 0.5f;
constexpr double kMaxResidual_px = 1.2, kTracking_px = 0.35;  // error of an observation
constexpr double kMaxRelativeSigma = 0.06;                    // sigma as a part of the distance
// sigma of a distance at which a track ends: it is exact enough
constexpr double kExactSigma = 0.01;

/// Distances from the first camera between which points are kept.
struct DistanceRange {
  double nearest, furthest;
};

DistanceRange distance_range(const Scene& scene) {
  if (scene.metric) return {0.8, 150};
  Eigen::AlignedBox3d box;
  for (const View& view : scene.views)
    if (!view.held_out) box.extend(scene.world_from_camera(view).translation());
  const double extent = box.diagonal().norm();
  return {0.02 * extent, 20 * extent};
}

/// A training image prepared for tracking.
struct TrackImage {
  std::size_t view;
  ShutterPoses world_from_camera;
  ImagePointer image = {};            ///< null where the batch does not need it
  std::vector<cv::Mat> pyramid = {};  ///< pyramid of the reduced image, likewise
};

cv::Mat grey_of(const Image8& image) {
  const cv::Mat rgb(image.height, image.width, CV_8UC3,
                    const_cast<std::uint8_t*>(image.rgb.data()));
  cv::Mat grey;
  cv::cvtColor(rgb, grey, cv::COLOR_RGB2GRAY);
  return grey;
}

/// 255 where no pixel within kMargin_px is masked or transparent.
cv::Mat usable_pixels(const Image8& image, int factor) {
  cv::Mat usable(image.height, image.width, CV_8U, cv::Scalar(255));
  for (std::size_t i = 0; i < usable.total(); ++i)
    if ((!image.used.empty() && (image.used[i] == 0 || image.used[i] == kMovingPixel)) ||
        (!image.alpha.empty() && image.alpha[i] != 255))
      usable.data[i] = 0;
  const int size = 2 * kMargin_px * factor + 1;
  if (!image.used.empty() || !image.alpha.empty())
    cv::erode(usable, usable, cv::Mat::ones(size, size, CV_8U));
  return averaged(usable, factor) == 255;
}

/// Returns the standard deviation of the noise of the usable pixels, grey levels: the median of a
/// Laplacian that is insensitive to ramps and most edges (Immerkaer, CVIU 1996).
double noise_of(const cv::Mat& grey, const cv::Mat& usable) {
  const cv::Mat laplacian = (cv::Mat_<float>(3, 3) << 1, -2, 1, -2, 4, -2, 1, -2, 1);
  cv::Mat filtered;
  cv::filter2D(grey, filtered, CV_32F, laplacian);
  std::vector<float> sizes;
  for (int y = 0; y < grey.rows; ++y)
    for (int x = 0; x < grey.cols; ++x)
      if (usable.at<std::uint8_t>(y, x) != 0) sizes.push_back(std::fabs(filtered.at<float>(y, x)));
  if (sizes.empty()) return 0;
  const auto middle = sizes.begin() + static_cast<std::ptrdiff_t>(sizes.size() / 2);
  std::ranges::nth_element(sizes, middle);
  constexpr double kNormOfTaps = 6, kMedianOfNormal = 0.6745;
  return static_cast<double>(*middle) / (kNormOfTaps * kMedianOfNormal);
}

/// Returns the best corner of each cell that has one.
std::vector<cv::Point2f> find_corners(const cv::Mat& grey, const cv::Mat& usable) {
  const int cell = std::max(
      kMinCell_px, static_cast<int>(std::ceil(std::sqrt(double(grey.total()) / kMaxCells))));
  const double levels = std::max(kCornerLevels, kCornerNoises * noise_of(grey, usable));
  std::vector<cv::Point2f> corners;
  for_each_corner(grey, usable, {cell, kBlock_px, kWindow_px / 2, levels},
                  [&](const cv::Point& at) { corners.emplace_back(at); });
  return corners;
}

/// The rays of one track, in the world.
struct TrackRays {
  int n = 0;
  std::array<WorldRay, kLength> ray;

  NearestToRays nearest() const { return nearest_to_rays(std::span(ray).first(n)); }
};

/// Returns the nearest_to_rays; nothing if it contradicts a ray, is not within the range or has an
/// uncertain distance. rad_per_px: angle of a pixel.
std::optional<Eigen::Vector3d> triangulate_rays(const TrackRays& rays, double rad_per_px,
                                                const DistanceRange& range) {
  if (rays.n < kMinObservations) return std::nullopt;
  const NearestToRays nearest = rays.nearest();
  if (!(nearest.least_eigenvalue > 0) ||
      kTracking_px * rad_per_px > kMaxRelativeSigma * std::sqrt(nearest.least_eigenvalue))
    return std::nullopt;
  const double distance = nearest.from_first.norm();
  if (!(distance > range.nearest && distance < range.furthest)) return std::nullopt;
  const Eigen::Vector3d point = rays.ray[0].origin + nearest.from_first;
  const double max_sine = std::sin(kMaxResidual_px * rad_per_px);
  for (const WorldRay& ray : std::span(rays.ray).first(rays.n)) {
    const Eigen::Vector3d to_point = point - ray.origin;
    if (!(to_point.dot(ray.direction) > 0) ||
        to_point.cross(ray.direction).norm() > max_sine * to_point.norm())
      return std::nullopt;
  }
  return point;
}

/// A track in progress, and its position in the reduced image.
struct ActiveTrack {
  TrackRays* rays;
  cv::Point2f at;
  double rad_per_px;  ///< angle of a pixel of the reduced image where it started

  /// Whether further images would hardly make its point more exact.
  bool is_exact() const {
    return rays->n >= kMinObservations &&
           kTracking_px * rad_per_px < kExactSigma * std::sqrt(rays->nearest().least_eigenvalue);
  }
};

/// The training images of one camera. Points in images are in pixels of the reduced images.
class CameraTracker {
 public:
  CameraTracker(const Scene& scene, int camera)
      : camera_(scene.rig[camera].camera), range_(distance_range(scene)) {
    for (std::size_t i = 0; i < scene.views.size(); ++i)
      if (scene.views[i].camera == camera && !scene.views[i].held_out)
        images_.push_back({i, scene.shutter_poses(scene.views[i])});
    factor_ =
        static_cast<int>(std::ceil(std::sqrt(double(camera_.width) * camera_.height / kMaxPixels)));
    // Levels are added until the smaller side has a few windows: motions of a tenth of the image
    // are found.
    for (int side = std::min(camera_.width, camera_.height) / factor_ / 2; side >= 4 * kWindow_px;
         side /= 2)
      ++levels_;
  }

  int images() const { return static_cast<int>(images_.size()); }

  /// Prepares images [begin, end) for points_from and releases the others.
  void prepare(int begin, int end, const ViewImages& images, ThreadPool& pool) {
    for (int i = 0; i < this->images(); ++i)
      if (i < begin || i >= end) {
        images_[i].image.reset();
        images_[i].pyramid.clear();
      }
    pool.run(end - begin, [&](int k) {
      TrackImage& of = images_[begin + k];
      if (of.image) return;
      of.image = images[of.view];
      cv::buildOpticalFlowPyramid(averaged(grey_of(*of.image), factor_), of.pyramid,
                                  {kWindow_px, kWindow_px}, levels_, /*withDerivatives=*/false);
    });
  }

  /// Returns the images [first, second) that points_from uses.
  std::pair<int, int> used_by(int start, int step) const {
    const int end = std::clamp(start + (kLength - 1) * step, 0, images() - 1);
    return {std::min(start, end), std::max(start, end) + 1};
  }

  std::vector<cv::Point2f> corners_of(int image) const {
    const TrackImage& of = images_[image];
    return find_corners(of.pyramid[0], usable_pixels(*of.image, factor_));
  }

  /// Tracks corners from image `start` on, step 1 or -1, and triangulates.
  std::vector<ColouredPoint> points_from(int start, int step,
                                         std::span<const cv::Point2f> corners) const {
    const Image8& first = *images_[start].image;
    std::vector<TrackRays> tracks(corners.size());
    std::vector<ActiveTrack> active;
    for (std::size_t t = 0; t < corners.size(); ++t)
      if (add_ray(images_[start], corners[t], &tracks[t]))
        active.push_back({&tracks[t], corners[t], factor_ * rad_per_px(full_pixel(corners[t]))});
    for (int k = 1; k < kLength; ++k) {
      const int from = start + (k - 1) * step, to = from + step;
      if (to < 0 || to >= images()) break;
      advance(images_[from], images_[to], &active);
    }
    std::vector<ColouredPoint> points;
    for (std::size_t t = 0; t < tracks.size(); ++t) {
      const Eigen::Vector2d pixel = full_pixel(corners[t]);
      if (const auto point = triangulate_rays(tracks[t], factor_ * rad_per_px(pixel), range_))
        points.push_back({point->cast<float>(),
                          colour_at(first, visible_pixel(first, pixel).value()),
                          tracks[t].ray[0].origin.cast<float>()});
    }
    return points;
  }

 private:
  Eigen::Vector2d full_pixel(const cv::Point2f& at) const {
    return {factor_ * (at.x + 0.5) - 0.5, factor_ * (at.y + 0.5) - 0.5};
  }
  cv::Point2f reduced_pixel(const Eigen::Vector2d& full) const {
    return {static_cast<float>((full.x() + 0.5) / factor_ - 0.5),
            static_cast<float>((full.y() + 0.5) / factor_ - 0.5)};
  }

  /// Adds the ray of an observation to the track; false where the pixel must not be used.
  bool add_ray(const TrackImage& image, const cv::Point2f& at, TrackRays* track) const {
    const Eigen::Vector2d pixel = full_pixel(at);
    if (!static_pixel(*image.image, pixel)) return false;
    const auto direction = camera_.unproject(pixel);
    if (!direction) return false;
    const Rigid3d pose =
        image.world_from_camera.at_pixel(pixel.x(), pixel.y(), camera_.width, camera_.height);
    track->ray[track->n++] = {pose.translation(), pose.linear() * *direction};
    return true;
  }

  /// Continues the active tracks into the next image and drops those that end.
  void advance(const TrackImage& from, const TrackImage& to,
               std::vector<ActiveTrack>* active) const {
    const Rigid3d camera_from_world = to.world_from_camera.at(0.5).inverse(Eigen::Isometry);
    std::vector<std::optional<cv::Point2f>> found(active->size());
    // If tracks have points, all or none of them, they are searched near these.
    const bool predicted_well = !active->empty() && active->front().rays->n > 1;
    const int levels = predicted_well ? std::min(levels_, kLevelsWithPoint) : levels_;
    for (const double parallax : kParallaxes) {
      std::vector<std::size_t> searched;  // indices of tracks
      std::vector<cv::Point2f> at, guesses;
      for (std::size_t i = 0; i < active->size(); ++i) {
        const ActiveTrack& track = (*active)[i];
        if (found[i] || (parallax > 0 && track.rays->n > 1)) continue;
        const auto pixel = camera_.project(predicted(*track.rays, camera_from_world, parallax));
        searched.push_back(i);
        at.push_back(track.at);
        guesses.push_back(pixel ? reduced_pixel(*pixel) : track.at);
      }
      const auto next = flow_there_and_back(from.pyramid, to.pyramid, at, guesses,
                                            {kWindow_px, levels, kForwardBackward_px});
      for (std::size_t k = 0; k < searched.size(); ++k) found[searched[k]] = next[k];
    }
    std::size_t kept = 0;
    for (std::size_t i = 0; i < active->size(); ++i)
      if (found[i] && add_ray(to, *found[i], (*active)[i].rays))
        (*active)[kept++] = {(*active)[i].rays, *found[i], (*active)[i].rad_per_px};
    active->resize(kept);
    std::erase_if(*active, [](const ActiveTrack& track) { return track.is_exact(); });
  }

  /// Returns the point, or the direction, in camera axes where a track is expected: its own point,
  /// or, before it has one, the point on its ray from which the way to the camera spans `parallax`.
  static Eigen::Vector3d predicted(const TrackRays& rays, const Rigid3d& camera_from_world,
                                   double parallax) {
    const auto& [origin, direction] = rays.ray[rays.n - 1];
    if (rays.n > 1) {
      const NearestToRays nearest = rays.nearest();
      const Eigen::Vector3d point = rays.ray[0].origin + nearest.from_first;
      if (nearest.least_eigenvalue > 0 && (point - origin).dot(direction) > 0)
        return camera_from_world * point;
    } else if (parallax > 0) {
      const double baseline = (camera_from_world * origin).norm();
      return camera_from_world * Eigen::Vector3d(origin + baseline / parallax * direction);
    }
    return camera_from_world.linear() * direction;
  }

  /// The angle of a pixel's side, rad: square root of its solid angle.
  double rad_per_px(const Eigen::Vector2d& pixel) const {
    const auto here = camera_.unproject(pixel);
    const auto right = camera_.unproject(pixel + Eigen::Vector2d(1, 0)),
               below = camera_.unproject(pixel + Eigen::Vector2d(0, 1));
    if (!here || !right || !below) return 0;
    return std::sqrt((*right - *here).cross(*below - *here).norm());
  }

  const Camera& camera_;
  DistanceRange range_;
  std::vector<TrackImage> images_;
  int factor_ = 1;  ///< factor by which images are reduced
  int levels_ = 0;
};

/// Where tracks start.
struct Start {
  int image, step;
  std::vector<cv::Point2f> corners = {};
  std::vector<ColouredPoint> points = {};
};

/// Finds the corners and points of some of the starts, in parallel.
void track(const CameraTracker& tracker, std::span<Start* const> starts, ThreadPool& pool) {
  struct Task {
    Start* start;
    std::size_t first;
    std::vector<ColouredPoint> points = {};
  };
  pool.run(static_cast<int>(starts.size()),
           [&](int k) { starts[k]->corners = tracker.corners_of(starts[k]->image); });
  std::vector<Task> tasks;
  for (Start* const start : starts)
    for (std::size_t i = 0; i < start->corners.size(); i += kCornersOfTask)
      tasks.push_back({start, i});
  pool.run(static_cast<int>(tasks.size()), [&](int k) {
    Task& task = tasks[k];
    const std::span corners = std::span(task.start->corners).subspan(task.first);
    task.points = tracker.points_from(task.start->image, task.start->step,
                                      corners.first(std::min(corners.size(), kCornersOfTask)));
  });
  for (const Task& task : tasks)
    task.start->points.insert(task.start->points.end(), task.points.begin(), task.points.end());
}

}  // namespace

PointCloud track_points(const Scene& scene, const ViewImages& images, ThreadPool& pool) {
  REDRIVE_CHECK_OP(images.size(), ==, scene.views.size());
  const auto trained = std::ranges::count(scene.views, false, &View::held_out);
  // Every start is tracked forward and backward.
  const int every = std::max<int>(kStartEvery, (2 * trained + kMaxStarts - 1) / kMaxStarts);
  std::vector<std::vector<ColouredPoint>> parts;
  for (int camera = 0; camera < static_cast<int>(scene.rig.size()); ++camera) {
    CameraTracker tracker(scene, camera);
    std::vector<Start> starts;
    const int last = tracker.images() - 1;
    for (int i = 0; i + kMinObservations - 1 <= last; i += every) {
      starts.push_back({i, 1});
      starts.push_back({last - i, -1});
    }
    std::size_t n_corners = 0, n_points = 0;
    // Batches of starts by the last image that they use, so that few images are needed at once.
    std::vector<std::vector<Start*>> batches(tracker.images() / kBatch + 1);
    for (Start& start : starts)
      batches[(tracker.used_by(start.image, start.step).second - 1) / kBatch].push_back(&start);
    for (int b = 0; b < std::ssize(batches); ++b) {
      if (batches[b].empty()) continue;
      const int end = std::min((b + 1) * kBatch, tracker.images());
      tracker.prepare(std::max(0, b * kBatch - kLength + 1), end, images, pool);
      std::vector<Start*> probes, others;
      for (std::size_t k = 0; k < batches[b].size(); ++k)
        (k % kProbeEvery == 0 ? probes : others).push_back(batches[b][k]);
      const auto track_some = [&](const std::vector<Start*>& some) {
        track(tracker, some, pool);
        for (Start* const start : some) {
          n_corners += std::exchange(start->corners, {}).size();
          n_points += start->points.size();
        }
      };
      track_some(probes);
      if (double(n_points) >= kLeastYield * double(n_corners)) track_some(others);
    }
    for (Start& start : starts) parts.push_back(std::move(start.points));
  }
  return make_point_cloud(parts);
}

}  // namespace redrive

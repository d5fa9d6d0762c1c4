// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/tracks/feature_tracker.h"

#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>

#include "redrive/align/tracks/epipolar.h"
#include "redrive/align/tracks/patch.h"

namespace redrive {
namespace {

constexpr int kPyramidLevels = 3;
constexpr double kNearest_px = 4;          // two points closer than this are one
constexpr double kForwardBackward_px = 1;  // of Lucas-Kanade there and back; registration is finer
constexpr double kRegister_px = 3;         // how far registration may move what Lucas-Kanade found
constexpr double kLargestScale =
    1.6;  // of a patch and its first one: beyond, the last one is the new first
constexpr double kFar_m = 1e5;
constexpr float kCornerLevels =
    1.5f;  // least gradient of a corner in its weaker direction, grey levels per pixel

/// A track that goes on.
struct Live {
  Track track;
  Patch patch;  ///< of the image that the others are registered with
  Eigen::Matrix2d warp = Eigen::Matrix2d::Identity();  ///< from it to the last image
  const Eigen::Vector2d& pixel() const { return track.seen.back().pixel; }
};

/// One image made ready.
struct PreparedImage {
  int frame = -1;
  SmoothImage smooth;
  std::vector<cv::Mat> pyramid;
  std::vector<MovingBox> moving;
};

class FeatureTracker {
 public:
  FeatureTracker(const RigImages& images, int camera, const TrackOptions& options)
      : images_(images), camera_(camera), options_(options), model_(images.camera(camera)) {}

  std::vector<Track> run() {
    for (int frame = 0; frame < images_.frames(); ++frame) {
      const cv::Mat& grey = images_.grey[camera_][frame];
      if (grey.empty()) continue;
      PreparedImage next{frame, smooth_image(grey), {}, images_.moving_at(camera_, frame)};
      cv::buildOpticalFlowPyramid(grey, next.pyramid, {kPatchSize, kPatchSize}, kPyramidLevels);
      if (now_.frame >= 0 && !live_.empty()) advance(next);
      now_ = std::move(next);
      add_corners();
    }
    for (Live& live : live_) finish(std::move(live));
    return std::move(done_);
  }

 private:
  struct Guess {
    Eigen::Vector2d pixel;
    Eigen::Matrix2d warp;  ///< from the last image to the next
  };

  void finish(Live&& live) {
    if (live.track.seen.size() >= 2) done_.push_back(std::move(live.track));
  }

  /// Depth along the ray to the ground on which the vehicle stands; nothing above the horizon.
  std::optional<double> ground_depth(const Eigen::Vector3d& ray) const {
    const Rigid3d& body_from_camera = images_.scene.rig[camera_].body_from_sensor;
    const double down = -(body_from_camera.linear() * ray).z(),
                 height = body_from_camera.translation().z();
    if (down < 0.02 || height < 0.2) return std::nullopt;
    return height / down;
  }

  /// Where the track has it, by its first and last rays; nothing while they do not tell.
  std::optional<double> own_depth(const Track& track) const {
    const Observation& first = track.seen[track.seen.size() > 5 ? track.seen.size() - 5 : 0];
    const Observation& last = track.seen.back();
    if (first.frame == last.frame) return std::nullopt;
    const auto& poses = images_.world_from_camera[camera_];
    const auto from = model_.unproject(first.pixel), to = model_.unproject(last.pixel);
    if (!from || !to) return std::nullopt;
    return ray_depth(*to, *from, poses[first.frame].inverse() * poses[last.frame]);
  }

  /// Where a point of the last image is in the next if it lies as deep as `depth` says of a ray.
  template <class Depth>
  std::optional<Guess> guess(const Eigen::Vector2d& pixel, const Rigid3d& next_from_now,
                             const Depth& depth) const {
    const auto project = [&](const Eigen::Vector2d& at) -> std::optional<Eigen::Vector2d> {
      const auto ray = model_.unproject(at);
      const std::optional<double> d = ray ? depth(*ray) : std::nullopt;
      if (!d) return std::nullopt;
      return model_.project(next_from_now * (*d * *ray));
    };
    const auto centre = project(pixel);
    const auto right = project(pixel + Eigen::Vector2d(2, 0)),
               left = project(pixel - Eigen::Vector2d(2, 0));
    const auto below = project(pixel + Eigen::Vector2d(0, 2)),
               above = project(pixel - Eigen::Vector2d(0, 2));
    if (!centre || !right || !left || !below || !above) return std::nullopt;
    Guess g{*centre, {}};
    g.warp << (*right - *left) / 4, (*below - *above) / 4;
    const double scale = std::sqrt(std::abs(g.warp.determinant()));
    if (!(scale > 0.3 && scale < 3)) return std::nullopt;
    return g;
  }

  /// By the track's own depth, on the ground, and far away.
  std::array<std::optional<Guess>, 3> guesses(const Live& live,
                                              const Rigid3d& next_from_now) const {
    std::array<std::optional<Guess>, 3> all;
    if (const auto depth = own_depth(live.track))
      all[0] = guess(live.pixel(), next_from_now, [&](const auto&) { return depth; });
    all[1] = guess(live.pixel(), next_from_now, [&](const auto& ray) { return ground_depth(ray); });
    all[2] = guess(live.pixel(), next_from_now,
                   [&](const auto&) { return std::optional<double>(kFar_m); });
    return all;
  }

  void lucas_kanade(const PreparedImage& from, const PreparedImage& to,
                    const std::vector<cv::Point2f>& points, std::vector<cv::Point2f>* found,
                    std::vector<std::uint8_t>* good) const {
    std::vector<float> error;
    cv::calcOpticalFlowPyrLK(from.pyramid, to.pyramid, points, *found, *good, error,
                             {kPatchSize, kPatchSize}, kPyramidLevels,
                             {cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 20, 0.03},
                             cv::OPTFLOW_USE_INITIAL_FLOW, 1e-4);
  }

  /// All live tracks into `next`; those that are lost are finished.
  void advance(const PreparedImage& next) {
    const Rigid3d next_from_now = images_.world_from_camera[camera_][next.frame].inverse() *
                                  images_.world_from_camera[camera_][now_.frame];
    struct Candidate {
      std::size_t live;
      Guess guess;
    };
    std::vector<Candidate> candidates;
    std::vector<cv::Point2f> from, to;
    const auto point = [](const Eigen::Vector2d& p) {
      return cv::Point2f(static_cast<float>(p.x()), static_cast<float>(p.y()));
    };
    for (std::size_t i = 0; i < live_.size(); ++i)
      for (const auto& g : guesses(live_[i], next_from_now))
        if (g) {
          candidates.push_back({i, *g});
          from.push_back(point(live_[i].pixel()));
          to.push_back(point(g->pixel));
        }
    std::vector<std::optional<PatchFit>> best(live_.size());
    std::vector<Patch> patches(live_.size());  // what the best fit was registered with
    std::vector<std::uint8_t> renewed(live_.size());
    if (!candidates.empty()) {
      std::vector<std::uint8_t> there, back;
      lucas_kanade(now_, next, from, &to, &there);
      std::vector<cv::Point2f> returned = from;
      lucas_kanade(next, now_, to, &returned, &back);
      for (std::size_t k = 0; k < candidates.size(); ++k) {
        const std::size_t i = candidates[k].live;
        if (!there[k] || !back[k] || cv::norm(returned[k] - from[k]) > kForwardBackward_px)
          continue;
        const Eigen::Vector2d start(to[k].x, to[k].y);
        if (best[i] && (best[i]->pixel - start).norm() < 0.3) continue;  // another guess came here
        const Live& live = live_[i];
        auto fit = good_fit(live.patch, next, start, candidates[k].guess.warp * live.warp);
        if (fit && (!best[i] || fit->correlation > best[i]->correlation)) {
          best[i] = fit;
          patches[i] = live.patch;
          renewed[i] = 0;
        }
        if (fit || best[i]) continue;
        const auto last =
            sample_patch(now_.smooth, live.pixel());  // has its looks changed too much?
        if (last) fit = good_fit(*last, next, start, candidates[k].guess.warp);
        if (!fit) continue;
        best[i] = fit;
        patches[i] = *last;
        renewed[i] = 1;
      }
    }
    keep(next, best, patches);
  }

  std::optional<PatchFit> good_fit(const Patch& patch, const PreparedImage& next,
                                   const Eigen::Vector2d& start,
                                   const Eigen::Matrix2d& warp) const {
    const auto fit = fit_patch(patch, next.smooth, start, warp, kRegister_px);
    if (!fit || fit->correlation < options_.min_correlation ||
        fit->sigma_px > options_.max_sigma_px)
      return std::nullopt;
    return fit;
  }

  void keep(const PreparedImage& next, const std::vector<std::optional<PatchFit>>& best,
            const std::vector<Patch>& patches) {
    std::vector<Live> going;
    cv::Mat taken(next.smooth.value.size(), CV_8U, cv::Scalar(0));
    for (std::size_t i = 0; i < live_.size(); ++i) {  // older ones come first
      Live& live = live_[i];
      const cv::Point at = best[i]
                               ? cv::Point(cvRound(best[i]->pixel.x()), cvRound(best[i]->pixel.y()))
                               : cv::Point();
      if (!best[i] || !images_.may_be_static(camera_, next.frame, best[i]->pixel, next.moving) ||
          taken.at<std::uint8_t>(at)) {
        finish(std::move(live));
        continue;
      }
      cv::circle(taken, at, static_cast<int>(kNearest_px), cv::Scalar(255), cv::FILLED);
      live.track.seen.push_back({camera_, next.frame, best[i]->pixel, best[i]->sigma_px});
      live.patch = patches[i];
      live.warp = best[i]->warp;
      const double scale = std::sqrt(std::abs(live.warp.determinant()));
      if (scale > kLargestScale || scale < 1 / kLargestScale) {
        const auto patch = sample_patch(next.smooth, live.pixel());
        if (!patch) {
          finish(std::move(live));
          continue;
        }
        live.patch = *patch;
        live.warp.setIdentity();
      }
      going.push_back(std::move(live));
    }
    live_ = std::move(going);
  }

  /// The best corner of each cell of the grid without a track.
  void add_corners() {
    const cv::Mat& value = now_.smooth.value;
    const int cell =
        std::max(8, static_cast<int>(std::sqrt(double(value.cols) * value.rows /
                                               std::max(1, options_.points_per_image))));
    cv::Mat strength, occupied(value.size(), CV_8U, cv::Scalar(0));
    cv::cornerMinEigenVal(value, strength, 7);
    // OpenCV sums squared Sobel gradients (8 x gradient) times (1 / (4 block))^2 over block^2
    // pixels: 4 mean of gradient^2.
    const float least = 4 * kCornerLevels * kCornerLevels;
    for (const Live& live : live_)
      cv::circle(occupied, {cvRound(live.pixel().x()), cvRound(live.pixel().y())}, cell / 2,
                 cv::Scalar(255), cv::FILLED);
    const cv::Mat& usable = images_.usable[camera_][now_.frame];
    for (int top = 0; top < value.rows; top += cell)
      for (int left = 0; left < value.cols; left += cell) {
        float best = least;
        cv::Point at(-1, -1);
        for (int y = top; y < std::min(top + cell, value.rows); ++y)
          for (int x = left; x < std::min(left + cell, value.cols); ++x)
            if (strength.at<float>(y, x) > best && usable.at<std::uint8_t>(y, x) &&
                !occupied.at<std::uint8_t>(y, x)) {
              best = strength.at<float>(y, x);
              at = {x, y};
            }
        const Eigen::Vector2d pixel(at.x, at.y);
        if (at.x < 0 || !images_.may_be_static(camera_, now_.frame, pixel, now_.moving)) continue;
        const auto patch = sample_patch(now_.smooth, pixel);
        if (!patch) continue;
        live_.push_back({Track{{{camera_, now_.frame, pixel}}}, *patch});
        cv::circle(occupied, at, static_cast<int>(kNearest_px), cv::Scalar(255), cv::FILLED);
      }
  }

  const RigImages& images_;
  int camera_;
  const TrackOptions& options_;
  Camera model_;
  PreparedImage now_;
  std::vector<Live> live_;
  std::vector<Track> done_;
};

}  // namespace

std::vector<Track> track_features(const RigImages& images, int camera,
                                  const TrackOptions& options) {
  return FeatureTracker(images, camera, options).run();
}

}  // namespace redrive

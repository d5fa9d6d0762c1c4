// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/tracks/feature_tracker.h"

#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>

#include "redrive/align/tracks/epipolar.h"
#include "redrive/align/tracks/patch.h"
#include "redrive/base/opencv_threads.h"
#include "redrive/perception/feature_flow.h"

namespace redrive {
namespace {

constexpr int kPyramidLevels = 3;
constexpr double kNearest_px = 4;  // points closer than this are duplicates
constexpr float kForwardBackward_px =
    1;  // error of Lucas-Kanade forward and backward; registration is finer
constexpr double kRegister_px = 3;  // largest correction of Lucas-Kanade by registration
// scale of a patch relative to its first one; beyond, the last patch becomes the reference
constexpr double kLargestScale = 1.6;
constexpr double kFar_m = 1e5;
constexpr int kCornerBlock_px = 7;
constexpr double kCornerLevels =
    1.5;  // least gradient of a corner in its weaker direction, grey levels per pixel

/// A track in progress.
struct ActiveTrack {
  Track track;
  Patch patch;  ///< reference that the other images are registered with
  Eigen::Matrix2d warp = Eigen::Matrix2d::Identity();  ///< from it to the last image
  const Eigen::Vector2d& pixel() const { return track.seen.back().pixel; }
};

/// One image prepared for tracking.
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

  std::vector<Track> run(Progress* progress) {
    for (int frame = 0; frame < images_.frames(); ++frame) {
      const cv::Mat& grey = images_.grey[camera_][frame];
      if (grey.empty()) continue;
      progress->count();
      PreparedImage next{frame, smooth_image(grey), {}, images_.moving_at(camera_, frame)};
      cv::buildOpticalFlowPyramid(grey, next.pyramid, {kPatchSize, kPatchSize}, kPyramidLevels);
      if (now_.frame >= 0 && !active_.empty()) advance(next);
      now_ = std::move(next);
      add_corners();
    }
    for (ActiveTrack& active : active_) finish(std::move(active));
    return std::move(done_);
  }

 private:
  struct Guess {
    Eigen::Vector2d pixel;
    Eigen::Matrix2d warp;  ///< from the last image to the next
  };

  void finish(ActiveTrack&& active) {
    if (active.track.seen.size() >= 2) done_.push_back(std::move(active.track));
  }

  /// Depth along the ray to the ground on which the vehicle stands; nothing above the horizon.
  std::optional<double> ground_depth(const Eigen::Vector3d& ray) const {
    const Rigid3d& body_from_camera = images_.scene.rig[camera_].body_from_sensor;
    const double down = -(body_from_camera.linear() * ray).z(),
                 height = body_from_camera.translation().z();
    if (down < 0.02 || height < 0.2) return std::nullopt;
    return height / down;
  }

  /// Depth by triangulation of the first and last ray of the track; nothing without parallax.
  std::optional<double> own_depth(const Track& track) const {
    const Observation& first = track.seen[track.seen.size() > 5 ? track.seen.size() - 5 : 0];
    const Observation& last = track.seen.back();
    if (first.frame == last.frame) return std::nullopt;
    const auto& poses = images_.world_from_camera[camera_];
    const auto from = model_.unproject(first.pixel), to = model_.unproject(last.pixel);
    if (!from || !to) return std::nullopt;
    return ray_depth(*to, *from, poses[first.frame].inverse() * poses[last.frame]);
  }

  /// Predicts a point of the last image in the next one, with its depth from `depth`(ray).
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

  /// Predictions by the track's own depth, on the ground, and at infinity.
  std::array<std::optional<Guess>, 3> guesses(const ActiveTrack& active,
                                              const Rigid3d& next_from_now) const {
    std::array<std::optional<Guess>, 3> all;
    if (const auto depth = own_depth(active.track))
      all[0] = guess(active.pixel(), next_from_now, [&](const auto&) { return depth; });
    all[1] =
        guess(active.pixel(), next_from_now, [&](const auto& ray) { return ground_depth(ray); });
    all[2] = guess(active.pixel(), next_from_now,
                   [&](const auto&) { return std::optional<double>(kFar_m); });
    return all;
  }

  /// Continues all active tracks into `next` and finishes the lost ones.
  void advance(const PreparedImage& next) {
    const Rigid3d next_from_now = images_.world_from_camera[camera_][next.frame].inverse() *
                                  images_.world_from_camera[camera_][now_.frame];
    struct Candidate {
      std::size_t active;
      Guess guess;
    };
    std::vector<Candidate> candidates;
    std::vector<cv::Point2f> from, guessed;
    const auto point = [](const Eigen::Vector2d& p) {
      return cv::Point2f(static_cast<float>(p.x()), static_cast<float>(p.y()));
    };
    for (std::size_t i = 0; i < active_.size(); ++i)
      for (const auto& g : guesses(active_[i], next_from_now))
        if (g) {
          candidates.push_back({i, *g});
          from.push_back(point(active_[i].pixel()));
          guessed.push_back(point(g->pixel));
        }
    std::vector<std::optional<PatchFit>> best(active_.size());
    std::vector<Patch> patches(active_.size());  // references of the best fits
    const auto found = flow_there_and_back(now_.pyramid, next.pyramid, from, guessed,
                                           {kPatchSize, kPyramidLevels, kForwardBackward_px});
    for (std::size_t k = 0; k < candidates.size(); ++k) {
      const std::size_t i = candidates[k].active;
      if (!found[k]) continue;
      const Eigen::Vector2d start(found[k]->x, found[k]->y);
      if (best[i] && (best[i]->pixel - start).norm() < 0.3)
        continue;  // another prediction converged here
      const ActiveTrack& active = active_[i];
      auto fit = good_fit(active.patch, next, start, candidates[k].guess.warp * active.warp);
      if (fit && (!best[i] || fit->correlation > best[i]->correlation)) {
        best[i] = fit;
        patches[i] = active.patch;
      }
      if (fit || best[i]) continue;
      const auto last =
          sample_patch(now_.smooth, active.pixel());  // the appearance may have changed too much
      if (last) fit = good_fit(*last, next, start, candidates[k].guess.warp);
      if (!fit) continue;
      best[i] = fit;
      patches[i] = *last;
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
    std::vector<ActiveTrack> continued;
    cv::Mat taken(next.smooth.value.size(), CV_8U, cv::Scalar(0));
    for (std::size_t i = 0; i < active_.size(); ++i) {  // older tracks have precedence
      ActiveTrack& active = active_[i];
      const cv::Point at = best[i]
                               ? cv::Point(cvRound(best[i]->pixel.x()), cvRound(best[i]->pixel.y()))
                               : cv::Point();
      if (!best[i] || !images_.may_be_static(camera_, next.frame, best[i]->pixel, next.moving) ||
          taken.at<std::uint8_t>(at)) {
        finish(std::move(active));
        continue;
      }
      cv::circle(taken, at, static_cast<int>(kNearest_px), cv::Scalar(255), cv::FILLED);
      active.track.seen.push_back({camera_, next.frame, best[i]->pixel, best[i]->sigma_px});
      active.patch = patches[i];
      active.warp = best[i]->warp;
      const double scale = std::sqrt(std::abs(active.warp.determinant()));
      if (scale > kLargestScale || scale < 1 / kLargestScale) {
        const auto patch = sample_patch(next.smooth, active.pixel());
        if (!patch) {
          finish(std::move(active));
          continue;
        }
        active.patch = *patch;
        active.warp.setIdentity();
      }
      continued.push_back(std::move(active));
    }
    active_ = std::move(continued);
  }

  /// The best corner of each cell of the grid without a track.
  void add_corners() {
    const cv::Mat& value = now_.smooth.value;
    const int cell =
        std::max(8, static_cast<int>(std::sqrt(double(value.cols) * value.rows /
                                               std::max(1, options_.points_per_image))));
    cv::Mat free = images_.usable[camera_][now_.frame].clone();
    const auto occupy = [&](const cv::Point& at, int radius) {
      cv::circle(free, at, radius, cv::Scalar(0), cv::FILLED);
    };
    for (const ActiveTrack& active : active_)
      occupy({cvRound(active.pixel().x()), cvRound(active.pixel().y())}, cell / 2);
    for_each_corner(value, free, {cell, kCornerBlock_px, 0, kCornerLevels},
                    [&](const cv::Point& at) {
                      const Eigen::Vector2d pixel(at.x, at.y);
                      if (!images_.may_be_static(camera_, now_.frame, pixel, now_.moving)) return;
                      const auto patch = sample_patch(now_.smooth, pixel);
                      if (!patch) return;
                      active_.push_back({Track{{{camera_, now_.frame, pixel}}}, *patch});
                      occupy(at, static_cast<int>(kNearest_px));
                    });
  }

  const RigImages& images_;
  int camera_;
  const TrackOptions& options_;
  Camera model_;
  PreparedImage now_;
  std::vector<ActiveTrack> active_;
  std::vector<Track> done_;
};

}  // namespace

std::vector<Track> track_features(const RigImages& images, int camera, const TrackOptions& options,
                                  Progress* progress) {
  return FeatureTracker(images, camera, options).run(progress);
}

}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/tracks/cross_camera_tracks.h"

#include <opencv2/imgproc.hpp>

#include "redrive/align/tracks/epipolar.h"
#include "redrive/align/tracks/patch.h"
#include "redrive/align/tracks/triangulate.h"
#include "redrive/base/opencv_threads.h"

namespace redrive {
namespace {

constexpr double kCalibrationError_rad = 0.02,
                 kCalibrationError_m = 0.5;  // largest error of the recorded calibration
constexpr double kWidestSearch_px = 40, kNarrowSearch_px = 5;
constexpr double kMinScale = 0.6,
                 kMaxScale = 4;          // pixels of the first camera per pixel of the other
constexpr double kMinCorrelation = 0.7;  // at whole pixels; registration requires more
constexpr double kAmbiguous =
    0.08;  // margin by which the best position has to exceed any other, in the wide search
constexpr std::size_t kMinMatches = 20;
constexpr int kSampledFrames = 16;       // frames that the first pass looks at
constexpr std::size_t kWidePoints = 40;  // points for each frame and pair in the first pass
constexpr double kMaxCorrection_rad = 0.08,
                 kMaxCorrection_m = 1.5;  // beyond, matches agree by chance
constexpr double kApart_px = 2;           // spread of a track's matches around the prediction

/// An observation of a track whose depth is known.
struct Source {
  std::size_t track, seen;
  Eigen::Vector3d in_camera;  ///< the point, camera axes
};

struct Match {
  std::size_t track;
  int frame;
  PatchFit fit;                ///< in the other camera
  Eigen::Vector2d from_guess;  ///< offset from the predicted position
  RayPair rays;
  double depth_m;  ///< depth in the first camera
};

/// Two cameras of the rig; points of the first are searched for in the second.
struct CameraPair {
  int a, b;
  Rigid3d b_from_a;
  bool corrected = false;
};

class CrossCameraMatcher {
 public:
  CrossCameraMatcher(const RigImages& images, const std::vector<TrackOptions>& options,
                     ThreadPool& pool, std::vector<std::vector<Track>>* of_camera)
      : images_(images), options_(options), pool_(pool), of_camera_(*of_camera) {}

  void run() {
    find_sources();
    std::vector<CameraPair> pairs;
    for (int a = 0; a < images_.cameras(); ++a)
      for (int b = 0; b < images_.cameras(); ++b)
        if (a != b) pairs.push_back({a, b, calibrated(a, b)});
    const int step = std::max(1, images_.frames() / kSampledFrames);
    const auto wide = match_all(pairs, step);
    std::vector<CameraPair> overlapping;
    for (std::size_t p = 0; p < pairs.size(); ++p)
      if (const auto pose = corrected_pose(pairs[p], wide[p]))
        overlapping.push_back({pairs[p].a, pairs[p].b, *pose, true});
    auto narrow = match_all(overlapping, 1);
    for (std::size_t p = 0; p < overlapping.size(); ++p)
      attach(overlapping[p], std::move(narrow[p]));
  }

 private:
  /// Returns the calibrated relative pose. The time between the exposures of one frame is in the
  /// poses of that frame.
  Rigid3d calibrated(int a, int b) const {
    const int middle = images_.frames() / 2;
    return images_.world_from_camera[b][middle].inverse() * images_.world_from_camera[a][middle];
  }

  /// Finds the depth of all tracks with the poses as recorded.
  void find_sources() {
    std::vector<std::vector<std::vector<Source>>> of_camera(images_.cameras());
    pool_.run(images_.cameras(), [&](int c) {
      of_camera[c].resize(images_.frames());
      const auto& tracks = of_camera_[c];
      for (std::size_t t = 0; t < tracks.size(); ++t) {
        std::vector<Rigid3d> poses;
        for (const Observation& o : tracks[t].seen)
          poses.push_back(images_.world_from_camera[c][o.frame]);
        const auto point = triangulate(tracks[t], poses, images_.model,
                                       {.min_angle_rad = 0.005, .outlier_px = 15});
        if (!point) continue;
        for (std::size_t i = 0; i < tracks[t].seen.size(); ++i) {
          const auto ray = images_.camera(c).unproject(tracks[t].seen[i].pixel);
          const double depth = (*point - poses[i].translation()).norm();
          if (ray) of_camera[c][tracks[t].seen[i].frame].push_back({t, i, depth * *ray});
        }
      }
    });
    sources_ = std::move(of_camera);
  }

  /// One list per pair; every step-th frame.
  std::vector<std::vector<Match>> match_all(const std::vector<CameraPair>& pairs, int step) {
    const int chunks = (images_.frames() + step - 1) / step;
    std::vector<std::vector<std::vector<Match>>> of_frame(
        chunks, std::vector<std::vector<Match>>(pairs.size()));
    pool_.run(chunks, [&](int chunk) {
      const int frame = chunk * step;
      std::vector<SmoothImage> smooth(images_.cameras());
      for (int c = 0; c < images_.cameras(); ++c)
        if (!images_.grey[c][frame].empty()) smooth[c] = smooth_image(images_.grey[c][frame]);
      for (std::size_t p = 0; p < pairs.size(); ++p) {
        const CameraPair& pair = pairs[p];
        if (smooth[pair.b].value.empty()) continue;
        const auto moving = images_.moving_at(pair.b, frame);
        for (const Source& source : visible(pair, frame))
          if (auto match = find(pair, source, smooth[pair.a], smooth[pair.b]))
            if (images_.may_be_static(pair.b, frame, match->fit.pixel, moving)) {
              match->frame = frame;
              of_frame[chunk][p].push_back(*match);
            }
      }
    });
    std::vector<std::vector<Match>> all(pairs.size());
    for (auto& of_pair : of_frame)
      for (std::size_t p = 0; p < pairs.size(); ++p)
        all[p].insert(all[p].end(), of_pair[p].begin(), of_pair[p].end());
    return all;
  }

  /// Returns points of camera a that project into the image of camera b; for the wide search only
  /// some of them.
  std::vector<Source> visible(const CameraPair& pair, int frame) const {
    std::vector<Source> all, some;
    const Camera& camera = images_.camera(pair.b);
    for (const Source& source : sources_[pair.a][frame]) {
      const auto guess = camera.project(pair.b_from_a * source.in_camera);
      if (guess && guess->minCoeff() > 0 && guess->x() < camera.width && guess->y() < camera.height)
        all.push_back(source);
    }
    const std::size_t step = pair.corrected ? 1 : (all.size() + kWidePoints - 1) / kWidePoints;
    for (std::size_t i = 0; i < all.size(); i += step) some.push_back(all[i]);
    return some;
  }

  /// Normals, in the axes of camera b, of the surfaces that a point may lie on: one that faces both
  /// cameras, the ground, a wall along the road, one across.
  std::array<Eigen::Vector3d, 4> likely_normals(const CameraPair& pair,
                                                const Eigen::Vector3d& in_b) const {
    const Eigen::Matrix3d b_from_body =
        images_.scene.rig[pair.b].body_from_sensor.linear().transpose();
    const Eigen::Vector3d facing =
        in_b.normalized() + (in_b - pair.b_from_a.translation()).normalized();
    return {facing, b_from_body.col(2), b_from_body.col(1), b_from_body.col(0)};
  }

  /// The patch around the source, warped into camera b around `guess`.
  std::optional<Patch> warped_patch(const CameraPair& pair, const Source& source,
                                    const Eigen::Vector3d& in_b, const Eigen::Vector2d& guess,
                                    const Eigen::Vector3d& normal, const SmoothImage& a) const {
    const Rigid3d a_from_b = pair.b_from_a.inverse();
    const auto to_a = [&](const Eigen::Vector2d& offset) -> std::optional<Eigen::Vector2d> {
      const auto ray = images_.camera(pair.b).unproject(guess + offset);
      if (!ray) return std::nullopt;
      const double depth = normal.dot(in_b) / normal.dot(*ray);
      if (!(depth > 0.2 * in_b.norm() && depth < 5 * in_b.norm())) return std::nullopt;
      return images_.camera(pair.a).project(a_from_b * (depth * *ray));
    };
    constexpr double kStep_px = kPatchHalf / 2.0;
    const auto right = to_a({kStep_px, 0}), left = to_a({-kStep_px, 0}),
               below = to_a({0, kStep_px}), above = to_a({0, -kStep_px});
    if (!right || !left || !below || !above) return std::nullopt;
    Eigen::Matrix2d warp;
    warp << (*right - *left) / (2 * kStep_px), (*below - *above) / (2 * kStep_px);
    const double scale = std::sqrt(std::abs(warp.determinant()));
    if (scale < kMinScale || scale > kMaxScale) return std::nullopt;
    return sample_patch(a, of_camera_[pair.a][source.track].seen[source.seen].pixel, warp);
  }

  std::optional<Match> find(const CameraPair& pair, const Source& source, const SmoothImage& a,
                            const SmoothImage& b) const {
    const Camera& camera = images_.camera(pair.b);
    const Eigen::Vector3d in_b = pair.b_from_a * source.in_camera;
    const auto guess = camera.project(in_b);
    if (!guess) return std::nullopt;
    const Eigen::Vector2d pixel_a = of_camera_[pair.a][source.track].seen[source.seen].pixel;
    const auto here = make_ray_pair(images_.camera(pair.a), pixel_a, camera, *guess);
    if (!here) return std::nullopt;
    const double error_rad = kCalibrationError_rad + kCalibrationError_m / in_b.norm();
    const auto radius = static_cast<int>(
        std::ceil(pair.corrected ? kNarrowSearch_px
                                 : std::min(kWidestSearch_px, error_rad * here->px_per_rad_b)));
    const cv::Rect image({0, 0}, b.value.size());
    const int reach = radius + kPatchHalf;
    const cv::Rect searched = cv::Rect(cvRound(guess->x()) - reach, cvRound(guess->y()) - reach,
                                       2 * reach + 1, 2 * reach + 1) &
                              image;
    if (searched.width < kPatchSize + 2 || searched.height < kPatchSize + 2) return std::nullopt;

    double best = kMinCorrelation;
    Eigen::Vector2d at;
    std::optional<Patch> patch;
    for (const Eigen::Vector3d& normal : likely_normals(pair, in_b)) {
      auto looks = warped_patch(pair, source, in_b, *guess, normal, a);
      if (!looks) continue;
      const cv::Mat wanted(kPatchSize, kPatchSize, CV_32F, looks->data());
      cv::Mat correlation;
      cv::matchTemplate(b.value(searched), wanted, correlation, cv::TM_CCOEFF_NORMED);
      double highest = 0;
      cv::Point peak;
      cv::minMaxLoc(correlation, nullptr, &highest, nullptr, &peak);
      if (!(highest > best)) continue;
      if (!pair.corrected) {
        cv::circle(correlation, peak, 4, cv::Scalar(-1), cv::FILLED);
        double second = 0;
        cv::minMaxLoc(correlation, nullptr, &second);
        if (second > highest - kAmbiguous) continue;
      }
      best = highest;
      at = Eigen::Vector2d(searched.x + peak.x + kPatchHalf, searched.y + peak.y + kPatchHalf);
      patch = *looks;
    }
    if (!patch) return std::nullopt;
    const auto fit = fit_patch(*patch, b, at, Eigen::Matrix2d::Identity(), 2);
    if (!fit || fit->correlation < options_[pair.b].min_correlation ||
        fit->sigma_px > options_[pair.b].max_sigma_px)
      return std::nullopt;
    const auto rays = make_ray_pair(images_.camera(pair.a), pixel_a, camera, fit->pixel);
    if (!rays) return std::nullopt;
    return Match{source.track, 0, *fit, fit->pixel - *guess, *rays, source.in_camera.norm()};
  }

  static std::vector<RayPair> rays_of(const std::vector<Match>& matches) {
    std::vector<RayPair> rays;
    for (const Match& match : matches) rays.push_back(match.rays);
    return rays;
  }

  /// The relative pose of the cameras fitted to the matches; nothing if they do not agree on one.
  /// The length of the baseline follows from the depths along the tracks.
  std::optional<Rigid3d> corrected_pose(const CameraPair& pair,
                                        const std::vector<Match>& matches) const {
    if (matches.size() < kMinMatches) return std::nullopt;
    auto pose = fit_relative_pose(rays_of(matches), {pair.b_from_a});
    if (!pose) return std::nullopt;
    std::vector<double> lengths;
    std::size_t agreeing = 0;
    for (const Match& match : matches) {
      if (std::abs(sampson_error_px(match.rays, *pose)) >
          2 * options_[pair.b].max_epipolar_error_px)
        continue;
      ++agreeing;
      if (const auto depth = ray_depth(match.rays.ray_a, match.rays.ray_b, *pose))
        lengths.push_back(match.depth_m / *depth);
    }
    if (agreeing < kMinMatches || 3 * agreeing < matches.size()) return std::nullopt;
    double length = pair.b_from_a.translation().norm();
    if (lengths.size() >= kMinMatches) {
      std::ranges::nth_element(lengths, lengths.begin() + lengths.size() / 2);
      if (lengths[lengths.size() / 2] > 0.05) length = lengths[lengths.size() / 2];
    }
    pose->translation() *= length;
    const Rigid3d correction = *pose * pair.b_from_a.inverse();
    if (Eigen::AngleAxisd(correction.linear()).angle() > kMaxCorrection_rad ||
        (pose->translation() - pair.b_from_a.translation()).norm() > kMaxCorrection_m)
      return std::nullopt;
    return pose;
  }

  void attach(const CameraPair& pair, std::vector<Match> matches) {
    const auto pose = fit_relative_pose(rays_of(matches), {pair.b_from_a});
    if (!pose) return;
    std::erase_if(matches, [&](const Match& match) {
      return std::abs(sampson_error_px(match.rays, *pose)) > options_[pair.b].max_epipolar_error_px;
    });
    std::vector<std::vector<const Match*>> of_track(of_camera_[pair.a].size());
    for (const Match& match : matches) of_track[match.track].push_back(&match);
    for (std::size_t t = 0; t < of_track.size(); ++t) {
      if (of_track[t].size() < 2)
        continue;  // a single match may lie anywhere along its epipolar line
      Eigen::Vector2d middle;
      for (int d = 0; d < 2; ++d) {
        std::vector<double> values;
        for (const Match* match : of_track[t]) values.push_back(match->from_guess[d]);
        std::ranges::nth_element(values, values.begin() + values.size() / 2);
        middle[d] = values[values.size() / 2];
      }
      std::vector<Observation> added;
      for (const Match* match : of_track[t])
        if ((match->from_guess - middle).norm() <= kApart_px)
          added.push_back({pair.b, match->frame, match->fit.pixel, match->fit.sigma_px});
      if (added.size() < 2) continue;
      auto& seen = of_camera_[pair.a][t].seen;
      seen.insert(seen.end(), added.begin(), added.end());
    }
  }

  const RigImages& images_;
  const std::vector<TrackOptions>& options_;
  ThreadPool& pool_;
  std::vector<std::vector<Track>>& of_camera_;
  std::vector<std::vector<std::vector<Source>>> sources_;  ///< [camera][frame]
};

}  // namespace

void match_across_cameras(const RigImages& images, const std::vector<TrackOptions>& options,
                          ThreadPool& pool, std::vector<std::vector<Track>>* of_camera) {
  CrossCameraMatcher(images, options, pool, of_camera).run();
}

}  // namespace redrive

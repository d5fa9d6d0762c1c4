// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/lidar/contrast.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include <opencv2/imgproc.hpp>

#include "redrive/base/opencv_threads.h"

namespace redrive {
namespace {

constexpr int kImages = 16;        // images of a camera, at most
constexpr double kMargin_s = 0.2;  // images this close to the ends are not used: the LiDAR passed
                                   // their scene before the drive began
constexpr double kClosest_m = 1, kFarthest_m = 50;
constexpr int kCell_px = 2;
// A return is visible where no other is nearer by 15 % within its block of pixels or the
// neighbouring ones, since LiDAR channels are further apart than pixels.
constexpr int kBlock_px = 6;
constexpr float kHidden = 1.15f;
constexpr double kAround_px =
    8;  // sd of the local mean that contrast is relative to, in LiDAR and image
constexpr double kLevel_px = 20;    // sd over which the image's contrast is normalised
constexpr float kMinAround = 0.1f;  // fraction of the surroundings with LiDAR returns
constexpr float kNoise = 1;         // grey levels: weaker contrast is not amplified
constexpr double kFine_px = 1.2;    // low-pass of the image
constexpr int kSteps = 20;          // steps of the search to each side
constexpr int kPeak = 4;            // steps to each side that a peak is fitted to
// Largest jackknife deviations over images. Along the road, features of LiDAR and image may differ
// by kMinAlong_m however many agree.
constexpr double kMaxSigma_s = 0.01, kMaxSigma_m = 0.15, kMinAlong_m = 0.03;
constexpr double kMinSpeed_m_per_s = 1;
// Number of jackknife sigmas by which the peak has to exceed everything further away: rails and
// dashes are periodic.
constexpr double kSignificant = 3;
constexpr int kFurther = 8;                 // steps
constexpr double kMinLidarContrast = 0.02;  // RMS of log intensity: less is rounding
constexpr int kMinCells = 500;
constexpr int kMinOnPath = 5;  // cells along a path with returns

cv::Mat blurred(const cv::Mat& image, double sd) {
  cv::Mat out;
  cv::GaussianBlur(image, out, {}, sd);
  return out;
}

/// Contrast of an image relative to its surroundings, normalised to about 1.
cv::Mat contrast_of(const cv::Mat& grey) {
  cv::Mat image, strength;
  grey.convertTo(image, CV_32F);
  cv::Mat contrast = blurred(image, kFine_px) - blurred(image, kAround_px);
  cv::sqrt(blurred(contrast.mul(contrast), kLevel_px), strength);
  return contrast / (strength + kNoise);
}

/// Bilinear interpolation; nothing outside the image.
std::optional<double> sample(const cv::Mat& image, const Eigen::Vector2d& at) {
  const int x = static_cast<int>(std::floor(at.x())), y = static_cast<int>(std::floor(at.y()));
  if (!(x >= 0 && y >= 0 && x + 1 < image.cols && y + 1 < image.rows)) return std::nullopt;
  const double u = at.x() - x, v = at.y() - y;
  const float* upper = image.ptr<float>(y) + x;
  const float* lower = image.ptr<float>(y + 1) + x;
  return (1 - v) * (upper[0] + u * (upper[1] - upper[0])) +
         v * (lower[0] + u * (lower[1] - lower[0]));
}

struct Hit {
  int sample = 0;
  int x = 0, y = 0;
  float distance_m = 0;
};

/// Returns the returns in view of the camera that no nearer one occludes.
std::vector<Hit> visible(const Camera& camera, const Rigid3d& camera_from_world,
                         const cv::Mat& usable, const std::vector<Eigen::Vector3f>& in_world) {
  const int across = usable.cols / kBlock_px + 1, down = usable.rows / kBlock_px + 1;
  std::vector<float> nearest_m(static_cast<std::size_t>(across) * static_cast<std::size_t>(down),
                               1e9f);
  const auto block = [&](int x, int y) -> float& {
    return nearest_m[static_cast<std::size_t>(y) * static_cast<std::size_t>(across) +
                     static_cast<std::size_t>(x)];
  };
  const Eigen::Vector3f at = camera_from_world.inverse(Eigen::Isometry).translation().cast<float>();
  std::vector<Hit> hits;
  for (std::size_t i = 0; i < in_world.size(); ++i) {
    const float distance_m = (in_world[i] - at).norm();
    if (!(distance_m >= kClosest_m && distance_m <= kFarthest_m)) continue;
    const auto pixel = camera.project(camera_from_world * in_world[i].cast<double>());
    if (!pixel) continue;
    const int x = static_cast<int>(std::lround(pixel->x())),
              y = static_cast<int>(std::lround(pixel->y()));
    if (x < 0 || y < 0 || x >= usable.cols || y >= usable.rows ||
        usable.at<std::uint8_t>(y, x) == 0)
      continue;
    hits.push_back({static_cast<int>(i), x, y, distance_m});
    for (int by = std::max(0, y / kBlock_px - 1); by <= std::min(down - 1, y / kBlock_px + 1); ++by)
      for (int bx = std::max(0, x / kBlock_px - 1); bx <= std::min(across - 1, x / kBlock_px + 1);
           ++bx)
        block(bx, by) = std::min(block(bx, by), distance_m);
  }
  std::erase_if(hits, [&](const Hit& hit) {
    return hit.distance_m > kHidden * block(hit.x / kBlock_px, hit.y / kBlock_px);
  });
  return hits;
}

/// The path of a static point over the image as the camera passes: a parabola through three of its
/// positions.
struct Path {
  Eigen::Vector2d now, slope, bend;
  Eigen::Vector2d at(int k) const {  ///< the position k - kSteps steps later
    const double t = static_cast<double>(k - kSteps) / kSteps;
    return now + t * slope + t * t * bend;
  }
  void shift(double later_s) {
    const double t = later_s / (kSteps * kContrastStep_s);
    now += t * (slope + t * bend);
    slope += 2 * t * bend;
  }
};

/// camera_from_world at both ends of the search and in its middle.
std::array<Rigid3d, 3> poses_around(const RigModel& model, int camera, int frame) {
  std::array<Rigid3d, 3> poses;
  for (int k = 0; k < 3; ++k)
    poses[k] = model.world_from_camera(camera, frame, (k - 1) * kSteps * kContrastStep_s)
                   .inverse(Eigen::Isometry);
  return poses;
}

std::optional<Path> path_of(const Camera& camera, const std::array<Rigid3d, 3>& poses,
                            const Eigen::Vector3d& point) {
  const auto before = camera.project(poses[0] * point), now = camera.project(poses[1] * point),
             after = camera.project(poses[2] * point);
  if (!before || !now || !after) return std::nullopt;
  return Path{*now, 0.5 * (*after - *before), 0.5 * (*after + *before) - *now};
}

/// Products of both contrasts, one for each time offset.
struct Sums {
  int cells = 0;  ///< compared
  std::array<double, 2 * kSteps + 1> product{}, lidar{}, image{};
  void add(const Sums& other, double factor) {
    cells += other.cells;
    for (int k = 0; k <= 2 * kSteps; ++k) {
      product[k] += factor * other.product[k];
      lidar[k] += factor * other.lidar[k];
      image[k] += factor * other.image[k];
    }
  }
  std::vector<double> correlation() const {
    std::vector<double> all;
    for (int k = 0; k <= 2 * kSteps; ++k)
      all.push_back(lidar[k] > 0 && image[k] > 0 ? product[k] / std::sqrt(lidar[k] * image[k]) : 0);
    return all;
  }
};

/// The time offset of the highest correlation: the vertex of a parabola fitted to the values around
/// it (least squares). Nothing close to an end.
std::optional<double> peak_s(const std::vector<double>& correlation) {
  const auto best = static_cast<int>(std::ranges::max_element(correlation) - correlation.begin());
  if (best < kPeak || best > 2 * kSteps - kPeak) return std::nullopt;
  // Against orthogonal polynomials x and x^2 - m2 at x = -kPeak..kPeak.
  double slope = 0, bend = 0, m2 = 0, m4 = 0;
  const double n = 2 * kPeak + 1;
  for (int x = -kPeak; x <= kPeak; ++x) m2 += x * x / n;
  for (int x = -kPeak; x <= kPeak; ++x) {
    m4 += (x * x - m2) * (x * x - m2) / n;
    slope += x * correlation[best + x] / n;
    bend += (x * x - m2) * correlation[best + x] / n;
  }
  slope /= m2;
  bend /= m4;
  if (!(bend < 0)) return std::nullopt;
  return kContrastStep_s *
         (best - kSteps + std::clamp(-0.5 * slope / bend, -1.0 * kPeak, 1.0 * kPeak));
}

/// Frames whose images are used, evenly chosen.
std::vector<int> frames_of(const RigModel& model, const RigImages& images, int camera) {
  const auto margin_ns = static_cast<std::int64_t>(kMargin_s * 1e9);
  std::vector<int> all, chosen;
  for (int f = 0; f < images.frames(); ++f)
    if (!images.grey[camera][f].empty() &&
        model.initial_frames[f].t_ns >= model.initial_frames.front().t_ns + margin_ns &&
        model.initial_frames[f].t_ns <= model.initial_frames.back().t_ns - margin_ns)
      all.push_back(f);
  const int count = static_cast<int>(all.size()), n = std::min(kImages, count);
  for (int i = 0; i < n; ++i) chosen.push_back(all[(2 * i + 1) * count / (2 * n)]);
  return chosen;
}

/// LiDAR intensities projected into a camera, in cells of kCell_px.
struct LidarImage {
  cv::Mat_<int> sample;  ///< index of the first sample in the cell, -1 where there is none
  cv::Mat_<float>
      contrast;  ///< log intensity minus the local mean; 0 where too few returns are around
  bool has(int x, int y) const {
    return x >= 0 && y >= 0 && x < sample.cols && y < sample.rows && sample(y, x) >= 0;
  }
};

LidarImage rasterize(const std::vector<Hit>& hits, const std::vector<LidarSample>& samples,
                     const cv::Size& image) {
  const cv::Size size((image.width + kCell_px - 1) / kCell_px,
                      (image.height + kCell_px - 1) / kCell_px);
  LidarImage out{cv::Mat_<int>(size, -1), cv::Mat_<float>(size, 0.0f)};
  cv::Mat_<float> sum(size, 0.0f), count(size, 0.0f);
  for (const Hit& hit : hits) {
    const int x = hit.x / kCell_px, y = hit.y / kCell_px;
    sum(y, x) += std::log1p(samples[hit.sample].intensity);
    count(y, x) += 1;
    if (out.sample(y, x) < 0) out.sample(y, x) = hit.sample;
  }
  cv::Mat_<float> there;
  cv::Mat(count > 0).convertTo(there, CV_32F, 1 / 255.0);
  const cv::Mat_<float> mean = sum / cv::max(count, 1);
  const cv::Mat_<float> around = blurred(mean, kAround_px / kCell_px),
                        seen = blurred(there, kAround_px / kCell_px);
  for (int y = 0; y < size.height; ++y)
    for (int x = 0; x < size.width; ++x)
      if (out.sample(y, x) >= 0 && seen(y, x) >= kMinAround)
        out.contrast(y, x) = mean(y, x) - around(y, x) / seen(y, x);
      else
        out.sample(y, x) = -1;
  return out;
}

/// Contrast of the LiDAR at `cell` relative to its mean along the path over the image: features
/// that are constant along the road, such as guard rails, carry no information on time. Returns
/// nothing where too few cells of the path have returns.
std::optional<double> against_path(const LidarImage& lidar, const cv::Point& cell,
                                   const Path& path) {
  double sum = 0;
  int cells = 0;
  for (int k = 0; k <= 2 * kSteps; ++k) {
    const Eigen::Vector2d at = (path.at(k) / kCell_px).array().floor();
    const int x = static_cast<int>(at.x()), y = static_cast<int>(at.y());
    if (!lidar.has(x, y)) continue;
    sum += lidar.contrast(y, x);
    ++cells;
  }
  if (cells < kMinOnPath) return std::nullopt;
  return lidar.contrast(cell) - sum / cells;
}

Sums compare(const RigModel& model, const ContrastData& source,
             const std::vector<Eigen::Vector3f>& in_world, int camera, int frame) {
  const RigImages& images = source.images;
  const cv::Mat& grey = images.grey[camera][frame];
  const Camera& lens = images.camera(camera);
  const std::array<Rigid3d, 3> poses = poses_around(model, camera, frame);
  const LidarImage lidar = rasterize(
      visible(lens, poses[1], images.usable[camera][frame], in_world), source.samples, grey.size());
  const cv::Mat image = contrast_of(grey);
  const auto moving = images.moving_at(camera, frame);
  Sums sums;
  for (int y = 0; y < lidar.sample.rows; ++y)
    for (int x = 0; x < lidar.sample.cols; ++x) {
      if (!lidar.has(x, y)) continue;
      if (!images.may_be_static(camera, frame, {kCell_px * x + 0.5, kCell_px * y + 0.5}, moving))
        continue;
      auto path = path_of(lens, poses, in_world[lidar.sample(y, x)].cast<double>());
      if (!path) continue;
      const RigModelCamera& of = model.cameras[camera];
      path->shift(of.from_middle_line(images.recorded_pixel(camera, path->now)) * of.readout_s);
      const auto contrast = against_path(lidar, {x, y}, *path);
      if (!contrast) continue;
      ++sums.cells;
      std::array<std::optional<double>, 2 * kSteps + 1> values;
      double mean = 0;
      int inside = 0;
      for (int k = 0; k <= 2 * kSteps; ++k)
        if ((values[k] = sample(image, path->at(k)))) mean += *values[k], ++inside;
      for (int k = 0; k <= 2 * kSteps; ++k) {
        if (!values[k]) continue;
        const double value = *values[k] - mean / inside;  // relative to its path as well
        sums.product[k] += *contrast * value;
        sums.lidar[k] += *contrast * *contrast;
        sums.image[k] += value * value;
      }
    }
  return sums;
}

/// Returns the margin by which the peak exceeds all values further away.
double prominence(const std::vector<double>& correlation) {
  const auto best = std::ranges::max_element(correlation);
  double other = 0;
  for (auto at = correlation.begin(); at != correlation.end(); ++at)
    if (std::abs(at - best) > kFurther) other = std::max(other, *at);
  return *best - other;
}

ContrastFit fit_time_offset(const std::vector<Sums>& of_image, double offset_s,
                            double speed_m_per_s) {
  ContrastFit fit;
  Sums all;
  for (const Sums& sums : of_image) all.add(sums, 1);
  fit.cells = all.cells;
  fit.correlation = all.correlation();
  const auto peak = peak_s(fit.correlation);
  if (fit.cells < kMinCells || !peak) return fit;
  // Jackknife: the change of the peak when an image is left out (Efron & Stein 1981).
  double squares = 0, prominence_squares = 0;
  const double n = static_cast<double>(of_image.size()), stands_out = prominence(fit.correlation);
  for (const Sums& sums : of_image) {
    Sums others = all;
    others.add(sums, -1);
    const std::vector<double> correlation = others.correlation();
    const auto without = peak_s(correlation);
    if (!without) return fit;
    squares += (*without - *peak) * (*without - *peak);
    prominence_squares += std::pow(prominence(correlation) - stands_out, 2);
  }
  const double sigma_s = std::sqrt(squares * (n - 1) / n),
               prominence_sigma = std::sqrt(prominence_squares * (n - 1) / n);
  if (stands_out < kSignificant * prominence_sigma ||
      all.lidar[kSteps] < all.cells * kMinLidarContrast * kMinLidarContrast)
    return fit;
  if (sigma_s > kMaxSigma_s || sigma_s * speed_m_per_s > kMaxSigma_m ||
      speed_m_per_s < kMinSpeed_m_per_s)
    return fit;
  fit.observable = true;
  fit.offset_s = offset_s + *peak;
  fit.sigma_s = std::hypot(sigma_s, kMinAlong_m / speed_m_per_s);
  return fit;
}

}  // namespace

std::vector<ContrastFit> fit_time_offsets(const RigModel& model, const ContrastData& source,
                                          ThreadPool& pool) {
  std::vector<Eigen::Vector3f> in_world(source.samples.size());
  transform_samples(model, source.samples, pool, [&](std::size_t i, const Eigen::Vector3d& point) {
    in_world[i] = point.cast<float>();
  });
  const int cameras = source.images.cameras();
  std::vector<std::vector<int>> frames;
  std::vector<std::vector<Sums>> sums(cameras);
  std::vector<std::pair<int, int>> jobs;  // camera, which of its frames
  for (int c = 0; c < cameras; ++c) {
    frames.push_back(frames_of(model, source.images, c));
    sums[c].resize(frames[c].size());
    for (std::size_t i = 0; i < frames[c].size(); ++i) jobs.emplace_back(c, i);
  }
  pool.run(static_cast<int>(jobs.size()), [&](int j) {
    const auto [c, i] = jobs[j];
    sums[c][i] = compare(model, source, in_world, c, frames[c][i]);
  });
  std::vector<ContrastFit> fits;
  for (int c = 0; c < cameras; ++c) {
    double speed_m_per_s = 0;
    for (const int frame : frames[c]) speed_m_per_s += model.image_motion(c, frame).velocity.norm();
    fits.push_back(
        fit_time_offset(sums[c], model.cameras[c].offset_s,
                        speed_m_per_s / std::max(1.0, static_cast<double>(frames[c].size()))));
  }
  return fits;
}

}  // namespace redrive

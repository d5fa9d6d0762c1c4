// SPDX-License-Identifier: Apache-2.0
#include "redrive/report/lidar_images.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>

#include <opencv2/imgproc.hpp>

#include "redrive/base/opencv_threads.h"
#include "redrive/eval/lidar_score.h"
#include "redrive/recording/lidar/lost_rays.h"
#include "redrive/render/lidar_scan.h"
#include "redrive/render/recorded_lidar.h"

namespace redrive {
namespace {

constexpr int kWidth_px = 1080, kHeight_px = 192, kAbove_px = 560;
constexpr double kAbove_m = 60;               // from the sensor to the edge
constexpr double kNear_m = 2, kFar_m = 100;   // first and last colour
constexpr double kLow_m = -2.5, kHigh_m = 5;  // likewise, from above
constexpr std::uint8_t kNothing = 40;         // grey of what has no return

/// Paints Turbo's colours at pixels, from 0 to 1.
class Canvas {
 public:
  Canvas(int width, int height)
      : levels_(height, width, CV_8UC1, cv::Scalar(0)), painted_(levels_.clone()) {}

  void paint(int x, int y, double unit) {
    if (x < 0 || y < 0 || x >= levels_.cols || y >= levels_.rows) return;
    levels_.at<std::uint8_t>(y, x) =
        static_cast<std::uint8_t>(std::lround(255 * std::clamp(unit, 0.0, 1.0)));
    painted_.at<std::uint8_t>(y, x) = 1;
  }
  Image8 image() const {
    cv::Mat colours;
    cv::applyColorMap(levels_, colours, cv::COLORMAP_TURBO);  // BGR
    const std::size_t pixels = levels_.total();
    Image8 out{levels_.cols, levels_.rows, std::vector<std::uint8_t>(3 * pixels, kNothing)};
    for (std::size_t i = 0; i < pixels; ++i)
      for (std::size_t c = 0; c < 3; ++c)
        if (painted_.data[i]) out.rgb[3 * i + c] = colours.data[3 * i + 2 - c];
    return out;
  }

 private:
  cv::Mat levels_, painted_;
};

/// A scan, points in the sensor's axes.
using Points = std::vector<LidarRecord>;

double elevation_of(const Eigen::Vector3d& in_sensor) {
  return std::atan2(in_sensor.z(), in_sensor.head<2>().norm());
}

/// The rays of a scan as cells of an image.
struct RangeImage {
  std::vector<double> elevations_rad;  ///< elevations of rows, from the lowest
  int columns = kWidth_px;
};

/// Paints points where they are seen, the heading in the middle.
Image8 seen_image(const Points& points, const RangeImage& cells,
                  const std::function<double(const LidarRecord&)>& unit) {
  const std::vector<double>& elevations_rad = cells.elevations_rad;
  const auto rows = static_cast<int>(elevations_rad.size());
  const int wide = std::max(kWidth_px / cells.columns, 1), high = std::max(kHeight_px / rows, 2);
  Canvas canvas(wide * cells.columns, high * rows);
  for (const LidarRecord& point : points) {
    const Eigen::Vector3d& p = point.position_m;
    const double elevation_rad = elevation_of(p);
    auto above = std::ranges::lower_bound(elevations_rad, elevation_rad);
    if (above == elevations_rad.end() ||
        (above != elevations_rad.begin() && elevation_rad - above[-1] < *above - elevation_rad))
      --above;
    const auto beam = static_cast<int>(above - elevations_rad.begin());
    const double turn = std::atan2(p.y(), p.x()) / (2 * std::numbers::pi);
    const int column = static_cast<int>((0.5 - turn) * cells.columns);
    for (int x = 0; x < wide; ++x)
      for (int y = 0; y < high; ++y)
        canvas.paint(wide * column + x, high * (rows - 1 - beam) + y, unit(point));
  }
  return canvas.image();
}

/// Paints points from above by their height, the heading upwards.
Image8 image_from_above(const Points& points) {
  Canvas canvas(kAbove_px, kAbove_px);
  for (const LidarRecord& point : points) {
    const auto pixel = [](double from_edge_m) {
      return static_cast<int>(std::floor(from_edge_m / (2 * kAbove_m) * kAbove_px));
    };
    canvas.paint(pixel(kAbove_m - point.position_m.y()), pixel(kAbove_m - point.position_m.x()),
                 (point.position_m.z() - kLow_m) / (kHigh_m - kLow_m));
  }
  return canvas.image();
}

double range_colour(const LidarRecord& point) {
  return std::log(point.position_m.norm() / kNear_m) / std::log(kFar_m / kNear_m);
}

/// Dark surfaces have a few percent.
double intensity_colour(const LidarRecord& point) { return std::sqrt(point.intensity); }

Points recorded_points(const std::vector<LidarPoint>& scan, const Rigid3d& body_from_lidar) {
  const Rigid3d lidar_from_body = body_from_lidar.inverse(Eigen::Isometry);
  const float full = intensity_scale(std::ranges::max(scan, {}, &LidarPoint::intensity).intensity);
  Points points;
  for (const LidarPoint& point : scan)
    points.push_back({lidar_from_body * point.in_body_m.cast<double>(), point.t_ns,
                      static_cast<float>(point.intensity) / full});
  return points;
}

/// Adds the rays without a return.
void add_lost(const LostRays& lost, LidarFirings* firings) {
  for (std::size_t i = 0; i < lost.size(); ++i) {
    firings->direction.push_back(lost.direction[i].cast<double>());
    firings->t_ns.push_back(lost.t_ns[i]);
    firings->ring.push_back(kNoRing);
  }
}

/// Returns a row for each beam and a column for each step, or, where these are unknown, even ones.
RangeImage range_image(const std::optional<ScanStructure>& structure, const Points& points) {
  constexpr int kRows = 64;
  RangeImage out;
  if (structure) {
    for (const LidarBeam& beam : structure->sensor.beams)
      out.elevations_rad.push_back(beam.elevation_rad);
    if (const int steps = structure->sensor.azimuth_steps; steps > 0)
      out.columns = std::min(steps, kWidth_px);
    return out;
  }
  std::vector<double> seen;
  for (const LidarRecord& point : points) seen.push_back(elevation_of(point.position_m));
  const auto [low, high] = std::ranges::minmax(seen);
  for (int i = 0; i < kRows; ++i)
    out.elevations_rad.push_back(low + (high - low) * i / (kRows - 1));
  return out;
}

}  // namespace

std::vector<ImageRow> lidar_image_rows(const Run& run, kernels::Backend& backend) {
  const std::vector<std::int64_t> frames = held_out_revolutions(run);
  if (frames.empty()) return {};
  const std::int64_t id = frames[frames.size() / 2];
  const auto file = std::ranges::find(run.recording.lidar_files, id, &FrameFile::frame_id);
  if (file == run.recording.lidar_files.end()) return {};
  auto firings = recorded_firings(run.recording, run.scene, id, backend.pool(), file->lidar);
  if (!firings) return {};
  const RecordedLidar& lidar = run.recording.lidars[file->lidar];
  const Rigid3d& body_from_lidar = lidar.body_from_lidar;
  const std::vector<LidarPoint> scan = run.recording.read_lidar(*file);
  std::string why;
  const auto structure = recorded_structure(run.recording, &why, file->lidar);
  if (structure) add_lost(lost_rays(scan, body_from_lidar, *structure), &*firings);
  const Points recorded = recorded_points(scan, body_from_lidar);
  const LidarScan rendered =
      render_scan(backend, *run.field(), *firings, {run.scene, body_from_lidar},
                  {.gain = static_cast<float>(lidar.gain),
                   .beam_gains = lidar.beam_gains,
                   .blind = lidar.blind});

  const RangeImage cells = range_image(structure, recorded);
  const std::string title = "LiDAR, frame " + std::to_string(id) + ", held out: ";
  std::vector<ImageRow> out;
  const auto add = [&](const char* name, const std::string& what, const auto& image) {
    out.push_back(
        {title + what,
         {{std::string("lidar_") + name + "_recorded", "recorded", image(recorded)},
          {std::string("lidar_") + name + "_rendered", "rendered", image(rendered.points)}}});
  };
  add("range", "range, 2 m (blue) to 100 m (red), logarithmic; grey: no return",
      [&](const Points& points) { return seen_image(points, cells, range_colour); });
  if (rendered.has_intensity)
    add("intensity", "intensity, 0 (blue) to 1 (red), by its root",
        [&](const Points& points) { return seen_image(points, cells, intensity_colour); });
  add("above", "from above, 120 m, by height", image_from_above);
  return out;
}

}  // namespace redrive

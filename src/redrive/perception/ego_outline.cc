// SPDX-License-Identifier: Apache-2.0
#include "redrive/perception/ego_outline.h"

#include <opencv2/imgproc.hpp>

#include "redrive/base/error.h"
#include "redrive/base/opencv_threads.h"

namespace redrive {
namespace {

constexpr std::size_t kMinViews = 8;
constexpr double kMinDriven_m = 5;
constexpr std::int64_t kMaxPair_ns =
    300'000'000;                     // images further apart share little of the near road
constexpr double kMaxGround_m = 40;  // along the ray; beyond, a pixel of road is metres long

// Costs of the outline, in units of pixels, tuned on a night drive with known outlines; doubling or
// halving each makes no difference.
constexpr float kCostWithoutEvidence = 0.01f, kCostGround = 0.3f, kGainStatic = 0.2f,
                kGainStructure = 20, kCostStep = 2;
constexpr float kForbidden = 1e4f;

/// Geometry of the pixels' rays.
struct PixelGeometry {
  cv::Mat flow_x, flow_y;  ///< unit direction of the optical flow, float; 0 where there is no ray
  cv::Mat candidate;       ///< uint8: 255 where the vehicle may be
  cv::Mat ground_in_body;  ///< float x 3, metres: intersection of the ray with z = 0; NaN beyond
                           ///< kMaxGround_m
};

bool intersects_vehicle_volume(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction) {
  const Eigen::Array3d low(-1.5, -1.2, 0.1), high(4.3, 1.2, 1.15);
  const Eigen::Array3d a = (low - origin.array()) / direction.array(),
                       b = (high - origin.array()) / direction.array();
  return direction.z() < 0 && b.max(a).minCoeff() > std::max(0.0, a.min(b).maxCoeff());
}

PixelGeometry pixel_geometry(const Camera& camera, const Rigid3d& body_from_sensor) {
  const cv::Size size(camera.width, camera.height);
  PixelGeometry geometry{cv::Mat::zeros(size, CV_32F), cv::Mat::zeros(size, CV_32F),
                         cv::Mat::zeros(size, CV_8U),
                         cv::Mat(size, CV_32FC3, cv::Scalar::all(NAN))};
  const Eigen::Vector3d forward_in_camera = body_from_sensor.linear().transpose().col(0);
  const Eigen::Vector3d origin = body_from_sensor.translation();
  for (int y = 0; y < size.height; ++y)
    for (int x = 0; x < size.width; ++x) {
      const auto direction = camera.unproject({x, y});
      if (!direction) continue;
      if (const auto shifted = camera.project(*direction - 1e-3 * forward_in_camera)) {
        const Eigen::Vector2d flow = *shifted - Eigen::Vector2d(x, y);
        if (flow.norm() > 1e-6) {
          geometry.flow_x.at<float>(y, x) = static_cast<float>(flow.x() / flow.norm());
          geometry.flow_y.at<float>(y, x) = static_cast<float>(flow.y() / flow.norm());
        }
      }
      const Eigen::Vector3d in_body = body_from_sensor.linear() * *direction;
      if (intersects_vehicle_volume(origin, in_body))
        geometry.candidate.at<std::uint8_t>(y, x) = 255;
      const double to_ground_m = -origin.z() / in_body.z();
      if (!(to_ground_m > 0 && to_ground_m < kMaxGround_m)) continue;
      const Eigen::Vector3d ground = origin + to_ground_m * in_body;
      geometry.ground_in_body.at<cv::Vec3f>(y, x) = {static_cast<float>(ground.x()),
                                                     static_cast<float>(ground.y()), 0};
    }
  return geometry;
}

/// Returns, 0..1, the confidence that a sharp edge across the flow is static.
cv::Mat static_structure(const std::vector<GreyView>& views, const PixelGeometry& geometry) {
  const cv::Size size = geometry.candidate.size();
  std::vector<cv::Mat> along_flow;
  cv::Mat across_flow = cv::Mat::zeros(size, CV_32F);  // mean
  for (const GreyView& view : views) {
    cv::Mat gradient_x, gradient_y;
    cv::Sobel(view.grey, gradient_x, CV_32F, 1, 0, 3, 1 / 8.0);
    cv::Sobel(view.grey, gradient_y, CV_32F, 0, 1, 3, 1 / 8.0);
    along_flow.push_back(gradient_x.mul(geometry.flow_x) + gradient_y.mul(geometry.flow_y));
    across_flow +=
        (gradient_y.mul(geometry.flow_x) - gradient_x.mul(geometry.flow_y)) / double(views.size());
  }
  cv::Mat strength = cv::Mat::zeros(size, CV_32F), confidence = strength.clone();
  std::vector<float> values(views.size());
  for (int y = 0; y < size.height; ++y)
    for (int x = 0; x < size.width; ++x) {
      double sum = 0, squares = 0;
      for (std::size_t i = 0; i < values.size(); ++i) {
        values[i] = along_flow[i].at<float>(y, x);
        sum += values[i];
        squares += double(values[i]) * values[i];
      }
      const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
      std::nth_element(values.begin(), middle, values.end());
      const double n = static_cast<double>(values.size()), mean = sum / n;
      // The median of n normal numbers has 1.25 times the standard error of their mean; 0.1: JPEG's
      // rounding.
      const double error = 1.25 * std::sqrt(std::max(0.0, squares / n - mean * mean) / n) + 0.1;
      strength.at<float>(y, x) = std::abs(*middle);
      // A steep line along the flow seems to cross it a little, by the error of a 3 x 3 gradient.
      if (std::abs(*middle) > std::max(1.0f, 0.2f * std::abs(across_flow.at<float>(y, x))))
        confidence.at<float>(y, x) =
            static_cast<float>(std::clamp((std::abs(*middle) / error - 5) / 10, 0.0, 1.0));
    }
  // Keeps only the crest of an edge: the gradient of light in front of a bonnet is static, too, but
  // has no edge.
  cv::Mat crest;
  cv::dilate(strength, crest, cv::Mat::ones(17, 1, CV_8U));
  confidence.setTo(0, strength < 0.7 * crest);
  // The border of the lens's image circle is a static edge, too.
  cv::Mat without_ray = (geometry.flow_x == 0) & (geometry.flow_y == 0);
  cv::rectangle(without_ray, cv::Rect({}, size), 255);  // no gradient at the border
  cv::dilate(without_ray, without_ray, cv::Mat::ones(3, 3, CV_8U));
  confidence.setTo(0, without_ray);
  return confidence;
}

struct GroundEvidence {
  cv::Mat moving;  ///< 0..1: how well the motion of the ground explains the image
  cv::Mat fixed;   ///< 0..1: how much better no motion explains it
};

GroundEvidence ground_evidence(const Camera& camera, const Rigid3d& body_from_sensor,
                               const std::vector<GreyView>& views, const PixelGeometry& geometry) {
  const cv::Size size = geometry.candidate.size();
  cv::Mat mean = cv::Mat::zeros(size, CV_32F);
  for (const GreyView& view : views) mean += view.grey / static_cast<double>(views.size());
  std::vector<cv::Mat> deviations;
  for (const GreyView& view : views) {
    cv::Mat deviation = view.grey - mean, coarse;
    cv::GaussianBlur(deviation, coarse, {}, 6);  // exposure and moving light
    deviation = cv::max(cv::min(deviation - coarse, 30), -30);
    cv::GaussianBlur(deviation, deviation, {}, 0.8);
    deviations.push_back(deviation);
  }
  cv::Mat products = cv::Mat::zeros(size, CV_32F), squares_here = products.clone(),
          squares_there = products.clone(), changes = products.clone(),
          changes_warped = products.clone(), pairs = products.clone();
  const Rigid3d sensor_from_body = body_from_sensor.inverse();
  cv::Mat u(size, CV_32F), v(size, CV_32F), there;
  for (std::size_t i = 0; i < views.size(); ++i)
    for (const std::size_t j : {i - 1, i + 1}) {  // 0 - 1 is no index
      if (j >= views.size() || std::abs(views[i].t_ns - views[j].t_ns) > kMaxPair_ns) continue;
      const Rigid3d sensor_from_body_i =
          sensor_from_body * views[j].world_from_body.inverse() * views[i].world_from_body;
      for (int y = 0; y < size.height; ++y)
        for (int x = 0; x < size.width; ++x) {
          u.at<float>(y, x) = v.at<float>(y, x) = -1;
          const cv::Vec3f ground = geometry.ground_in_body.at<cv::Vec3f>(y, x);
          if (std::isnan(ground[0]) || !geometry.candidate.at<std::uint8_t>(y, x)) continue;
          const auto pixel =
              camera.project(sensor_from_body_i * Eigen::Vector3d(ground[0], ground[1], ground[2]));
          if (!pixel || pixel->minCoeff() < 0 || pixel->x() > size.width - 1 ||
              pixel->y() > size.height - 1)
            continue;
          u.at<float>(y, x) = static_cast<float>(pixel->x());
          v.at<float>(y, x) = static_cast<float>(pixel->y());
        }
      cv::remap(deviations[j], there, u, v, cv::INTER_LINEAR, cv::BORDER_CONSTANT, 0);
      cv::Mat seen, here = deviations[i].clone(), staying = cv::abs(deviations[i] - deviations[j]);
      cv::Mat(u >= 0).convertTo(seen, CV_32F, 1 / 255.0);
      here = here.mul(seen);
      there = there.mul(seen);
      products += here.mul(there);
      squares_here += here.mul(here);
      squares_there += there.mul(there);
      changes += staying.mul(seen);
      changes_warped += cv::abs(here - there);
      pairs += seen;
    }
  for (cv::Mat* sum : {&products, &squares_here, &squares_there, &changes, &changes_warped})
    cv::boxFilter(*sum, *sum, -1, {5, 5});
  GroundEvidence evidence{cv::Mat::zeros(size, CV_32F), cv::Mat::zeros(size, CV_32F)};
  int candidates = 0, seen_moving = 0;
  for (int y = 0; y < size.height; ++y)
    for (int x = 0; x < size.width; ++x) {
      candidates += geometry.candidate.at<std::uint8_t>(y, x) != 0;
      if (pairs.at<float>(y, x) < 5) continue;
      const double correlation =
          products.at<float>(y, x) /
          std::sqrt(double(squares_here.at<float>(y, x)) * squares_there.at<float>(y, x) + 1e-3);
      const double gain =
          std::log((changes.at<float>(y, x) + 0.1) / (changes_warped.at<float>(y, x) + 0.1));
      seen_moving += gain > 0.3;
      // Reflections of the road correlate in places, but no motion predicts them better by far.
      if (gain > -0.7)
        evidence.moving.at<float>(y, x) =
            static_cast<float>(std::clamp((correlation - 0.1) / 0.4, 0.0, 1.0));
      evidence.fixed.at<float>(y, x) =
          static_cast<float>(std::clamp((-0.2 - gain) / 0.5, 0.0, 1.0));
    }
  // Lack of motion is evidence only where the motion of the road is visible: by day 60 to 90 % of
  // the candidates move, at night, with noise and the car's own light, less than 30 %.
  const double share = candidates > 0 ? double(seen_moving) / candidates : 0;
  evidence.fixed *= std::clamp((share - 0.3) / 0.2, 0.0, 1.0);
  return evidence;
}

/// Returns the rows b(x) that minimise the sum over x of cost(b(x), x) + kCostStep |b(x) - b(x -
/// 1)|. cost: [height + 1, width].
std::vector<int> cheapest_path(const cv::Mat& cost) {
  const int rows = cost.rows, columns = cost.cols;
  std::vector<float> total(static_cast<std::size_t>(rows));
  cv::Mat from(rows, columns, CV_32S);
  for (int r = 0; r < rows; ++r) total[r] = cost.at<float>(r, 0);
  for (int x = 1; x < columns; ++x) {
    std::vector<float> reach = total;
    for (int r = 0; r < rows; ++r) from.at<int>(r, x) = r;
    const auto step = [&](int r, int neighbour) {
      if (reach[neighbour] + kCostStep < reach[r]) {
        reach[r] = reach[neighbour] + kCostStep;
        from.at<int>(r, x) = from.at<int>(neighbour, x);
      }
    };
    for (int r = 1; r < rows; ++r) step(r, r - 1);
    for (int r = rows - 2; r >= 0; --r) step(r, r + 1);
    for (int r = 0; r < rows; ++r) total[r] = reach[r] + cost.at<float>(r, x);
  }
  std::vector<int> path(static_cast<std::size_t>(columns));
  path[columns - 1] =
      static_cast<int>(std::min_element(total.begin(), total.end()) - total.begin());
  for (int x = columns - 1; x > 0; --x) path[x - 1] = from.at<int>(path[x], x);
  return path;
}

}  // namespace

std::vector<int> find_ego_outline(const Camera& camera, const Rigid3d& body_from_sensor,
                                  const std::vector<GreyView>& views) {
  double path_length_m = 0;
  for (std::size_t i = 1; i < views.size(); ++i)
    path_length_m +=
        (views[i].world_from_body.translation() - views[i - 1].world_from_body.translation())
            .norm();
  if (views.size() < kMinViews || path_length_m < kMinDriven_m)
    return std::vector<int>(static_cast<std::size_t>(camera.width), camera.height);
  for (const GreyView& view : views) {
    REDRIVE_CHECK_OP(view.grey.cols, ==, camera.width);
    REDRIVE_CHECK_OP(view.grey.rows, ==, camera.height);
  }
  const PixelGeometry geometry = pixel_geometry(camera, body_from_sensor);
  const cv::Mat structure = static_structure(views, geometry);
  const GroundEvidence ground = ground_evidence(camera, body_from_sensor, views, geometry);

  // Cost of an outline at a row: the sum over all pixels from there on down.
  cv::Mat cost = cv::Mat::zeros(camera.height + 1, camera.width, CV_32F);
  for (int x = 0; x < camera.width; ++x) {
    bool below_candidate = false;  // pixels without a ray at the lower edge do not end the vehicle
    std::vector<float> of_pixel(static_cast<std::size_t>(camera.height), kForbidden);
    for (int y = 0; y < camera.height; ++y) {
      below_candidate = below_candidate || geometry.candidate.at<std::uint8_t>(y, x);
      if (!below_candidate) continue;
      const float road = ground.moving.at<float>(y, x), standing = ground.fixed.at<float>(y, x);
      const float edge = geometry.candidate.at<std::uint8_t>(y, x) ? structure.at<float>(y, x) : 0;
      of_pixel[y] = kCostWithoutEvidence + kCostGround * road - kGainStatic * standing -
                    kGainStructure * edge * (1 - road);
    }
    for (int y = camera.height - 1; y >= 0; --y)
      cost.at<float>(y, x) = cost.at<float>(y + 1, x) + of_pixel[y];
  }
  return cheapest_path(cost);
}

}  // namespace redrive

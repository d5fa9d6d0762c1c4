// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/ncore/ncore_scan.h"

#include <cmath>
#include <cstdlib>

#include "redrive/base/error.h"
#include "redrive/recording/lidar/unusable_returns.h"

namespace redrive::ncore {
namespace {

constexpr double kMaxRange_m = 1000, kMostIntensity = 1.001;
constexpr double kUnitTolerance = 1e-3;
constexpr double kMostApart_us = 1e6;  // a ray's time from the end of its scan

/// An array with the length of the rays behind the dimensions before it.
std::vector<double> array_of(const Contents::Scan& scan, const std::string& name,
                             std::size_t before, std::size_t rays, std::size_t after) {
  ZarrReader::Numbers numbers = scan.store->numbers(scan.group + "/" + name);
  std::string shape;
  for (const std::size_t size : numbers.shape)
    shape += (shape.empty() ? "" : " x ") + std::to_string(size);
  std::vector<std::size_t> expected;
  if (before > 0) expected.push_back(before);
  expected.push_back(rays);
  if (after > 0) expected.push_back(after);
  if (numbers.shape != expected)
    throw InputError(scan.store->path(), scan.group + "/" + name, shape,
                     "must have " + std::to_string(rays) + " rays");
  return std::move(numbers.values);
}

std::uint64_t count_in(const Contents::Scan& scan, const char* group, const char* attribute) {
  try {
    const nlohmann::json attributes = scan.store->attributes(scan.group + "/" + group);
    const std::int64_t count = JsonField(attributes, scan.store->path()).at(attribute).integer();
    return count < 0 ? 0 : static_cast<std::uint64_t>(count);
  } catch (const InputError&) {  // named when the scan is read
    return 0;
  }
}

}  // namespace

std::uint64_t ray_count(const Contents::Scan& scan) {
  return count_in(scan, "ray_bundle", "n_rays");
}
std::uint64_t return_count(const Contents::Scan& scan) {
  return count_in(scan, "ray_bundle_returns", "n_returns");
}

std::vector<LidarPoint> read_scan(const Contents::Scan& scan, const Rigid3d& body_from_lidar,
                                  std::size_t* left_out) {
  const std::string returns = "ray_bundle_returns/", bundle = "ray_bundle/";
  const std::size_t n = ray_count(scan), echoes = return_count(scan);
  const auto says = [&](const char* group, const char* attribute) {
    return scan.store->attributes(scan.group + "/" + group).contains(attribute);
  };
  if (n == 0 && says("ray_bundle", "n_rays")) return {};
  if (n == 0 || echoes == 0)
    throw InputError(scan.store->path(), scan.group, "", "does not say its rays and returns");
  const std::vector<double> directions = array_of(scan, bundle + "direction", 0, n, 3),
                            times_us = array_of(scan, bundle + "timestamp_us", 0, n, 0),
                            ranges_m = array_of(scan, returns + "distance_m", echoes, n, 0);
  std::vector<double> intensities, elements;
  if (scan.store->has_array(scan.group + "/" + returns + "intensity"))
    intensities = array_of(scan, returns + "intensity", echoes, n, 0);
  if (scan.store->has_array(scan.group + "/" + bundle + "model_element"))
    elements = array_of(scan, bundle + "model_element", 0, n, 2);
  UnusableReturns unusable(n);
  std::vector<LidarPoint> points;
  points.reserve(n);
  for (std::size_t i = 0; i < n; ++i) {
    std::size_t k = i;  // index of the first return
    while (k < ranges_m.size() && std::isnan(ranges_m[k])) k += n;
    if (k >= ranges_m.size()) continue;  // a lost ray
    const Eigen::Vector3d direction(directions[3 * i], directions[3 * i + 1],
                                    directions[3 * i + 2]);
    const double intensity = intensities.empty() || std::isnan(intensities[k]) ? 0 : intensities[k];
    const auto refuse = [&](const std::string& name, double value, const char* rule) {
      unusable.add_impossible(InputError(scan.store->path(),
                                         scan.group + "/" + name + " of ray " + std::to_string(i),
                                         std::to_string(value), rule));
    };
    if (!(std::abs(direction.norm() - 1) <= kUnitTolerance)) {
      refuse(bundle + "direction", direction.norm(), "must have length 1");
    } else if (!(ranges_m[k] >= 0 && ranges_m[k] <= kMaxRange_m)) {
      refuse(returns + "distance_m", ranges_m[k], "0 to 1000 m");
    } else if (!(intensity >= 0 && intensity <= kMostIntensity)) {
      refuse(returns + "intensity", intensity, "0 to 1");
    } else if (!(std::abs(times_us[i] - static_cast<double>(scan.end_us)) <= kMostApart_us)) {
      refuse(bundle + "timestamp_us", times_us[i], "must be within a second of the scan's end");
    } else if (ranges_m[k] == 0) {
      unusable.add_missing();
    } else {
      LidarPoint point;
      point.in_body_m = (body_from_lidar * (ranges_m[k] * direction)).cast<float>();
      point.intensity = intensity_in_16_bits(static_cast<float>(intensity));
      if (!elements.empty() && elements[2 * i] >= 0 && elements[2 * i] < kNoRing)
        point.ring = static_cast<std::uint8_t>(elements[2 * i]);
      point.t_ns = 1000 * static_cast<std::int64_t>(times_us[i]);
      points.push_back(point);
    }
  }
  if (left_out) *left_out += unusable.count();
  return points;
}

}  // namespace redrive::ncore

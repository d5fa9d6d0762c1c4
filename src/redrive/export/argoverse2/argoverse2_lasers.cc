// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/argoverse2/argoverse2_lasers.h"

#include <algorithm>
#include <string>

#include "redrive/base/error.h"
#include "redrive/recording/formats/argoverse2/argoverse2_scan.h"
#include "redrive/recording/lidar/scan_structure.h"
#include "redrive/render/recorded_lidar.h"

namespace redrive::argoverse2 {
namespace {

constexpr int kLasers = 2 * kLasersOfLidar;

bool knows_rings(const Recording& drive, std::size_t lidar) {
  try {
    return has_rings(drive.read_lidar(drive.scans_of(lidar).front()));
  } catch (const InputError&) {  // named where all scans are read
    return false;
  }
}

}  // namespace

std::vector<std::uint8_t> LasersOfLidar::numbers(const Recording& drive,
                                                 const std::vector<LidarPoint>& points) const {
  std::vector<std::uint8_t> numbers(points.size(), static_cast<std::uint8_t>(first));
  if (!sensor) {
    for (std::size_t i = 0; i < points.size(); ++i)
      if (points[i].ring < count) numbers[i] = static_cast<std::uint8_t>(first + points[i].ring);
    return numbers;
  }
  const std::vector<std::uint8_t> beams =
      beams_of(points, drive.lidars[lidar].body_from_lidar, *sensor);
  const int shared = std::max(count, static_cast<int>(sensor->beams.size()));
  for (std::size_t i = 0; i < points.size(); ++i)
    if (beams[i] != kNoRing)
      numbers[i] = static_cast<std::uint8_t>(
          first + (shared > count ? beams[i] * count / shared : beams[i]));
  return numbers;
}

std::vector<LasersOfLidar> assign_lasers(const Recording& drive, DriveNotes* notes) {
  std::vector<LasersOfLidar> assigned;
  int next = 0;
  for (std::size_t k = 0; k < drive.lidars.size(); ++k) {
    const std::string& name = drive.lidars[k].name;
    if (drive.scans_of(k).empty()) continue;
    std::string why;
    const auto structure = recorded_structure(drive, &why, k);
    if (structure) why = misfit(*structure).value_or("");
    LasersOfLidar lasers{.lidar = k, .first = next, .count = kLasersOfLidar};
    if (why.empty()) {
      lasers.sensor = structure->sensor;
      if (lasers.sensor->beams.size() > kLasersOfLidar) lasers.count = kLasers;
    }
    if (next + lasers.count > kLasers) {
      notes->left_out.push_back("LiDAR " + name + ": the format has two, of 32 lasers each");
      continue;
    }
    if (!lasers.sensor && !knows_rings(drive, k))
      notes->left_out.push_back("laser numbers of " + name + ": " + why);
    else if (lasers.sensor && lasers.count == kLasers)
      notes->changed.push_back(
          "LiDAR " + name + " of " + std::to_string(lasers.sensor->beams.size()) +
          " beams is up_lidar and down_lidar, at one place" +
          (lasers.sensor->beams.size() > kLasers ? std::string("; beams share the 64 laser numbers")
                                                 : std::string()));
    next += lasers.count;
    assigned.push_back(std::move(lasers));
  }
  return assigned;
}

}  // namespace redrive::argoverse2

// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/splat/trace_gaussians.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <compare>
#include <optional>
#include <vector>

#include "redrive/camera/camera.h"
#include "redrive/camera/plain_camera.h"
#include "redrive/math/rigid3.h"
#include "redrive/math/voxel_grid.h"

namespace redrive {
namespace {

/// Side of the cells by which origins are grouped, metres. The centre of a group is at most 4.3 cm
/// from its origins: from 1.6 m on that shifts a surface by less than the tile around each ray.
constexpr double kGroup_m = 0.05;
/// Pixels along a face, without its margin. One spans 0.11 degrees in the middle of the face and
/// 0.06 at the middle of an edge, similar to training images and to a beam's divergence.
constexpr int kFacePixels = 1024;
constexpr int kMargin = kernels::kTileSide, kSide = kFacePixels + 2 * kMargin,
              kTilesAcross = kSide / kernels::kTileSide;
constexpr double kFocal = kFacePixels / 2.0, kCentre = (kSide - 1) / 2.0;
/// Largest ratio of depths between which the depth is interpolated: neighbouring pixels of a road
/// differ by as much 130 m away.
constexpr double kSameSurface = 1.15;
/// Each divides the error by roughly the distance over 5 cm.
constexpr int kIterations = 4;

/// A ray in its group: the cell of its origin and the face that it crosses.
struct GroupedRay {
  std::uint64_t cell = 0;  ///< key of its voxel
  int face = 0;            ///< 2 axis + (negative ? 1 : 0)
  int ray = 0;

  auto operator<=>(const GroupedRay&) const = default;
  bool in_group_of(const GroupedRay& other) const {
    return cell == other.cell && face == other.face;
  }
};

Eigen::Vector3d vector_at(std::span<const float> xyz, std::size_t n, std::size_t i) {
  return {double(xyz[i]), double(xyz[n + i]), double(xyz[2 * n + i])};
}

std::vector<GroupedRay> grouped(const kernels::Rays& rays) {
  const std::size_t n = rays.n;
  std::vector<GroupedRay> out(n);
  for (std::size_t i = 0; i < n; ++i) {
    GroupedRay& ray = out[i];
    ray.ray = static_cast<int>(i);
    ray.cell = voxel_key(voxel_of(vector_at(rays.origin, n, i), kGroup_m));
    int axis = 0;
    const Eigen::Vector3d direction = vector_at(rays.direction, n, i);
    direction.cwiseAbs().maxCoeff(&axis);
    ray.face = 2 * axis + (direction[axis] < 0);
  }
  std::ranges::sort(out);
  return out;
}

/// Returns the axes of a face in the world: columns x and y of the image, z outwards.
Eigen::Matrix3d world_from_face(int face) {
  const int axis = face / 2;
  Eigen::Matrix3d axes;
  axes.col(2) = (face % 2 ? -1 : 1) * Eigen::Vector3d::Unit(axis);
  axes.col(0) = Eigen::Vector3d::Unit((axis + 1) % 3);
  axes.col(1) = axes.col(2).cross(axes.col(0));
  return axes;
}

/// The surface that a face shows in one direction.
struct FaceSample {
  double distance = 0;  ///< from the cube's centre, metres; 0: no Gaussian is there
  double opacity = 0;
};

/// A drawn face of the cube around a group's mean origin.
class Face {
 public:
  /// Draws the tiles of the rays and those around them.
  Face(kernels::GaussianStages& stages, const kernels::Gaussians& gaussians,
       const kernels::Rays& rays, std::span<const GroupedRay> group) {
    const std::size_t n = rays.n;
    world_from_face_ = world_from_face(group[0].face);
    centre_.setZero();
    tiles_.assign(static_cast<std::size_t>(kTilesAcross) * kTilesAcross, 0);
    for (const GroupedRay& ray : group) {
      centre_ += vector_at(rays.origin, n, ray.ray) / static_cast<double>(group.size());
      const auto pixel = pixel_of(vector_at(rays.direction, n, ray.ray));
      const auto tile = [](double coordinate) {
        return static_cast<int>(coordinate) / kernels::kTileSide;
      };
      const int x = tile(pixel.x()), y = tile(pixel.y());
      for (int ty = std::max(y - 1, 0); ty <= std::min(y + 1, kTilesAcross - 1); ++ty)
        for (int tx = std::max(x - 1, 0); tx <= std::min(x + 1, kTilesAcross - 1); ++tx)
          tiles_[static_cast<std::size_t>(ty) * kTilesAcross + tx] = 1;
    }
    Rigid3d pose = Rigid3d::Identity();
    pose.linear() = world_from_face_;
    pose.translation() = centre_;
    const PlainPose world_from_camera = plain(pose);
    static const Camera camera{OpenCvPinhole{}, kFocal, kFocal, kCentre, kCentre, kSide, kSide};
    kernels::RasterOptions options;
    options.depth = true;
    options.tiles = tiles_;
    raster_.emplace(stages.rasterise({make_plain_camera(camera), {&world_from_camera, 1}, 0, kSide},
                                     gaussians, options));
  }

  const Eigen::Vector3d& centre() const { return centre_; }

  /// Reads the face in `direction` from the centre (any length > 0). False where nothing is drawn
  /// there.
  bool read(const Eigen::Vector3d& direction, FaceSample* sample) const {
    if (direction.dot(world_from_face_.col(2)) <= 0) return false;
    const Eigen::Vector2d at = pixel_of(direction);
    const double left = std::floor(at.x()), top = std::floor(at.y());
    if (!(left >= 0 && top >= 0 && left < kSide - 1 && top < kSide - 1)) return false;
    const kernels::RasterImage& image = raster_->image();
    double weights[4], inverse_z[4], opacity[4], least = 0, most = 0;
    int nearest = 0;
    for (int k = 0; k < 4; ++k) {
      const int x = static_cast<int>(left) + k % 2, y = static_cast<int>(top) + k / 2;
      if (!tiles_[static_cast<std::size_t>(y / kernels::kTileSide) * kTilesAcross +
                  x / kernels::kTileSide])
        return false;
      const std::size_t i = static_cast<std::size_t>(y) * image.size.stride + x;
      const double distance = image.depth[i];
      inverse_z[k] = distance > 0 ? stretch(x, y) / distance : 0;
      opacity[k] = 1 - double(image.transmittance[i]);
      weights[k] = (1 - std::abs(at.x() - x)) * (1 - std::abs(at.y() - y));
      if (weights[k] > weights[nearest]) nearest = k;
      least = k == 0 ? inverse_z[k] : std::min(least, inverse_z[k]);
      most = std::max(most, inverse_z[k]);
    }
    if (least == 0 || most > kSameSurface * least)
      for (int k = 0; k < 4; ++k) weights[k] = k == nearest;
    double inverse = 0;
    sample->opacity = 0;
    for (int k = 0; k < 4; ++k) {
      inverse += weights[k] * inverse_z[k];
      sample->opacity += weights[k] * opacity[k];
    }
    sample->distance = inverse > 0 ? stretch(at.x(), at.y()) / inverse : 0;
    return true;
  }

 private:
  /// The direction must point out of the face.
  Eigen::Vector2d pixel_of(const Eigen::Vector3d& direction) const {
    const Eigen::Vector3d in_face = world_from_face_.transpose() * direction;
    return (kFocal / in_face.z() * in_face.head<2>()).array() + kCentre;
  }
  /// Distance over depth along the face's axis at a pixel.
  static double stretch(double x, double y) {
    return std::hypot((x - kCentre) / kFocal, (y - kCentre) / kFocal, 1.0);
  }

  std::optional<kernels::Raster> raster_;
  Eigen::Matrix3d world_from_face_;
  Eigen::Vector3d centre_;
  std::vector<std::uint8_t> tiles_;
};

}  // namespace

RenderedRays trace_gaussians(kernels::GaussianStages& stages, const kernels::Gaussians& gaussians,
                             const kernels::Rays& rays) {
  const std::size_t n = rays.n;
  RenderedRays out{std::vector<float>(n), std::vector<float>(n)};
  const std::vector<GroupedRay> all = grouped(rays);
  for (std::size_t begin = 0, end = 0; begin < n; begin = end) {
    while (end < n && all[end].in_group_of(all[begin])) ++end;
    const std::span<const GroupedRay> group = std::span(all).subspan(begin, end - begin);
    const Face face(stages, gaussians, rays, group);
    for (const GroupedRay& grouped : group) {
      const std::size_t i = grouped.ray;
      const Eigen::Vector3d direction = vector_at(rays.direction, n, i),
                            from_centre = vector_at(rays.origin, n, i) - face.centre();
      // Finds r with |from_centre + r direction| = the distance drawn in its direction.
      double range = 0;
      FaceSample sample;
      for (int k = 0; k < kIterations; ++k) {
        const Eigen::Vector3d seen = k == 0 ? direction : from_centre + range * direction;
        if (!face.read(seen, &sample) || sample.distance == 0) break;
        const double along = from_centre.dot(direction), root = along * along -
                                                                from_centre.squaredNorm() +
                                                                sample.distance * sample.distance;
        range = std::max(0.0, std::sqrt(std::max(0.0, root)) - along);
      }
      out.depth[i] = static_cast<float>(range);
      out.opacity[i] = static_cast<float>(sample.opacity);
    }
  }
  return out;
}

}  // namespace redrive

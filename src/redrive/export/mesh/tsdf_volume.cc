// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/mesh/tsdf_volume.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <unordered_set>

#include "redrive/base/error.h"
#include "redrive/math/voxel_grid.h"
#include "redrive/scene/project_shutter.h"

namespace redrive {
namespace {

constexpr int kSide = TsdfBlock::kSide;
// Bytes of a block's leaves in the trees that a mesh is made from, and of its part of the mesh.
constexpr std::size_t kMeshBytes = 8192;
// Step between pixels whose blocks are stored, in x and y. A block spans many pixels.
constexpr int kPixelStep = 2;
// A surface seen at a smaller cosine has no depth that could be trusted.
constexpr double kLeastCosine = 0.05;
// The plane of a pixel is continued up to this far along the ray, with a weight that falls to 0:
// the flatter a view, the less it shows of what lies behind.
constexpr double kBehindTruncations = 4;

/// Returns floor(a / kSide).
int block_coordinate(int a) { return a >= 0 ? a / kSide : -((kSide - 1 - a) / kSide); }

/// Names a block by its coordinates, each within +- 2^20.
std::uint64_t key_of(const Voxel& block) {
  const std::uint64_t key = voxel_key(block);
  REDRIVE_CHECK(voxel_of_key(key) == block);
  return key;
}

/// Whether the pixel has a surface that is seen steeply enough.
bool is_usable(const DepthImage& image, std::size_t pixel) {
  return image.depth_m[pixel] > 0 &&
         -image.normal_at(pixel).dot(image.directions->of_pixel[pixel].cast<double>()) >=
             kLeastCosine;
}

/// Adds the blocks within `margin_m` of an image's surfaces.
void add_blocks(const DepthImage& image, double range_m, double block_m, double margin_m,
                std::unordered_set<std::uint64_t>* keys) {
  const Camera& camera = image.directions->camera;
  for (int y = 0; y < camera.height; y += kPixelStep) {
    for (int x = 0; x < camera.width; x += kPixelStep) {
      const std::size_t pixel = static_cast<std::size_t>(y) * camera.width + x;
      if (!(image.depth_m[pixel] <= range_m) || !is_usable(image, pixel)) continue;
      const Rigid3d world_from_camera =
          image.world_from_camera.at_pixel(x, y, camera.width, camera.height);
      const Eigen::Vector3d point =
          world_from_camera * (static_cast<double>(image.depth_m[pixel]) *
                               image.directions->of_pixel[pixel].cast<double>());
      const Eigen::Vector3d margin = Eigen::Vector3d::Constant(margin_m);
      const Voxel low = voxel_of(point - margin, block_m), high = voxel_of(point + margin, block_m);
      for (std::int64_t i = low.x(); i <= high.x(); ++i)
        for (std::int64_t j = low.y(); j <= high.y(); ++j)
          for (std::int64_t k = low.z(); k <= high.z(); ++k) keys->insert(key_of({i, j, k}));
    }
  }
}

/// An image as seen from the world.
struct Viewpoint {
  const DepthImage* image;
  Rigid3d camera_from_world;  ///< pose of the middle row
  Eigen::Vector3d position, axis;

  explicit Viewpoint(const DepthImage& of) : image(&of) {
    const Rigid3d middle = of.world_from_camera.at(0.5);
    camera_from_world = middle.inverse(Eigen::Isometry);
    position = middle.translation();
    axis = middle.linear().col(2);
  }

  /// Whether the image may show a part of the ball.
  bool may_see(const Eigen::Vector3d& centre, double radius, double range_m) const {
    const Eigen::Vector3d to = centre - position;
    const double distance = to.norm();
    if (distance <= radius) return true;
    if (distance > range_m + radius) return false;
    const double angle = std::acos(std::clamp(axis.dot(to) / distance, -1.0, 1.0));
    return angle <= image->directions->half_angle_rad + std::asin(radius / distance);
  }
};

/// Averages an image's distances at the points of a block.
void fuse_into(const Viewpoint& view, double voxel_m, double truncation_m, TsdfBlock* block) {
  const DepthImage& image = *view.image;
  const Camera& camera = image.directions->camera;
  for (int n = 0; n < TsdfBlock::kPoints; ++n) {
    const Eigen::Vector3d in_world =
        voxel_m * (block->first + VoxelIndex(n / (kSide * kSide), n / kSide % kSide, n % kSide))
                      .cast<double>();
    const auto seen =
        project_shutter(camera, image.world_from_camera, view.camera_from_world, in_world);
    if (!seen) continue;
    const long x = std::lround(seen->pixel.x()), y = std::lround(seen->pixel.y());
    if (x < 0 || y < 0 || x >= camera.width || y >= camera.height) continue;
    const std::size_t pixel = static_cast<std::size_t>(y) * camera.width + x;
    const double depth = static_cast<double>(image.depth_m[pixel]), length = seen->in_camera.norm();
    if (!(depth > 0) || length - depth >= kBehindTruncations * truncation_m) continue;
    const Eigen::Vector3d normal = image.normal_at(pixel),
                          direction = image.directions->of_pixel[pixel].cast<double>();
    const double cosine = -normal.dot(direction);
    if (!(cosine >= kLeastCosine)) continue;
    const double distance = normal.dot(seen->in_camera - depth * direction);
    if (!(distance >= -truncation_m)) continue;

    const double behind = std::max(0.0, length - depth) / (kBehindTruncations * truncation_m);
    const auto weight =
        static_cast<float>((1 - behind) * cosine / std::max(length * length, voxel_m * voxel_m));
    const auto average = [](float* mean, float sum_of_weights, float value, float weight) {
      *mean += (value - *mean) * weight / (sum_of_weights + weight);
    };
    average(&block->distance_m[n], block->weight[n],
            static_cast<float>(std::min(distance, truncation_m)), weight);
    block->weight[n] += weight;
    if (distance >= truncation_m) continue;
    for (int c = 0; c < 3; ++c)
      average(&block->rgb[n][c], block->rgb_weight[n], image.rgb[pixel][c], weight);
    block->rgb_weight[n] += weight;
  }
}

}  // namespace

TsdfVolume::TsdfVolume(double voxel_m, std::uint64_t most_bytes)
    : voxel_m_(voxel_m), most_blocks_(most_bytes / (sizeof(TsdfBlock) + kMeshBytes)) {
  REDRIVE_CHECK(voxel_m > 0);
}

TsdfVolume::Point TsdfVolume::find(const VoxelIndex& index) const {
  const VoxelIndex block = index.unaryExpr(&block_coordinate);
  const auto found = of_key_.find(key_of(block.cast<std::int64_t>()));
  if (found == of_key_.end()) return {nullptr, 0};
  const VoxelIndex within = index - kSide * block;
  return {found->second, TsdfBlock::offset(within.x(), within.y(), within.z())};
}

TsdfVolume::Point TsdfVolume::add(const VoxelIndex& index) {
  if (const Point point = find(index)) return point;
  if (blocks_.size() >= most_blocks_) {
    char text[32];
    std::snprintf(text, sizeof text, "%g", voxel_m_);
    throw UsageError("--voxel", text,
                     "a mesh of such voxels needs more than " + std::to_string(most_blocks_) +
                         " blocks of 8 x 8 x 8, all that --memory of the run leaves; a side twice "
                         "as long needs a quarter");
  }
  blocks_.push_back(std::make_unique<TsdfBlock>());
  const Eigen::Vector3i block = index.unaryExpr(&block_coordinate);
  blocks_.back()->first = kSide * block;
  of_key_.emplace(key_of(block.cast<std::int64_t>()), blocks_.back().get());
  return find(index);
}

void TsdfVolume::fuse(std::span<const DepthImage> images, double range_m, ThreadPool& pool) {
  // A point needs its neighbours, which complete its cell.
  const double block_m = kSide * voxel_m_, margin_m = truncation_m() + voxel_m_;
  std::vector<std::unordered_set<std::uint64_t>> of_image(images.size());
  pool.run(static_cast<int>(images.size()),
           [&](int i) { add_blocks(images[i], range_m, block_m, margin_m, &of_image[i]); });
  for (const auto& keys : of_image) {
    std::vector<std::uint64_t> sorted(keys.begin(), keys.end());
    std::ranges::sort(sorted);
    for (const std::uint64_t key : sorted) add(kSide * voxel_of_key(key).cast<int>());
  }
  of_image.clear();

  std::vector<Viewpoint> views;
  for (const DepthImage& image : images) views.emplace_back(image);
  const double radius = 0.5 * std::sqrt(3.0) * block_m;
  constexpr std::size_t kBlocksPerRange = 16;
  pool.run_ranges(blocks_.size(), kBlocksPerRange, [&](std::size_t begin, std::size_t end) {
    for (std::size_t b = begin; b < end; ++b) {
      const Eigen::Vector3d centre =
          voxel_m_ * (blocks_[b]->first.cast<double>().array() + 0.5 * (kSide - 1)).matrix();
      for (const Viewpoint& view : views)
        if (view.may_see(centre, radius, range_m))
          fuse_into(view, voxel_m_, truncation_m(), blocks_[b].get());
    }
  });
}

}  // namespace redrive

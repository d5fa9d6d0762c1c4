// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/splat/actors/fill_hidden.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include <Eigen/SparseCholesky>

#include "redrive/base/buffer.h"
#include "redrive/camera/plain_camera.h"
#include "redrive/field/gaussian_blocks.h"
#include "redrive/methods/splat/gaussian_points.h"

namespace redrive {
namespace {

constexpr float kSeenPixels = 0.05f, kSeenShare = 0.1f, kInFrontShare = 0.3f;
// Weight of hidden Gaussians from which a pixel is filled (kHole), and from which its colour is
// unknown without them (kUnknown); weight of new Gaussians from which it counts as filled
// (kFilled).
constexpr float kHole = 0.3f, kUnknown = 0.03f, kFilled = 0.5f;
constexpr float kLeastInverse_per_m = 1e-4f;                 // inverse distance of a new Gaussian
constexpr float kFillOpacity = 0.95f, kFillScale = 0.7f;     // scale: as a part of the spacing
constexpr int kSpacing = 2;                                  // pixels
constexpr std::size_t kMostFilled = 12, kMostSearched = 12;  // views with objects

bool interpolated(FillPixel pixel) {
  return pixel == FillPixel::kUnknown || pixel == FillPixel::kFill;
}

kernels::GaussianCamera camera_of(const FillView& view,
                                  std::span<const kernels::GaussianPart> parts) {
  const bool by_column = view.poses.by_column();
  return {.camera = make_plain_camera(view.camera),
          .world_from_camera = view.poses.keys(),
          .image_rows = static_cast<float>(by_column ? view.camera.width : view.camera.height),
          .parts = parts,
          .by_column = by_column};
}

bool has_objects(const FillView& view) {
  return std::ranges::any_of(view.drawn.parts, [](const kernels::GaussianPart& part) {
    return !part.part_from_camera.empty();
  });
}

/// Sums blending weights over images.
class WeightSums {
 public:
  /// blocks: most Gaussians'.
  WeightSums(kernels::GaussianStages& stages, std::size_t blocks)
      : stages_(stages), sums_(blocks * kGaussianBlock) {}

  /// Returns the sum of weights over the unmasked pixels, by Gaussian.
  /// Valid until the next call.
  std::span<const float> over(const FillView& view, const kernels::Gaussians& gaussians,
                              std::span<const kernels::GaussianPart> parts) {
    const kernels::GaussianCamera camera = camera_of(view, parts);
    kernels::Raster raster = stages_.rasterise(camera, gaussians, {});
    const kernels::RasterSize& size = raster.image().size;
    none_.assign(3 * size.plane(), 0);
    one_.assign(size.plane(), 0);
    for (int y = 0; y < size.height; ++y)
      for (int x = 0; x < size.width; ++x)
        one_[static_cast<std::size_t>(y) * size.stride + x] =
            view.used.empty() || view.used[static_cast<std::size_t>(y) * size.width + x] ? 1 : 0;
    const std::span<float> sums = sums_.span().first(gaussian_blocks(gaussians.n) * kGaussianBlock);
    std::ranges::fill(sums, 0.0f);
    raster.backward({none_, std::span(none_).first(size.plane()), one_, {}}, {.errors = sums}, {});
    return sums;
  }

 private:
  kernels::GaussianStages& stages_;
  std::vector<float> none_, one_;
  Buffer<float> sums_;
};

/// Colours and inverse distance of an image's pixels.
struct FillImage {
  int width = 0, height = 0;
  std::vector<FillPixel> pixel;
  std::vector<std::array<float, 4>> values;  ///< rgb, 1 / metres
};

/// Solves Laplace's equation over the unknown pixels; nothing flows over the image's edges or into
/// empty pixels.
void fill_by_membrane(FillImage* image) {
  constexpr float kRegular = 1e-6f;  // pixels without a border become 0
  std::vector<int> index(image->pixel.size(), -1);
  int n = 0;
  for (std::size_t i = 0; i < index.size(); ++i)
    if (interpolated(image->pixel[i])) index[i] = n++;
  if (n == 0) return;
  std::vector<Eigen::Triplet<float>> entries;
  Eigen::MatrixX4f right = Eigen::MatrixX4f::Zero(n, 4);
  for (int y = 0; y < image->height; ++y)
    for (int x = 0; x < image->width; ++x) {
      const std::size_t i = static_cast<std::size_t>(y) * image->width + x;
      if (index[i] < 0) continue;
      float degree = kRegular;
      const auto neighbour = [&](int dx, int dy) {
        if (x + dx < 0 || y + dy < 0 || x + dx >= image->width || y + dy >= image->height) return;
        const std::size_t j = static_cast<std::size_t>(y + dy) * image->width + (x + dx);
        if (image->pixel[j] == FillPixel::kEmpty) return;
        ++degree;
        if (index[j] >= 0)
          entries.emplace_back(index[i], index[j], -1.0f);
        else
          for (int k = 0; k < 4; ++k) right(index[i], k) += image->values[j][k];
      };
      neighbour(-1, 0), neighbour(1, 0), neighbour(0, -1), neighbour(0, 1);
      entries.emplace_back(index[i], index[i], degree);
    }
  Eigen::SparseMatrix<float> laplacian(n, n);
  laplacian.setFromTriplets(entries.begin(), entries.end());
  const Eigen::SimplicialLDLT<Eigen::SparseMatrix<float>> solver(laplacian);
  const Eigen::MatrixX4f solved = solver.solve(right);
  for (std::size_t i = 0; i < index.size(); ++i)
    for (int k = 0; index[i] >= 0 && k < 4; ++k) image->values[i][k] = solved(index[i], k);
}

/// Makes a Gaussian white or black.
void mark(std::size_t i, bool white, Buffer<float>* numbers) {
  for (int row = kColourRow; row < kLidarRow; ++row)
    (*numbers)[gaussian_slot(i, row)] = white && row < kHarmonicsRow ? 1 : 0;
}

/// Returns the numbers of black Gaussians. With some of them white, an image over black shows their
/// weight.
Buffer<float> blackened(const kernels::Gaussians& gaussians) {
  Buffer<float> out(gaussians.numbers.size());
  std::ranges::copy(gaussians.numbers, out.data());
  for (std::size_t i = 0; i < gaussians.n; ++i) mark(i, false, &out);
  return out;
}

/// Returns at most `most` of the views that have objects, evenly chosen.
std::vector<std::size_t> with_objects(const FillViews& views, std::size_t most) {
  std::vector<std::size_t> all, out;
  for (std::size_t v = 0; v < views.n; ++v)
    if (has_objects(views.view(v))) all.push_back(v);
  const std::size_t every = (all.size() + most - 1) / most;
  for (std::size_t i = 0; i < all.size(); i += every) out.push_back(all[i]);
  return out;
}

/// The Gaussians of the world that some image sees.
struct Seen {
  std::vector<std::uint8_t> with_objects, without_objects;
};

/// Marks the world Gaussians that a view sees, with and without its objects; with them, only those
/// that keep at least `share` of their weight.
void add_seen(const FillView& view, const kernels::Gaussians& all, const kernels::Gaussians& world,
              float share, WeightSums* sums, Seen* seen) {
  seen->with_objects.resize(world.n);
  seen->without_objects.resize(world.n);
  std::vector<float> without(world.n, 0);
  if (has_objects(view)) {
    const std::span<const float> alone = sums->over(view, world, {});
    for (std::size_t i = 0; i < world.n; ++i) {
      without[i] = alone[i];
      seen->without_objects[i] |= without[i] >= kSeenPixels;
    }
  }
  const std::span<const float> with = sums->over(view, all, view.drawn.parts);
  for (std::size_t i = 0; i < world.n; ++i) {
    const float weight = with[i];
    seen->with_objects[i] |= weight >= kSeenPixels && weight >= share * without[i];
  }
}

kernels::Gaussians world_of(const kernels::Gaussians& all, std::size_t world) {
  return {world, all.numbers.first(gaussian_blocks(world) * kBlockSize)};
}

/// Returns the largest value of the first colour.
float most_of(const kernels::Raster& raster) {
  const kernels::RasterImage& image = raster.image();
  float most = 0;
  for (int y = 0; y < image.size.height; ++y)
    for (int x = 0; x < image.size.width; ++x)
      most = std::max(most, image.rgb[static_cast<std::size_t>(y) * image.size.stride + x]);
  return most;
}

/// Returns the world's image without the moving objects. marked: the new Gaussians; pixels that
/// these have filled are known.
FillImage image_to_fill(kernels::GaussianStages& stages, const FillView& view,
                        const HiddenPlaces::Hole& hole, const kernels::Gaussians& world,
                        const kernels::Gaussians& marked) {
  const kernels::GaussianCamera camera = camera_of(view, {});
  const kernels::RasterSize size = kernels::raster_size(view.camera.width, view.camera.height);
  FillImage image;
  image.width = size.width;
  image.height = size.height;
  image.pixel = hole.pixels;
  image.values.resize(image.pixel.size());
  const auto at = [&](std::size_t i) {
    const auto width = static_cast<std::size_t>(size.width);
    return i / width * static_cast<std::size_t>(size.stride) + i % width;
  };
  {
    const kernels::Raster filled = stages.rasterise(camera, marked, {});
    for (std::size_t i = 0; i < image.pixel.size(); ++i)
      if (filled.image().rgb[at(i)] > kFilled) image.pixel[i] = FillPixel::kKnown;
  }
  kernels::RasterOptions options;
  options.depth = true;
  const kernels::Raster raster = stages.rasterise(camera, world, options);
  const kernels::RasterImage& drawn = raster.image();
  for (std::size_t i = 0; i < image.pixel.size(); ++i) {
    if (interpolated(image.pixel[i])) continue;
    const float depth = drawn.depth[at(i)];
    const bool masked = !view.used.empty() && !view.used[i];
    if (masked || !(depth > 0) || !std::isfinite(depth) || drawn.transmittance[at(i)] > 0.5f) {
      image.pixel[i] = FillPixel::kEmpty;
      continue;
    }
    for (int c = 0; c < 3; ++c) image.values[i][c] = drawn.rgb[c * size.plane() + at(i)];
    image.values[i][3] = 1 / depth;
  }
  return image;
}

/// Returns a Gaussian for each kSpacing-th filled pixel, or fewer and larger ones if these exceed
/// `most`.
GaussianList gaussians_of(const FillView& view, const FillImage& image, std::size_t most) {
  GaussianList list;
  const auto filled = static_cast<std::size_t>(std::ranges::count(image.pixel, FillPixel::kFill));
  if (filled == 0 || most == 0) return list;
  const int spacing = std::max(
      kSpacing, static_cast<int>(
                    std::ceil(std::sqrt(static_cast<double>(filled) / static_cast<double>(most)))));
  for (int y = 0; y < image.height; ++y)
    for (int x = 0; x < image.width && list.size() < most; ++x) {
      const std::size_t i = static_cast<std::size_t>(y) * image.width + x;
      if (image.pixel[i] != FillPixel::kFill || x % spacing != 0 || y % spacing != 0) continue;
      const std::array<float, 4>& value = image.values[i];
      if (!(value[3] > kLeastInverse_per_m)) continue;
      const auto ray = view.camera.unproject({x, y}), beside = view.camera.unproject({x + 1, y});
      if (!ray || !beside) continue;
      const double depth_m = 1 / double(value[3]);
      const Rigid3d world_from_camera = view.poses.at_pixel(x, y, image.width, image.height);
      const Point point{(world_from_camera * (depth_m * ray->normalized())).cast<float>(),
                        Eigen::Vector3f(value[0], value[1], value[2]).cwiseMax(0).cwiseMin(1),
                        world_from_camera.translation().cast<float>()};
      const auto footprint_m =
          static_cast<float>(depth_m * (beside->normalized() - ray->normalized()).norm());
      list.rows.resize(list.rows.size() + kGaussianRows);
      put_gaussian(point, Eigen::Vector3f::Constant(kFillScale * float(spacing) * footprint_m),
                   Eigen::Quaternionf::Identity(), kFillOpacity, static_cast<float>(depth_m),
                   &*(list.rows.end() - kGaussianRows));
    }
  return list;
}

}  // namespace

HiddenPlaces find_hidden(kernels::GaussianStages& stages, const FillViews& views,
                         const kernels::Gaussians& all, std::size_t world) {
  HiddenPlaces hidden;
  const kernels::Gaussians of_world = world_of(all, world);
  WeightSums sums(stages, gaussian_blocks(all.n));
  Seen seen;
  const std::vector<std::size_t> searched = with_objects(views, kMostSearched);
  for (const std::size_t v : searched)
    add_seen(views.view(v), all, of_world, kSeenShare, &sums, &seen);
  for (std::size_t i = 0; i < seen.with_objects.size(); ++i)
    if (seen.without_objects[i] && !seen.with_objects[i]) hidden.gaussians.push_back(i);
  Buffer<float> marked = blackened(all);
  for (const std::size_t i : hidden.gaussians) mark(i, true, &marked);
  // The other images that show any of these places.
  for (std::size_t v = 0; v < views.n && !hidden.gaussians.empty(); ++v) {
    if (std::ranges::binary_search(searched, v)) continue;
    const FillView view = views.view(v);
    if (most_of(stages.rasterise(camera_of(view, view.drawn.parts), {all.n, marked}, {})) <
        kSeenShare)
      continue;
    add_seen(view, all, of_world, kSeenShare, &sums, &seen);
    std::erase_if(hidden.gaussians, [&](std::size_t i) {
      if (seen.with_objects[i]) mark(i, false, &marked);
      return seen.with_objects[i] != 0;
    });
  }
  if (hidden.gaussians.empty()) return hidden;
  for (const std::size_t v : with_objects(views, kMostFilled)) {
    const FillView view = views.view(v);
    const kernels::Raster raster =
        stages.rasterise(camera_of(view, {}), world_of({all.n, marked}, world), {});
    if (most_of(raster) <= kHole) continue;
    const kernels::RasterImage& drawn = raster.image();
    HiddenPlaces::Hole hole{v, {}};
    for (int y = 0; y < drawn.size.height; ++y)
      for (int x = 0; x < drawn.size.width; ++x) {
        const float weight = drawn.rgb[static_cast<std::size_t>(y) * drawn.size.stride + x];
        hole.pixels.push_back(weight > kHole      ? FillPixel::kFill
                              : weight > kUnknown ? FillPixel::kUnknown
                                                  : FillPixel::kKnown);
      }
    hidden.holes.push_back(std::move(hole));
  }
  return hidden;
}

std::size_t fills_needed(const HiddenPlaces& hidden) {
  constexpr std::size_t kMost = 4096;
  std::size_t pixels = 0;
  for (const HiddenPlaces::Hole& hole : hidden.holes)
    pixels += static_cast<std::size_t>(std::ranges::count(hole.pixels, FillPixel::kFill));
  return std::min(kMost, pixels / (kSpacing * kSpacing) + hidden.holes.size());
}

void fill_holes(kernels::GaussianStages& stages, const FillViews& views, const HiddenPlaces& hidden,
                std::size_t gaussians, std::size_t world, std::size_t spare,
                std::span<float> numbers) {
  const kernels::Gaussians all{gaussians, numbers}, of_world = world_of(all, world);
  const std::size_t first = world - spare;
  std::size_t end = first;
  {
    Buffer<float> marked = blackened(of_world);
    for (const HiddenPlaces::Hole& hole : hidden.holes) {
      const FillView of = views.view(hole.view);
      FillImage image = image_to_fill(stages, of, hole, of_world, {world, marked});
      fill_by_membrane(&image);
      // Takes half of what is left, so that later images have some, too.
      const GaussianList list = gaussians_of(of, image, (world - end + 1) / 2);
      for (std::size_t k = 0; k < list.size(); ++k, ++end) {
        for (int row = 0; row < kGaussianRows; ++row)
          numbers[gaussian_slot(end, row)] = marked[gaussian_slot(end, row)] =
              list.rows[k * kGaussianRows + row];
        mark(end, true, &marked);
      }
    }
  }
  WeightSums sums(stages, gaussian_blocks(gaussians));
  Seen seen;
  for (const HiddenPlaces::Hole& hole : hidden.holes)
    add_seen(views.view(hole.view), all, of_world, kInFrontShare, &sums, &seen);
  for (std::size_t i = first; i < end; ++i)
    if (seen.with_objects[i]) clear_unused(i, i + 1, numbers.data());
}

}  // namespace redrive

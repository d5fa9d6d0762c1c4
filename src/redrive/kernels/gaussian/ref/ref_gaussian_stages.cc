// SPDX-License-Identifier: Apache-2.0
// Rasterising Gaussians in double, without tiles: every pixel blends every visible Gaussian.
#include "redrive/kernels/gaussian/ref/ref_gaussian_stages.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "redrive/kernels/gaussian/check_gaussian_sizes.h"
#include "redrive/kernels/gaussian/host_raster.h"
#include "redrive/kernels/gaussian/line_pose.h"
#include "redrive/kernels/gaussian/mean_bounds.h"
#include "redrive/kernels/gaussian/plain_points.h"
#include "redrive/kernels/gaussian/target_window.h"
#include "redrive/optim/packed_moments.h"
#include "redrive/optim/ssim.h"
#include "redrive/optim/ssim_gradient.h"
#include "redrive/volume/blend_gaussians.h"

namespace redrive::kernels {
namespace {

using Math = NumberMath<double>;
using Projected = ProjectedGaussian<Math>;

/// A drawn Gaussian.
struct Drawn {
  std::size_t id, part;  ///< part: 0 in the world, from 1 on an index into GaussianCamera::parts
  GaussianPose<Math> pose;
  Projected at;
  std::array<double, kDistanceRow> rows;
};

std::span<const PlainPose> poses_of(const GaussianCamera& camera, std::size_t part) {
  return part == 0 ? camera.world_from_camera : camera.parts[part - 1].part_from_camera;
}

bool holds_mean(const RasterBounds& means, const Projected& at) {
  return at.mean[0] > double(means.left) && at.mean[0] < double(means.right) &&
         at.mean[1] > double(means.top) && at.mean[1] < double(means.bottom);
}

/// Whether the ellipse in which alpha exceeds kMinAlpha meets the image's rectangle of pixels.
bool meets_image(const RasterBounds& image, const Projected& at) {
  const double reach = 2 * std::log(at.alpha / double(kMinAlpha));
  const double rx = std::sqrt(reach * at.variance[0]), ry = std::sqrt(reach * at.variance[1]);
  return at.mean[0] + rx > double(image.left) && at.mean[0] - rx < double(image.right) &&
         at.mean[1] + ry > double(image.top) && at.mean[1] - ry < double(image.bottom);
}

double log_range(const RasterOptions& options, std::size_t pixel) {
  return options.log_range.empty() ? static_cast<double>(kNoRange)
                                   : static_cast<double>(options.log_range[pixel]);
}
/// Calls body(u, v, index) for the pixels of wanted tiles.
template <class Body>
void for_pixels(const RasterSize& size, const PixelCentres& centres, const RasterOptions& options,
                const Body& body) {
  for (int y = 0; y < size.rows; ++y)
    for (int x = 0; x < size.stride; ++x) {
      const int tile = y / kTileSide * (size.stride / kTileSide) + x / kTileSide;
      if (!options.tiles.empty() && !options.tiles[tile]) continue;
      const std::size_t i = static_cast<std::size_t>(y) * size.stride + static_cast<std::size_t>(x);
      if (centres.u.empty())
        body(double(x), double(y), i);
      else
        body(double(centres.u[i]), double(centres.v[i]), i);
    }
}

void update_by(const GaussianUpdate& update, std::size_t n, std::span<const float> gradients,
               std::span<const float> errors) {
  const std::span<float> numbers = update.numbers;
  for (std::size_t i = 0; i < n; ++i) {
    if (gradients[gaussian_slot(i, kOpacityRow)] == 0) continue;
    const float distance = numbers[gaussian_slot(i, kDistanceRow)];
    bool finite = true;
    for (int row = 0; row < kDistanceRow; ++row)
      finite &= !is_seen(update.rows, row) || std::isfinite(gradients[gaussian_slot(i, row)]);
    if (!finite) continue;
    for (int row = 0; row < kDistanceRow; ++row) {
      if (!is_seen(update.rows, row)) continue;
      const std::size_t slot = gaussian_slot(i, row);
      AdamStep step = update.step;
      step.learning_rate = update.rates[row] * (row < kLogScaleRow ? distance : 1);
      std::uint32_t& packed = update.moments[slot];
      float m = unpacked_first(packed), v = unpacked_second(packed);
      adam_update(step, gradients[slot], numbers[slot], m, v);
      packed = pack_moments(m, v);
      if (i / kGaussianBlock >= update.bounded_colours && row >= kColourRow && row < kHarmonicsRow)
        numbers[slot] = std::clamp(numbers[slot], 0.0f, 1.0f);
    }
    update.errors[i] += errors[i];
    const float log_distance = std::log(std::max(distance, 1e-6f)),
                least = update.min_log_scale + log_distance,
                most = update.max_log_scale + log_distance;
    const auto scale = [&](int k) -> float& { return numbers[gaussian_slot(i, kLogScaleRow + k)]; };
    const float smallest = std::min({scale(0), scale(1), scale(2)});
    for (int k = 0; k < 3; ++k)
      scale(k) = std::min(scale(k) > smallest ? std::max(scale(k), least) : scale(k), most);
  }
}

struct RefRaster final : HostRaster {
  explicit RefRaster(GaussianStages* stages) : HostRaster(stages, nullptr) {}

  void set(const GaussianCamera& of_camera, const Gaussians& of, const RasterOptions& options) {
    camera = of_camera;
    gaussians = of;
    options_ = options;
  }
  void forward() {
    drawn.clear();
    const RasterBounds bounds = raster_bounds(camera), means = mean_bounds(camera, bounds);
    std::size_t part = 0;
    for (std::size_t id = 0; id < gaussians.n; ++id) {
      while (part < camera.parts.size() && camera.parts[part].first_block <= id / kGaussianBlock)
        ++part;
      const std::span<const PlainPose> poses = poses_of(camera, part);
      if (poses.empty()) continue;
      Drawn d{.id = id, .part = part};
      for (int row = 0; row < kDistanceRow; ++row)
        d.rows[row] = static_cast<double>(gaussians.numbers[gaussian_slot(id, row)]);
      d.at.mean[camera.by_column ? 0 : 1] = double(first_line(camera));
      const int iterations = line_iterations(poses);
      bool seen = true;
      for (int i = 0; i < iterations; ++i) {
        d.pose = line_pose(camera, poses, d.at.mean);
        with_camera(camera.camera, [&](const auto& lens) {
          project_mean<Math>(lens, d.pose, d.rows.data() + kPositionRow, &d.at);
        });
        const bool now = d.at.visible && holds_mean(means, d.at);
        seen = camera.centres.u.empty() ? now : seen && now;
      }
      if (!seen) continue;
      with_camera(camera.camera, [&](const auto& lens) {
        project_gaussian<Math>(lens, d.pose, d.rows.data(), &d.at);
      });
      if (!(d.at.alpha > double(kMinAlpha)) || !meets_image(bounds, d.at)) continue;
      drawn.push_back(d);
    }
    std::ranges::stable_sort(drawn, {}, [](const Drawn& d) { return d.at.length; });
    splats.clear();
    part_of_splat.clear();
    for (const Drawn& d : drawn) {
      Splat2d<double> splat{{d.at.mean[0], d.at.mean[1]},
                            {d.at.conic[0], d.at.conic[1], d.at.conic[2]},
                            d.at.alpha,
                            {},
                            d.at.length,
                            {d.at.slope[0], d.at.slope[1]}};
      for (int c = 0; c < 3; ++c) splat.rgb[c] = std::max(d.at.colour[c], 0.0);
      splats.push_back(splat);
      part_of_splat.push_back(d.part);
    }
    const RasterSize size = raster_size(camera.camera.width, camera.camera.height);
    image_.size = size;
    for (Buffer<float>* plane : {&image_.transmittance, &image_.depth, &image_.range_error})
      if (plane->size() < size.plane()) *plane = Buffer<float>(size.plane());
    if (image_.rgb.size() < 3 * size.plane()) image_.rgb = Buffer<float>(3 * size.plane());
    for_pixels(size, camera.centres, options_, [&](double u, double v, std::size_t i) {
      const BlendedPixel<double> pixel =
          blend_gaussians(splats, u, v, options_.background, log_range(options_, i));
      for (int c = 0; c < 3; ++c)
        image_.rgb[c * size.plane() + i] = static_cast<float>(pixel.rgb[c]);
      image_.transmittance[i] = static_cast<float>(pixel.transmittance);
      image_.depth[i] = static_cast<float>(pixel.depth);
      image_.range_error[i] = static_cast<float>(pixel.range_error);
    });
    if (options_.parts) find_parts();
    counts_ = {drawn.size(), drawn.size()};
  }

  void find_parts() {
    const RasterSize& size = image_.size;
    image_.parts = Buffer<std::uint16_t>(size.plane());
    const std::size_t objects = objects_of(camera.parts);
    image_.extents.assign(objects, {});
    std::vector<std::size_t> object_of_splat;
    for (const std::size_t part : part_of_splat)
      object_of_splat.push_back(objects_of(camera.parts.first(part)));
    for_pixels(size, camera.centres, options_, [&](double u, double v, std::size_t i) {
      const PartWeights weights = blend_parts(splats, object_of_splat, 1 + objects, u, v);
      const auto largest = std::ranges::max_element(weights.visible) - weights.visible.begin();
      image_.parts[i] = static_cast<std::uint16_t>(largest);
      const int x = static_cast<int>(i % size.stride), y = static_cast<int>(i / size.stride);
      if (x >= size.width || y >= size.height) return;
      for (std::size_t object = 0; object < objects; ++object) {
        PartExtent& extent = image_.extents[object];
        extent.visible += std::size_t(largest) == object + 1;
        if (weights.alone[object + 1] <= 0.5) continue;
        ++extent.whole;
        extent.left = std::min(extent.left, x);
        extent.right = std::max(extent.right, x);
        extent.top = std::min(extent.top, y);
        extent.bottom = std::max(extent.bottom, y);
      }
    });
  }

  using HostRaster::backward;
  void backward(const RasterGradient& gradient, const GaussianDerivatives& to,
                std::span<GaussianPoseGradient<Math>> d_poses) override {
    check_rasterise_backward(camera, gaussians, options_, gradient, to, d_poses.size());
    std::vector<float> to_apply(to.update ? gaussians.numbers.size() : 0),
        errors_to_apply(to_apply.size() / kGaussianRows);
    const std::span<float> gradients = to.update ? to_apply : to.gradients,
                           errors = to.update ? errors_to_apply : to.errors;
    std::vector<Splat2dGradient> sums(splats.size());
    const std::size_t plane = image_.size.plane();
    for_pixels(image_.size, camera.centres, options_, [&](double u, double v, std::size_t i) {
      double d_rgb[3];
      for (int c = 0; c < 3; ++c) d_rgb[c] = static_cast<double>(gradient.d_rgb[c * plane + i]);
      blend_gaussians_adjoint(
          splats, u, v, options_.background, log_range(options_, i),
          {d_rgb, gradient.d_range.empty() ? 0 : static_cast<double>(gradient.d_range[i]),
           static_cast<double>(gradient.d_transmittance[i])},
          static_cast<double>(gradient.error[i]), &sums);
    });
    std::ranges::fill(d_poses, GaussianPoseGradient<Math>{});
    for (std::size_t i = 0; i < sums.size(); ++i) {
      const Drawn& d = drawn[i];
      const Splat2dGradient& sum = sums[i];
      errors[d.id] += static_cast<float>(sum.error);
      if (gradients.empty()) continue;
      const ProjectedGradient<Math> projected{{sum.mean[0], sum.mean[1]},
                                              {sum.conic[0], sum.conic[1], sum.conic[2]},
                                              sum.log_alpha,
                                              {sum.rgb[0], sum.rgb[1], sum.rgb[2]},
                                              sum.distance};
      double d_rows[kDistanceRow];
      GaussianPoseGradient<Math> of_pose;
      with_camera(camera.camera, [&](const auto& lens) {
        project_gaussian_adjoint<Math>(lens, d.pose, d.rows.data(), d.at, projected, d_rows,
                                       &of_pose);
      });
      for (int row = 0; row < kDistanceRow; ++row)
        if (is_seen(seen_by(camera.camera), row))
          gradients[gaussian_slot(d.id, row)] += static_cast<float>(d_rows[row]);
      for (int k = 0; !d_poses.empty() && k < 3; ++k) {
        d_poses[d.part].translation[k] += of_pose.translation[k];
        d_poses[d.part].rotation[k] += of_pose.rotation[k];
      }
    }
    if (to.update) update_by(*to.update, gaussians.n, gradients, errors);
  }

  GaussianCamera camera;
  Gaussians gaussians;
  std::vector<Drawn> drawn;  ///< sorted by distance
  std::vector<Splat2d<double>> splats;
  std::vector<std::size_t> part_of_splat;
};

class RefGaussianStages final : public GaussianStages {
 public:
  Raster rasterise(const GaussianCamera& camera, const Gaussians& gaussians,
                   const RasterOptions& options) override {
    check_rasterise(camera, gaussians, options);
    auto raster = arena_.take<RefRaster>([this] { return std::make_unique<RefRaster>(this); });
    raster->set(camera, gaussians, options);
    raster->forward();
    return {std::move(raster), &arena_};
  }
  void project_points(const GaussianCamera& camera, std::span<const float> points,
                      std::span<float> pixels) override {
    project_plain_points(camera, points, nullptr, pixels);
  }
  void release() override { arena_.release(); }

  ImageLossOutput image_loss(const ImageLossInput& input, std::span<float> d_rgb,
                             std::span<float> error) override {
    check_image_loss(input, d_rgb.size(), error.size());
    const SsimTaps taps = ssim_taps();
    const int width = input.size.width, height = input.size.height, stride = input.size.stride;
    const std::size_t plane = input.size.plane();
    const auto at = [&](int x, int y) {
      return static_cast<std::size_t>(y) * stride + static_cast<std::size_t>(x);
    };
    std::vector<float> targets(3 * plane), gains(3 * plane), masks(plane);
    ImageLossOutput out;
    out.patches.resize(plane / (kPatchSide * kPatchSide));
    TargetSums all;
    for (int y = 0; y < height; ++y)
      all.add(convert_target_row(input, y, targets.data(), masks.data(), gains.data(),
                                 &out.patches[y / kPatchSide * (stride / kPatchSide)]));
    const double count = std::max(3 * all.pixels, 1.0);
    std::vector<double> d(3 * plane), image(3 * plane), target(3 * plane);
    std::ranges::fill(error.first(plane), 0.0f);
    for (int y = 0; y < height; ++y)
      for (int x = 0; x < width; ++x) {
        const std::size_t i = at(x, y);
        const double mask = static_cast<double>(masks[i]);
        double of_pixel = 0;
        for (int c = 0; c < 3; ++c) {
          const std::size_t k = c * plane + i;
          image[k] = mask * static_cast<double>(gains[k]) * static_cast<double>(input.rgb[k]);
          target[k] = mask * static_cast<double>(targets[k]);
          const double off = image[k] - target[k];
          d[k] = static_cast<double>(input.l1_weight) / count * mask * ((off > 0) - (off < 0));
          out.l1 += static_cast<double>(input.l1_weight) / count * std::fabs(off);
          out.mse += off * off / count;
          of_pixel += std::fabs(off) / 3;
        }
        error[i] = static_cast<float>(of_pixel);
      }
    const double per_window = static_cast<double>(input.ssim_weight) / count / 2;
    for (int c = 0; per_window > 0 && c < 3; ++c)
      for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) {
          const double mask = static_cast<double>(masks[at(x, y)]);
          const auto for_window = [&](const auto& body) {
            for (int j = -kSsimRadius; j <= kSsimRadius; ++j)
              for (int i = -kSsimRadius; i <= kSsimRadius; ++i)
                if (x + i >= 0 && x + i < width && y + j >= 0 && y + j < height)
                  body(taps[i + kSsimRadius] * taps[j + kSsimRadius], c * plane + at(x + i, y + j));
          };
          SsimMoments mean;
          for_window([&](double tap, std::size_t k) { mean.add(tap, image[k], target[k]); });
          const SsimGradient<Math> s =
              ssim_gradient<Math>(mean.x, mean.y, mean.xx, mean.yy, mean.xy);
          out.dssim += mask * per_window * (1 - s.ssim);
          for_window([&](double tap, std::size_t k) {
            const double inside = static_cast<double>(masks[k % plane]);
            d[k] -= inside * mask * per_window * tap *
                    (s.by_x + 2 * image[k] * s.by_xx + target[k] * s.by_xy);
          });
        }
    for (int c = 0; c < 3; ++c)
      for (std::size_t i = 0; i < plane; ++i) {
        const std::size_t k = c * plane + i;
        d_rgb[k] = static_cast<float>(d[k] * static_cast<double>(gains[k]));
      }
    all.finish(&out);
    return out;
  }

  void update_gaussians(const GaussianUpdate& update, std::size_t n,
                        std::span<const float> gradients, std::span<const float> errors) override {
    check_update_gaussians(update, n, gradients.size(), errors.size());
    update_by(update, n, gradients, errors);
  }

 private:
  RasterArena arena_;
};

}  // namespace

std::unique_ptr<GaussianStages> make_ref_gaussian_stages() {
  return std::make_unique<RefGaussianStages>();
}

}  // namespace redrive::kernels

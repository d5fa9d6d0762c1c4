// SPDX-License-Identifier: Apache-2.0
#include "redrive/rays/ray_table.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>

#include "redrive/base/error.h"
#include "redrive/base/parallel.h"
#include "redrive/base/rng.h"

namespace redrive {
namespace {

void resize(RayBatch* batch, int n, bool with_target) {
  batch->n = n;
  batch->origin.resize(3 * std::size_t(n));
  batch->direction.resize(3 * std::size_t(n));
  batch->target.resize(with_target ? 3 * std::size_t(n) : 0);
  batch->pixel_angle.resize(n);
  batch->background.clear();
  batch->weight.clear();
  batch->cell.clear();
  batch->error_map_rays = 0;
}

RayTableSpans spans_of(const RayTable& table) {
  return {table.width, table.height, table.pixel_angle, table.pixel, table.direction};
}

/// Returns the mean over a coarse lattice of pixels; the smallest positive float if no pixel is
/// valid.
float mean_pixel_angle(const Camera& camera) {
  constexpr int kLattice = 32;
  double sum = 0;
  int count = 0;
  for (int j = 0; j < kLattice; ++j)
    for (int i = 0; i < kLattice; ++i) {
      const Eigen::Vector2d pixel((i + 0.5) / kLattice * camera.width - 0.5,
                                  (j + 0.5) / kLattice * camera.height - 0.5);
      const auto here = camera.unproject(pixel),
                 right = camera.unproject(pixel + Eigen::Vector2d(0.5, 0)),
                 below = camera.unproject(pixel + Eigen::Vector2d(0, 0.5));
      if (!here || !right || !below) continue;
      sum += 4 * (*right - *here).cross(*below - *here).norm();
      ++count;
    }
  return count > 0 ? static_cast<float>(std::sqrt(sum / count)) : std::numeric_limits<float>::min();
}

}  // namespace

RayTable make_ray_table(const Camera& camera) {
  ThreadPool alone(1);
  return make_ray_table(camera, alone);
}

RayTable make_ray_table(const Camera& camera, ThreadPool& pool) {
  constexpr int kRowsPerRange = 16;
  struct Rows {
    std::vector<std::uint32_t> pixel;
    std::vector<float> direction;
  };
  std::vector<Rows> parts((camera.height + kRowsPerRange - 1) / kRowsPerRange);
  pool.run_ranges(camera.height, kRowsPerRange, [&](std::size_t begin, std::size_t end) {
    Rows& rows = parts[begin / kRowsPerRange];
    for (std::size_t y = begin; y < end; ++y)
      for (int x = 0; x < camera.width; ++x) {
        const auto direction = camera.unproject({x, y});
        if (!direction) continue;
        rows.pixel.push_back(static_cast<std::uint32_t>(y * camera.width + x));
        for (int d = 0; d < 3; ++d) rows.direction.push_back(static_cast<float>((*direction)[d]));
      }
  });
  RayTable table{camera.width, camera.height, {}, {}, mean_pixel_angle(camera), camera};
  for (const Rows& rows : parts) {
    table.pixel.insert(table.pixel.end(), rows.pixel.begin(), rows.pixel.end());
    table.direction.insert(table.direction.end(), rows.direction.begin(), rows.direction.end());
  }
  return table;
}

PixelSquares make_pixel_squares(const RayTable& table) {
  constexpr std::uint32_t kNone = ~0u;
  constexpr int kLarge = 16;
  std::vector<std::uint32_t> entry_of(static_cast<std::size_t>(table.width) * table.height, kNone);
  for (std::size_t k = 0; k < table.pixel.size(); ++k)
    entry_of[table.pixel[k]] = static_cast<std::uint32_t>(k);
  PixelSquares squares;
  squares.entry.reserve(table.pixel.size());
  squares.first = {0};
  const auto add_square = [&](int left, int top) {
    for (int y = top; y < std::min(top + 2, table.height); ++y)
      for (int x = left; x < std::min(left + 2, table.width); ++x)
        if (const std::uint32_t k = entry_of[static_cast<std::size_t>(y) * table.width + x];
            k != kNone)
          squares.entry.push_back(k);
    if (squares.entry.size() > squares.first.back())
      squares.first.push_back(static_cast<std::uint32_t>(squares.entry.size()));
  };
  for (int top = 0; top < table.height; top += kLarge)
    for (int left = 0; left < table.width; left += kLarge)
      for (int y = top; y < std::min(top + kLarge, table.height); y += 2)
        for (int x = left; x < std::min(left + kLarge, table.width); x += 2) add_square(x, y);
  return squares;
}

void view_rays(const RayTable& table, const ShutterPoses& world_from_camera,
               std::span<const std::uint32_t> entries, RayBatch* batch) {
  resize(batch, static_cast<int>(entries.size()), false);
  GatheredRays out;
  out.origin = batch->origin;
  out.direction = batch->direction;
  out.pixel_angle = batch->pixel_angle;
  const RayTableSpans spans = spans_of(table);
  const std::vector<PlainPose>& keys = world_from_camera.keys();
  for (std::size_t i = 0; i < entries.size(); ++i)
    write_ray(spans, entries[i], keys.data(), keys.size(), world_from_camera.by_column(), i,
              entries.size(), out);
}

UsedPixels::UsedPixels(const RayTable& table, const std::vector<std::uint8_t>& used)
    : bits_((table.pixel.size() + 63) / 64), before_(bits_.size() + 1) {
  REDRIVE_CHECK_OP(used.size(), ==, std::size_t(table.width) * table.height);
  for (std::size_t k = 0; k < table.pixel.size(); ++k)
    if (used[table.pixel[k]] != 0) bits_[k / 64] |= std::uint64_t{1} << (k % 64);
  for (std::size_t word = 0; word < bits_.size(); ++word)
    before_[word + 1] = before_[word] + std::popcount(bits_[word]);
}

std::uint64_t epoch_pixels(const RayTable& table, const Image8& image) {
  if (image.used.empty() && image.alpha.empty()) return table.pixel.size();
  std::uint64_t visible = 0, transparent = 0;
  for (const std::uint32_t pixel : table.pixel) {
    const float weight = pixel_sampling_weight(image.alpha, image.used, pixel);
    visible += weight == 1;
    transparent += weight == 1.0f / kEpochsPerTransparentPixel;
  }
  return visible + (transparent + kEpochsPerTransparentPixel - 1) / kEpochsPerTransparentPixel;
}

PixelSampler::PixelSampler(const Scene& scene, const std::vector<Image8>& images,
                           std::uint64_t seed)
    : scene_(scene), seed_(seed), offsets_{0} {
  REDRIVE_CHECK_OP(images.size(), ==, scene.views.size());
  for (const RigCamera& camera : scene.rig) tables_.push_back(make_ray_table(camera.camera));
  for (const RayTable& table : tables_) table_spans_.push_back(spans_of(table));
  for (std::size_t i = 0; i < scene.views.size(); ++i) {
    const View& view = scene.views[i];
    if (view.held_out) continue;
    const RayTable& table = tables_[view.camera];
    const Image8& image = images[i];
    REDRIVE_CHECK_OP(image.width, ==, table.width);
    REDRIVE_CHECK_OP(image.height, ==, table.height);
    const int index = static_cast<int>(images_.size());
    images_.push_back({static_cast<std::uint32_t>(i), static_cast<std::uint32_t>(view.camera), 0, 0,
                       scene.rig[view.camera].readout_by_column, scene.exposure(view), image.rgb,
                       image.alpha, image.used});
    std::vector<float> share(image.rgb.size() / 3);
    for (const std::uint32_t pixel : table.pixel)
      share[pixel] = pixel_sampling_weight(image.alpha, image.used, pixel);
    cells_.add(image.width, image.height, share);
    if (image.used.empty() && image.alpha.empty()) {
      add(index, 1, nullptr);
      continue;
    }
    for (const int every :
         {1, kEpochsPerTransparentPixel}) {  // visible pixels, then fully transparent ones
      std::vector<std::uint8_t> used(share.size());
      for (std::size_t pixel = 0; pixel < used.size(); ++pixel)
        used[pixel] = share[pixel] == 1.0f / every;
      UsedPixels pixels(table, used);
      if (pixels.size() == 0) continue;
      used_.push_back(std::move(pixels));
      add(index, every, &used_.back());
    }
  }
  check_any();
  source_ = {offsets_.back(),
             background_colour(scene.background)[0],
             scene.random_background,
             table_spans_,
             images_,
             pools_,
             offsets_,
             {},
             cells_.images(),
             cells_.pixels()};
  update_poses();
}

PixelSampler::PixelSampler(const Scene& scene, std::uint64_t pixels, std::uint64_t seed)
    : scene_(scene), seed_(seed), offsets_{pixels} {
  check_any();
  source_.pixels = pixels;
}

void PixelSampler::check_any() const {
  const auto first = std::ranges::find(scene_.views, false, &View::held_out);
  REDRIVE_CHECK(first != scene_.views.end());
  if (offsets_.back() == 0)
    throw InputError(
        first->image, "", "",
        "masks and camera models leave no pixel of this and all other training images");
}

void PixelSampler::update_poses() {
  poses_.clear();
  for (TrainingImage& image : images_) {
    const ShutterPoses poses = scene_.shutter_poses(scene_.views[image.view]);
    image.first_pose = poses_.size();
    image.poses = poses.keys().size();
    poses_.insert(poses_.end(), poses.keys().begin(), poses.keys().end());
  }
  source_.poses = poses_;
}

void PixelSampler::add(int index, int every, const UsedPixels* used) {
  const std::size_t size = used ? used->size() : tables_[images_[index].camera].pixel.size();
  offsets_.push_back(offsets_.back() + (size + every - 1) / every);
  pools_.push_back({static_cast<std::uint32_t>(index), static_cast<std::uint32_t>(every)});
  if (!used) return;
  pools_.back().bits = used->bits();
  pools_.back().before = used->before();
}

std::int64_t PixelSampler::steps_per_epoch(int rays) const {
  REDRIVE_CHECK_OP(rays, >=, 1);
  return static_cast<std::int64_t>((pixels() + rays - 1) / rays);
}

PixelDraw PixelSampler::draw(std::uint64_t first, int epoch_rays, int error_map_rays) const {
  REDRIVE_CHECK_OP(epoch_rays, >=, 1);
  const std::uint64_t epoch = first / pixels(), begin = first % pixels();
  return {static_cast<int>(std::min<std::uint64_t>(epoch_rays, pixels() - begin)),
          error_map_rays,
          epoch,
          begin,
          random_key(seed_, kStreamPixels, epoch),
          random_key(seed_, kStreamErrorRays, first),
          random_key(seed_, kStreamBackground, first)};
}

GatheredRays PixelSampler::resize_batch(const PixelDraw& draw, RayBatch* batch) const {
  resize(batch, draw.epoch_rays + draw.error_map_rays, true);
  const std::size_t n = batch->n;
  batch->error_map_rays = draw.error_map_rays;
  batch->exposure.resize(n);
  batch->view.resize(n);
  batch->cell.resize(draw.error_map_rays > 0 ? n : 0);
  batch->weight.resize(batch->cell.size());
  batch->background.resize(scene_.background == Background::kNone ? 0 : 3 * n);
  return {batch->origin, batch->direction, batch->target, batch->background, batch->pixel_angle,
          batch->weight, batch->exposure,  batch->view,   batch->cell};
}

void PixelSampler::gather(std::uint64_t first, int epoch_rays, RayBatch* batch,
                          const ErrorMapRays& more) const {
  REDRIVE_CHECK(more.n == 0 || more.errors.size() == cells_.size());
  const PixelDraw pixels = draw(first, epoch_rays, more.n);
  gather_pixels(source_, pixels, more.errors, resize_batch(pixels, batch));
}

}  // namespace redrive

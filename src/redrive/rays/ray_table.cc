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

/// How rarely a pixel that is wholly transparent is drawn.
constexpr int kEpochsPerEmptyPixel = 4;

std::optional<std::size_t> entry_of(const RayTable& table, std::uint32_t pixel) {
  if (table.pixel.size() == std::size_t(table.width) * table.height) return pixel;  // the camera reaches all
  const auto found = std::ranges::lower_bound(table.pixel, pixel);
  if (found == table.pixel.end() || *found != pixel) return std::nullopt;
  return found - table.pixel.begin();
}

/// Of a pixel that the camera reaches, by its mask and alpha.
float share_of(const Image8& image, std::size_t pixel) {
  if (!image.used.empty() && image.used[pixel] == 0) return 0;
  return !image.alpha.empty() && image.alpha[pixel] == 0 ? 1.0f / kEpochsPerEmptyPixel : 1;
}

void resize(RayBatch* batch, int n, bool with_target) {
  batch->n = n;
  batch->origin.resize(3 * std::size_t(n));
  batch->direction.resize(3 * std::size_t(n));
  batch->target.resize(with_target ? 3 * std::size_t(n) : 0);
  batch->pixel_angle.resize(n);
  batch->background.clear();
  batch->weight.clear();
  batch->cell.clear();
  batch->by_error = 0;
}

/// Ray `i` of the batch: entry `k` of the table, turned in double so that its length stays 1 to float's rounding.
void set_ray(const RayTable& table, std::size_t k, const ShutterPoses& poses, int i, RayBatch* batch) {
  const Rigid3d world_from_camera = poses.at_row(static_cast<int>(table.pixel[k]) / table.width, table.height);
  const Eigen::Vector3d in_camera(table.direction[3 * k], table.direction[3 * k + 1], table.direction[3 * k + 2]);
  const Eigen::Vector3d in_world = world_from_camera.linear() * in_camera;
  for (int d = 0; d < 3; ++d) {
    batch->origin[std::size_t(d) * batch->n + i] = static_cast<float>(world_from_camera.translation()[d]);
    batch->direction[std::size_t(d) * batch->n + i] = static_cast<float>(in_world[d]);
  }
  batch->pixel_angle[i] = table.pixel_angle;
}

/// Mean over a coarse lattice of pixels; the smallest positive float of a camera that sees nothing.
float mean_pixel_angle(const Camera& camera) {
  constexpr int kLattice = 32;
  double sum = 0;
  int count = 0;
  for (int j = 0; j < kLattice; ++j)
    for (int i = 0; i < kLattice; ++i) {
      const Eigen::Vector2d pixel((i + 0.5) / kLattice * camera.width - 0.5,
                                  (j + 0.5) / kLattice * camera.height - 0.5);
      const auto here = camera.unproject(pixel), right = camera.unproject(pixel + Eigen::Vector2d(0.5, 0)),
                 below = camera.unproject(pixel + Eigen::Vector2d(0, 0.5));
      if (!here || !right || !below) continue;
      sum += 4 * (*right - *here).cross(*below - *here).norm();
      ++count;
    }
  return count > 0 ? static_cast<float>(std::sqrt(sum / count)) : std::numeric_limits<float>::min();
}

}  // namespace

RayTable make_ray_table(const Camera& camera, int threads) {
  constexpr int kRowsOfRange = 16;
  struct Rows {
    std::vector<std::uint32_t> pixel;
    std::vector<float> direction;
  };
  std::vector<Rows> parts((camera.height + kRowsOfRange - 1) / kRowsOfRange);
  ThreadPool(threads).run_ranges(camera.height, kRowsOfRange, [&](std::size_t begin, std::size_t end) {
    Rows& rows = parts[begin / kRowsOfRange];
    for (std::size_t y = begin; y < end; ++y)
      for (int x = 0; x < camera.width; ++x) {
        const auto direction = camera.unproject({x, y});
        if (!direction) continue;
        rows.pixel.push_back(static_cast<std::uint32_t>(y * camera.width + x));
        for (int d = 0; d < 3; ++d) rows.direction.push_back(static_cast<float>((*direction)[d]));
      }
  });
  RayTable table{camera.width, camera.height, {}, {}, mean_pixel_angle(camera)};
  for (const Rows& rows : parts) {
    table.pixel.insert(table.pixel.end(), rows.pixel.begin(), rows.pixel.end());
    table.direction.insert(table.direction.end(), rows.direction.begin(), rows.direction.end());
  }
  return table;
}

PixelSquares squares_of(const RayTable& table) {
  constexpr std::uint32_t kNone = ~0u;
  constexpr int kLarge = 16;
  std::vector<std::uint32_t> entry_of(static_cast<std::size_t>(table.width) * table.height, kNone);
  for (std::size_t k = 0; k < table.pixel.size(); ++k) entry_of[table.pixel[k]] = static_cast<std::uint32_t>(k);
  PixelSquares squares;
  squares.entry.reserve(table.pixel.size());
  squares.first = {0};
  const auto add_square = [&](int left, int top) {
    for (int y = top; y < std::min(top + 2, table.height); ++y)
      for (int x = left; x < std::min(left + 2, table.width); ++x)
        if (const std::uint32_t k = entry_of[static_cast<std::size_t>(y) * table.width + x]; k != kNone)
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

void view_rays(const RayTable& table, const ShutterPoses& world_from_camera, std::span<const std::uint32_t> entries,
               RayBatch* batch) {
  resize(batch, static_cast<int>(entries.size()), false);
  for (std::size_t i = 0; i < entries.size(); ++i)
    set_ray(table, entries[i], world_from_camera, static_cast<int>(i), batch);
}

UsedPixels::UsedPixels(const RayTable& table, const std::vector<std::uint8_t>& used)
    : bits_((table.pixel.size() + 63) / 64), before_(bits_.size() + 1) {
  REDRIVE_CHECK_OP(used.size(), ==, std::size_t(table.width) * table.height);
  for (std::size_t k = 0; k < table.pixel.size(); ++k)
    if (used[table.pixel[k]] != 0) bits_[k / 64] |= std::uint64_t{1} << (k % 64);
  for (std::size_t word = 0; word < bits_.size(); ++word)
    before_[word + 1] = before_[word] + std::popcount(bits_[word]);
}

std::size_t UsedPixels::entry(std::size_t k) const {
  const std::size_t word = std::upper_bound(before_.begin(), before_.end(), k) - before_.begin() - 1;
  std::uint64_t bits = bits_[word];
  for (std::size_t skip = k - before_[word]; skip > 0; --skip) bits &= bits - 1;
  return 64 * word + std::countr_zero(bits);
}

PixelSampler::PixelSampler(const Scene& scene, const std::vector<Image8>& images, std::uint64_t seed)
    : scene_(scene), images_(images), seed_(seed) {
  REDRIVE_CHECK_OP(images.size(), ==, scene.views.size());
  for (const RigCamera& camera : scene.rig) tables_.push_back(make_ray_table(camera.camera));
  offsets_.push_back(0);
  for (std::size_t i = 0; i < scene.views.size(); ++i) {
    const View& view = scene.views[i];
    if (view.held_out) continue;
    const RayTable& table = tables_[view.camera];
    const Image8& image = images[i];
    REDRIVE_CHECK_OP(image.width, ==, table.width);
    REDRIVE_CHECK_OP(image.height, ==, table.height);
    training_views_.push_back({static_cast<int>(i), scene.shutter_poses(view)});
    const int training_view = static_cast<int>(training_views_.size()) - 1;
    std::vector<float> share(image.rgb.size() / 3);
    for (const std::uint32_t pixel : table.pixel) share[pixel] = share_of(image, pixel);
    cells_.add(image.width, image.height, share);
    if (image.used.empty() && image.alpha.empty()) {
      add({training_view, std::nullopt, 1}, table.pixel.size());
      continue;
    }
    for (const int every : {1, kEpochsPerEmptyPixel}) {  // what there is to see, and what is wholly transparent
      std::vector<std::uint8_t> used(share.size());
      for (std::size_t pixel = 0; pixel < used.size(); ++pixel) used[pixel] = share[pixel] == 1.0f / every;
      Pool pool{training_view, UsedPixels(table, used), every};
      const std::size_t size = pool.used->size();
      if (size > 0) add(std::move(pool), size);
    }
  }
  const auto first = std::ranges::find(scene.views, false, &View::held_out);
  REDRIVE_CHECK(first != scene.views.end());
  if (pixels() == 0)
    throw InputError(first->image, "", "",
                     "masks and camera models leave no pixel of this and all other training images");
}

void PixelSampler::place() {
  for (TrainingView& view : training_views_) view.world_from_camera = scene_.shutter_poses(scene_.views[view.view]);
}

void PixelSampler::add(Pool pool, std::size_t size) {
  offsets_.push_back(offsets_.back() + (size + pool.every - 1) / pool.every);
  pools_.push_back(std::move(pool));
}

std::int64_t PixelSampler::steps_per_epoch(int rays) const {
  REDRIVE_CHECK_OP(rays, >=, 1);
  return static_cast<std::int64_t>((pixels() + rays - 1) / rays);
}

PixelSampler::Drawn PixelSampler::of_epoch(std::uint64_t epoch, std::uint64_t key, std::uint64_t k) const {
  const std::uint64_t drawn = permute_index(key, k, pixels());
  const std::size_t p = std::upper_bound(offsets_.begin(), offsets_.end(), drawn) - offsets_.begin() - 1;
  const Pool& pool = pools_[p];
  std::size_t entry = (drawn - offsets_[p]) * pool.every + epoch % pool.every;
  if (pool.used) entry = pool.used->entry(std::min(entry, pool.used->size() - 1));  // the last may be drawn twice
  return {pool.training_view, entry};
}

/// A pixel of the cell by its share: pixels are drawn evenly until one is taken. Where few can be, that takes long, but such cells are
/// drawn as rarely.
PixelSampler::Drawn PixelSampler::by_error(std::span<const float> errors, std::uint64_t key,
                                           PixelCells::Candidates* candidates) const {
  const PixelCells::Rect rect = cells_.rect(cells_.draw(errors, key, candidates));
  const TrainingView& from = training_views_[rect.picture];
  const RayTable& table = tables_[scene_.views[from.view].camera];
  const Image8& image = images_[from.view];
  const std::uint64_t pixel_key = mix64(key);
  for (std::uint64_t i = 0;; ++i) {
    const std::uint64_t bits = random_bits(pixel_key, i);
    const auto x = rect.x + static_cast<int>((bits >> 44) * rect.width >> 20),
               y = rect.y + static_cast<int>((bits >> 24 & 0xfffff) * rect.height >> 20);
    const auto pixel = static_cast<std::uint32_t>(y) * table.width + x;
    if (static_cast<float>(bits & 0xffffff) * 0x1p-24f >= share_of(image, pixel)) continue;
    if (const auto entry = entry_of(table, pixel)) return {rect.picture, *entry};
  }
}

void PixelSampler::set(const Drawn& drawn, int i, RayBatch* batch) const {
  const TrainingView& from = training_views_[drawn.training_view];
  const View& view = scene_.views[from.view];
  const RayTable& table = tables_[view.camera];
  const Image8& image = images_[from.view];
  set_ray(table, drawn.entry, from.world_from_camera, i, batch);
  batch->exposure[i] = scene_.exposure(view);
  batch->view[i] = static_cast<std::uint32_t>(from.view);
  const std::size_t pixel = table.pixel[drawn.entry];
  const auto behind = rendered_background(scene_.background);
  for (int c = 0; c < 3; ++c) {
    const std::size_t at = std::size_t(c) * batch->n + i;
    batch->target[at] = image.rgb[3 * pixel + c] / 255.0f;
    if (scene_.random_behind)
      batch->target[at] += (1 - image.alpha[pixel] / 255.0f) * (batch->background[at] - behind[c]);
  }
  if (!batch->cell.empty()) batch->cell[i] = cells_.at(drawn.training_view, static_cast<std::uint32_t>(pixel));
}

void PixelSampler::gather(std::uint64_t first, int even, RayBatch* batch, const RaysByError& more) const {
  REDRIVE_CHECK_OP(even, >=, 1);
  REDRIVE_CHECK(more.n == 0 || more.errors.size() == cells_.size());
  const std::uint64_t epoch = first / pixels(), begin = first % pixels();
  even = static_cast<int>(std::min<std::uint64_t>(even, pixels() - begin));
  resize(batch, even + more.n, true);
  batch->by_error = more.n;
  batch->exposure.resize(batch->n);
  batch->view.resize(batch->n);
  batch->cell.resize(more.n > 0 ? batch->n : 0);
  if (scene_.background != Background::kNone)
    batch->background.assign(3 * std::size_t(batch->n), rendered_background(scene_.background)[0]);
  const std::uint64_t background_key = random_key(seed_, kStreamBackground, first);
  if (scene_.random_behind)
    for (std::size_t i = 0; i < batch->background.size(); ++i) batch->background[i] = random_unit(background_key, i);
  const std::uint64_t epoch_key = random_key(seed_, kStreamPixels, epoch),
                      error_key = random_key(seed_, kStreamErrorRays, first);
  for (int i = 0; i < even; ++i) set(of_epoch(epoch, epoch_key, begin + i), i, batch);
  PixelCells::Candidates candidates;
  for (int i = 0; i < more.n; ++i) set(by_error(more.errors, random_bits(error_key, i), &candidates), even + i, batch);
  const float share = static_cast<float>(more.n) / static_cast<float>(batch->n);
  batch->weight.resize(batch->cell.size());
  for (std::size_t i = 0; i < batch->weight.size(); ++i)
    batch->weight[i] = ray_weight(more.errors[batch->cell[i]], candidates.mean_error(), share);
}

}  // namespace redrive

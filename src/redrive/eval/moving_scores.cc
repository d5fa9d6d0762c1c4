// SPDX-License-Identifier: Apache-2.0
#include "redrive/eval/moving_scores.h"

#include <algorithm>
#include <limits>
#include <utility>

#include "redrive/optim/ssim.h"

namespace redrive {
namespace {

/// The smallest part of an image with all pixels of an object and the windows of SSIM around them.
struct Part {
  int x = 0, y = 0, width = 0, height = 0;

  std::size_t index(int column, int row, int image_width) const {
    return static_cast<std::size_t>(y + row) * image_width + static_cast<std::size_t>(x + column);
  }
};

/// Returns the part with the pixels that count, and their number.
std::pair<Part, std::int64_t> part_of(const std::vector<std::uint8_t>& counts, int width,
                                      int height) {
  int left = width, right = -1, top = height, bottom = -1;
  std::int64_t pixels = 0;
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      if (!counts[static_cast<std::size_t>(y) * width + x]) continue;
      ++pixels;
      left = std::min(left, x);
      right = std::max(right, x);
      top = std::min(top, y);
      bottom = std::max(bottom, y);
    }
  if (pixels == 0) return {};
  left = std::max(left - kSsimRadius, 0);
  top = std::max(top - kSsimRadius, 0);
  return {{left, top, std::min(right + kSsimRadius + 1, width) - left,
           std::min(bottom + kSsimRadius + 1, height) - top},
          pixels};
}

/// Returns the score of the pixels that count, in their part of the image.
Score score_part(kernels::Backend& backend, const RenderedImage& rendered,
                 const Image8& ground_truth, const std::vector<std::uint8_t>& counts,
                 const Part& part) {
  RenderedImage own;
  own.width = part.width;
  own.height = part.height;
  Image8 target;
  target.width = part.width;
  target.height = part.height;
  for (int row = 0; row < part.height; ++row)
    for (int column = 0; column < part.width; ++column) {
      const std::size_t i = part.index(column, row, rendered.width);
      own.valid.push_back(counts[i]);
      for (std::size_t c = 0; c < 3; ++c) {
        own.rgb.push_back(rendered.rgb[3 * i + c]);
        target.rgb.push_back(ground_truth.rgb[3 * i + c]);
      }
    }
  Score score = score_image(backend, own, target);
  score.flip = std::numeric_limits<double>::quiet_NaN();
  return score;
}

}  // namespace

MovingScores::MovingScores(const Run& run, kernels::Backend& backend)
    : backend_(backend), objects_(run.moving) {}

void MovingScores::add(const Scene& scene, const View& view, const Mask& of_camera,
                       const RenderedImage& rendered, const Image8& ground_truth) {
  if (objects_.objects().empty()) return;
  const std::vector<std::uint32_t> map = object_map(scene, view, objects_);
  const auto score = [&](bool inside) {
    Mask mask = of_camera;
    for (std::size_t i = 0; i < map.size(); ++i)
      if ((map[i] != 0) != inside) mask.used[i] = 0;
    Image8 of_part = ground_truth;
    apply_mask(mask, &of_part);
    return score_image(backend_, rendered, of_part);
  };
  outside_.add(score(false));
  std::vector<std::uint8_t> there(objects_.objects().size() + 1);
  for (const std::uint32_t object : map) there[object] = 1;
  std::int64_t pixels = 0;
  for (std::uint32_t object = 1; object < there.size(); ++object) {
    if (!there[object]) continue;
    std::vector<std::uint8_t> counts(map.size());
    for (std::size_t i = 0; i < map.size(); ++i)
      counts[i] = map[i] == object && rendered.valid[i] && of_camera.used[i] &&
                  (ground_truth.used.empty() || ground_truth.used[i]);
    const auto [part, of_object] = part_of(counts, rendered.width, rendered.height);
    pixels += of_object;
    if (of_object >= kLeastObjectPixels)
      of_object_[object - 1].add(score_part(backend_, rendered, ground_truth, counts, part));
  }
  if (pixels < kLeastObjectPixels) return;
  inside_.add(score(true));
  ++images_;
}

std::optional<MovingEvaluation> MovingScores::mean() const {
  if (images_ == 0) return std::nullopt;
  MovingEvaluation moving{inside_.mean(), outside_.mean(), {}};
  for (const auto& [index, sum] : of_object_) {
    const MovingObject& object = objects_.objects()[index];
    moving.objects[object.id] = {object.type, sum.mean()};
  }
  return moving;
}

}  // namespace redrive

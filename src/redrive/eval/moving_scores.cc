// SPDX-License-Identifier: Apache-2.0
#include "redrive/eval/moving_scores.h"

#include <algorithm>
#include <cmath>

namespace redrive {
namespace {

struct MaskedScore {
  double psnr_db = 0;
  std::int64_t pixels = 0;
};
/// Returns the PSNR over the pixels of an object, as object_map numbers it.
MaskedScore masked_psnr(const RenderedImage& rendered, const Image8& ground_truth,
                        const std::vector<std::uint32_t>& map, std::uint32_t object,
                        const Mask& of_camera) {
  double squares = 0;
  MaskedScore out;
  for (std::size_t i = 0; i < map.size(); ++i) {
    if (map[i] != object || !rendered.valid[i] || !of_camera.used[i]) continue;
    ++out.pixels;
    for (std::size_t c = 0; c < 3; ++c) {
      const double off = double(rendered.rgb[3 * i + c]) - ground_truth.rgb[3 * i + c] / 255.0;
      squares += off * off;
    }
  }
  const double mse = squares / static_cast<double>(std::max<std::int64_t>(3 * out.pixels, 1));
  out.psnr_db = std::min(-10 * std::log10(std::max(mse, 1e-12)), kPsnrCapDb);
  return out;
}

}  // namespace

MovingScores::MovingScores(const Run& run, kernels::Backend& backend)
    : backend_(backend), objects_(read_moving_objects(run.recording, run.scene)) {}

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
    const MaskedScore of_object = masked_psnr(rendered, ground_truth, map, object, of_camera);
    pixels += of_object.pixels;
    if (of_object.pixels < kLeastObjectPixels) continue;
    OfObject& sum = of_object_[object - 1];
    sum.psnr_db += of_object.psnr_db;
    ++sum.images;
  }
  if (pixels < kLeastObjectPixels) return;
  inside_.add(score(true));
  ++images_;
}

void MovingScores::finish(Evaluation* evaluation) const {
  if (images_ == 0) return;
  evaluation->moving = MovingEvaluation{inside_.mean(), outside_.mean(), {}};
  for (const auto& [index, sum] : of_object_) {
    const MovingObject& object = objects_.objects()[index];
    evaluation->moving->objects[object.id] = {object.type, sum.psnr_db / sum.images, sum.images};
  }
}

}  // namespace redrive

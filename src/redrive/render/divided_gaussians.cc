// SPDX-License-Identifier: Apache-2.0
// The Gaussians of a drive in blocks: the world's as one set, and objects that a block shows
// without having trained on them.
#include <cmath>
#include <utility>

#include "redrive/base/error.h"
#include "redrive/field/gaussian_blocks.h"
#include "redrive/model/gaussian_layout.h"
#include "redrive/render/divided_field.h"

namespace redrive {
namespace {

/// Returns a Gaussian's number at the brightness that log_gains make up for.
float brightened(float number, int row, const LogGains& log_gains) {
  const bool is_colour = row >= kColourRow && row < kLidarRow;
  return is_colour ? static_cast<float>(std::exp(log_gains[(row - kColourRow) % 3]) * number)
                   : number;
}

}  // namespace

const DividedField::Body& DividedField::body_of(std::int64_t id) const {
  if (const auto known = bodies_.find(id); known != bodies_.end()) return known->second;
  Body most;
  MovingObject object;
  object.id = id;
  for (int b = 0; b < drive_.way.blocks(); ++b) {
    std::shared_ptr<const LoadedBlock> block;
    try {
      block = cache_.get(b);
    } catch (const InputError&) {  // get() throws it again where an image needs the block
      continue;
    }
    const FieldGaussians* const own = block->model->as_gaussians();
    if (!own || !own->has_body(id)) continue;
    ActorBody body = own->body(object);
    if (body.n > (most.gaussians ? most.gaussians->n : 0))
      most = {std::make_shared<const ActorBody>(std::move(body)), mean_log_gains(b)};
  }
  return bodies_.emplace(id, std::move(most)).first->second;
}

std::shared_ptr<const ActorBody> DividedField::borrowed(int block, const Field& field,
                                                        std::int64_t id,
                                                        std::array<float, 3>* gain) const {
  const FieldGaussians* const own = field.as_gaussians();
  if (!own || own->has_body(id)) return nullptr;
  const Body& body = body_of(id);
  const LogGains here = mean_log_gains(block);
  for (int c = 0; body.gaussians && c < 3; ++c)
    (*gain)[c] *= static_cast<float>(std::exp(body.log_gains[c] - here[c]));
  return body.gaussians;
}

ActorBody DividedField::body(const MovingObject& actor) const {
  ActorBody out;
  out.type = actor.type;
  out.size_m = actor.size_m;
  const Body& own = body_of(actor.id);
  if (!own.gaussians) return out;
  out.n = own.gaussians->n;
  out.numbers = Buffer<float>(own.gaussians->numbers.size());
  clear_unused(out.n, gaussian_blocks(out.n) * kGaussianBlock, out.numbers.data());
  for (std::size_t i = 0; i < out.n; ++i)
    for (int row = 0; row < kGaussianRows; ++row) {
      const std::size_t slot = gaussian_slot(i, row);
      out.numbers[slot] = brightened(own.gaussians->numbers[slot], row, own.log_gains);
    }
  return out;
}

WorldGaussians DividedField::world() const {
  std::vector<GaussianList> list(1);
  WorldGaussians merged{};
  for (int b = 0; b < drive_.way.blocks(); ++b) {
    const auto loaded = cache_.get(b);
    const FieldGaussians* const own = loaded->model->as_gaussians();
    REDRIVE_CHECK(own != nullptr);
    const LogGains log_gains = mean_log_gains(b);
    const WorldGaussians world = own->world();
    for (int c = 0; c < 3; ++c)
      merged.background[c] +=
          brightened(world.background[c], kColourRow + c, log_gains) / float(drive_.way.blocks());
    for (std::size_t i = 0; i < world.gaussians.n; ++i) {
      const auto at = [&](int row) { return world.gaussians.numbers[gaussian_slot(i, row)]; };
      const Eigen::Vector3d position(at(kPositionRow), at(kPositionRow + 1), at(kPositionRow + 2));
      if (drive_.way.block_at(drive_.way.place(position)) != b) continue;
      for (int row = 0; row < kGaussianRows; ++row)
        list[0].rows.push_back(brightened(at(row), row, log_gains));
    }
  }
  const GaussianLayout layout = layout_of(list);
  merged.numbers = Buffer<float>(layout.blocks() * kBlockSize);
  write_blocks(list, layout, &merged.numbers);
  merged.gaussians = {layout.world, merged.numbers};
  return merged;
}

}  // namespace redrive

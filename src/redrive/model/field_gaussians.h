// SPDX-License-Identifier: Apache-2.0
// The Gaussians of a field that consists of them: for files, pages and other fields.
#pragma once

#include <array>
#include <cstdint>

#include "redrive/base/buffer.h"
#include "redrive/edit/actor_body.h"
#include "redrive/kernels/gaussian/gaussian_stages.h"
#include "redrive/scene/moving_object.h"

namespace redrive {

struct WorldGaussians {
  kernels::Gaussians gaussians;     ///< in `numbers`, or in the field, which then must outlive them
  Buffer<float> numbers;            ///< empty: the field keeps them
  std::array<float, 3> background;  ///< colour where no Gaussian is, 0..1
};

class FieldGaussians {
 public:
  virtual ~FieldGaussians() = default;

  /// Returns the Gaussians of the static world, without moving objects.
  virtual WorldGaussians world() const = 0;
  /// Whether an object of this id was trained and has Gaussians.
  virtual bool has_body(std::int64_t id) const = 0;
  /// Returns the Gaussians of an object that was trained, in the axes of its box; empty for others.
  virtual ActorBody body(const MovingObject& actor) const = 0;
};

}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
// Working memory that is used in the same order again and again: nothing is allocated once every place has been at its largest.
#pragma once

#include <memory>
#include <vector>

#include "redrive/base/buffer.h"
#include "redrive/kernels/kernels.h"

namespace redrive {

class Workspace {
 public:
  /// From here on the places are handed out from the first on again, kept by the backend that computes with them: the host fetches what it
  /// reads of what stages wrote, and puts what it wrote for them.
  void begin(kernels::Backend& backend) {
    backend_ = &backend;
    next_ = 0;
  }

  /// The next place, at least n numbers, whatever they are; valid until the next begin().
  std::span<float> take(std::size_t n) {
    if (next_ == places_.size()) places_.emplace_back();
    Buffer<float>& place = places_[next_++];
    if (place.size() < n) place = Buffer<float>(n);
    kernels::keep(*backend_, place);
    return place.span().first(n);
  }

 private:
  kernels::Backend* backend_ = nullptr;
  std::vector<Buffer<float>> places_;
  std::size_t next_ = 0;
};

}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
// Loading, side by side, of what is used in turn.
#pragma once

#include <algorithm>
#include <cstddef>
#include <optional>
#include <type_traits>
#include <utility>
#include <vector>

#include "redrive/base/parallel.h"

namespace redrive {

/// Calls use(i, load(i)) for i in [0, n), in order. Loads up to 8 at a time, so that they fit into
/// memory; `use` may run on the pool, `load` may not.
template <class Load, class Use>
void for_each_loaded(std::size_t n, ThreadPool& pool, const Load& load, const Use& use) {
  using Loaded = std::invoke_result_t<const Load&, std::size_t>;
  const auto at_a_time = static_cast<std::size_t>(std::min(pool.threads(), 8));
  for (std::size_t begin = 0; begin < n; begin += at_a_time) {
    std::vector<std::optional<Loaded>> loaded(std::min(at_a_time, n - begin));
    pool.run(static_cast<int>(loaded.size()), [&](int k) {
      loaded[static_cast<std::size_t>(k)].emplace(load(begin + static_cast<std::size_t>(k)));
    });
    for (std::size_t k = 0; k < loaded.size(); ++k) {
      use(begin + k, std::move(*loaded[k]));
      loaded[k].reset();
    }
  }
}

}  // namespace redrive

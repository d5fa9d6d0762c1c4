// SPDX-License-Identifier: Apache-2.0
#include "redrive/render/merged_gaussians.h"

#include <cmath>

#include "redrive/base/error.h"
#include "redrive/methods/splat/splat_model.h"
#include "redrive/render/divided_model.h"

namespace redrive {

MergedGaussians merged_gaussians(const DividedModel& model) {
  const BlockWay& way = model.drive().way;
  std::vector<GaussianList> list(1);
  for (int b = 0; b < way.blocks(); ++b) {
    const auto loaded = model.cache().get(b);
    const auto* const splat = dynamic_cast<const SplatModel*>(loaded->model.get());
    REDRIVE_CHECK(splat != nullptr);
    const LogGains log_gains = model.mean_log_gains(b);
    const kernels::Gaussians world = splat->world();
    for (std::size_t i = 0; i < world.n; ++i) {
      const auto at = [&](int row) { return world.numbers[gaussian_slot(i, row)]; };
      const Eigen::Vector3d position(at(kPositionRow), at(kPositionRow + 1), at(kPositionRow + 2));
      if (way.block_at(way.place(position)) != b) continue;
      for (int row = 0; row < kGaussianRows; ++row) {
        const bool colour = row >= kColourRow && row < kDistanceRow;
        const double gain = colour ? std::exp(log_gains[(row - kColourRow) % 3]) : 1;
        list[0].rows.push_back(static_cast<float>(gain * at(row)));
      }
    }
  }
  const GaussianLayout layout = layout_of(list);
  MergedGaussians merged{list[0].size(), Buffer<float>(layout.blocks() * kBlockSize)};
  write_blocks(list, layout, &merged.numbers);
  return merged;
}

}  // namespace redrive

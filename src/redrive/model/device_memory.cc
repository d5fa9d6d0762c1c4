// SPDX-License-Identifier: Apache-2.0
#include "redrive/model/device_memory.h"

#include <utility>

namespace redrive {
namespace {

/// Hides the parameters' resident copy until it goes out of scope.
class WithoutDeviceCopy {
 public:
  explicit WithoutDeviceCopy(const Buffer<float>& numbers)
      : numbers_(numbers), kept_(std::exchange(numbers.resident, nullptr)) {}
  ~WithoutDeviceCopy() { numbers_.resident = std::move(kept_); }
  WithoutDeviceCopy(const WithoutDeviceCopy&) = delete;
  WithoutDeviceCopy& operator=(const WithoutDeviceCopy&) = delete;

 private:
  const Buffer<float>& numbers_;
  std::shared_ptr<void> kept_;
};

}  // namespace

std::optional<std::uint64_t> count_device_bytes(const kernels::Backend& backend, const Model& model,
                                                const DeviceWork& work) {
  kernels::MemoryCount count;
  const auto counting = backend.counting(&count);
  if (!counting) return std::nullopt;
  const WithoutDeviceCopy without_copy(model.parameters);
  Buffer<float> gradients(work.step_pixels > 0 ? model.size() : 0);
  std::shared_ptr<void> moments[2];
  if (work.trains) {
    kernels::make_resident(*counting, gradients);
    for (auto& moment : moments) moment = counting->make_resident(gradients.span());
  }
  Workspace workspace;
  // Which slots of the workspace a batch takes depends on whether some of its rays are inactive;
  // each slot keeps its largest size.
  for (const bool all_active : {true, false, true}) {
    count.all_active = all_active;
    model.rehearse(*counting, work, gradients, &workspace);
    if (work.scored_width > 0) {
      const std::size_t n = static_cast<std::size_t>(work.scored_width) * work.scored_height;
      const std::vector<float> rgb(3 * n);
      const std::vector<std::uint8_t> ground_truth(3 * n), mask(n);
      counting->score({work.scored_width, work.scored_height, rgb, ground_truth, mask});
    }
  }
  return count.most;
}

}  // namespace redrive

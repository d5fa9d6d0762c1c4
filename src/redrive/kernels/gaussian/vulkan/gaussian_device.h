// SPDX-License-Identifier: Apache-2.0
// What the Gaussian stages of a Vulkan device share: shaders, working memory, and the Gaussians in
// training, which stay on the device from step to step.
#pragma once

#include <cstring>
#include <span>
#include <string_view>
#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/kernels/gaussian/gaussian_stages.h"
#include "redrive/kernels/gaussian/vulkan/kept_targets.h"
#include "redrive/kernels/vulkan/vulkan_queue.h"

namespace redrive::kernels::vulkan {

/// Arguments of a shader, laid out as its push constants.
class Push {
 public:
  template <class... T>
  explicit Push(const T&... values) {
    (add(values), ...);
  }
  std::span<const std::byte> bytes() const { return {bytes_, size_}; }

 private:
  template <class T>
  void add(const T& value) {
    size_ = (size_ + sizeof(T) - 1) / sizeof(T) * sizeof(T);
    std::memcpy(bytes_ + size_, &value, sizeof(T));
    size_ += sizeof(T);
  }
  void add(const DeviceBuffer& buffer) { add(buffer.address()); }

  std::byte bytes_[112] = {};
  std::size_t size_ = 0;
};

/// Dispatches one of gaussian_shaders().
void run(Queue* queue, std::string_view shader, const Push& push, std::size_t groups,
         std::initializer_list<std::uint32_t> constants = {});

/// Words of a pass's control buffer (common.glsl) and of its dispatches (plan.comp), in bytes.
constexpr std::uint32_t kDrawnAt = 0, kPairsAt = 1, kOverflowAt = 2, kControlWords = 96;
struct Dispatches {
  std::size_t first;  ///< 0: by drawn Gaussian, 1: by pair

  std::size_t by_256() const { return at(0); }
  std::size_t by_sorted_group() const { return at(4); }
  std::uint32_t counts_word() const { return static_cast<std::uint32_t>(at(8) / 4); }
  std::size_t by_counts_scanned() const { return at(12); }
  std::size_t by_scanned() const { return at(16); }
  std::size_t by_16() const { return at(20); }
  std::size_t by_64() const { return at(24); }
  std::size_t by_segment() const { return at(28); }

 private:
  std::size_t at(std::size_t word) const { return 4 * (16 + 32 * first + word); }
};

class GaussianDevice {
 public:
  GaussianDevice(Queue* queue, ThreadPool* pool) : targets(queue), queue_(*queue), pool_(*pool) {}

  Queue& queue() { return queue_; }
  ThreadPool& pool() { return pool_; }
  void run(std::string_view shader, const Push& push, std::size_t groups,
           std::initializer_list<std::uint32_t> constants = {}) {
    vulkan::run(&queue_, shader, push, groups, constants);
  }
  void run_indirect(std::string_view shader, const Push& push, const DeviceBuffer& control,
                    std::size_t at, std::initializer_list<std::uint32_t> constants = {});

  /// Sums `numbers` before each, in place; n is control[n_at]. `scanned`: place of the dispatch.
  void scan(const DeviceBuffer& numbers, const DeviceBuffer& control, std::uint32_t n_at,
            std::uint32_t total_at, std::size_t scanned);
  /// A pass of a stable sort by 8 bits of the keys. values: null: 0, 1, ...
  struct SortBuffers {
    const DeviceBuffer *keys, *values, *keys_out, *values_out;
  };
  void sort_pass(const SortBuffers& buffers, const DeviceBuffer& control, std::uint32_t n_at,
                 const Dispatches& by, std::uint32_t shift);

  /// Returns the numbers of Gaussians that have a version, which are uploaded once. Null: they have
  /// none, or others are in training.
  const DeviceBuffer* held(const Gaussians& gaussians);
  /// Makes the Gaussians of `update` those in training.
  void hold(const GaussianUpdate& update);
  /// GaussianStages::fetch.
  void fetch();
  /// Applies gradients() and errors() to the Gaussians in training; drawn: a pass's, or null: all
  /// n.
  void apply(const GaussianUpdate& update, std::size_t n, const DeviceBuffer* drawn,
             const DeviceBuffer* control);

  KeptTargets targets;
  /// Working memory, of any contents.
  DeviceBuffer keys[2], ids[2], first, counts, block_sums, tile_keys[2], slots, pair_sums, sums,
      gradients, errors, pose_sums;

 private:
  Queue& queue_;
  ThreadPool& pool_;
  void upload_numbers(std::span<const float> numbers, std::uint64_t version);

  DeviceBuffer numbers_, moments_, errors_in_training_, update_;
  std::uint64_t version_ = 0;                    ///< version of numbers_; 0: none
  std::size_t size_ = 0;                         ///< numbers
  std::span<float> host_numbers_, host_errors_;  ///< empty: none are in training
  std::span<std::uint32_t> host_moments_;
};

}  // namespace redrive::kernels::vulkan

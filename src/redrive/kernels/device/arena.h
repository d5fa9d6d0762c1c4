// SPDX-License-Identifier: Apache-2.0
// An arena: memory that is taken piece by piece and freed at once, since an allocation on a GPU
// waits for all its work. Once every use has reached its largest size, one block serves all of
// them.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

namespace redrive::kernels {

/// Source has allocate(bytes), aligned to kAlignment, and release(block).
template <class Source>
class Arena {
 public:
  static constexpr std::size_t kAlignment =
      256;  // as cudaMalloc; a warp reads rows as whole cache lines

  explicit Arena(Source source = {}) : source_(source) {}
  ~Arena() { release(); }
  Arena(const Arena&) = delete;
  Arena& operator=(const Arena&) = delete;

  /// Frees all pieces. Merges the blocks into one.
  void begin() {
    used_ = 0;
    if (blocks_.size() < 2) return;
    std::size_t all = 0;
    for (const Block& block : blocks_) all += block.bytes;
    release();
    add(all);
  }

  void* take(std::size_t bytes) {
    bytes = std::max<std::size_t>(1, (bytes + kAlignment - 1) / kAlignment) * kAlignment;
    if (blocks_.empty() || blocks_.back().bytes - used_ < bytes) {
      add(bytes);
      used_ = 0;
    }
    void* const memory = static_cast<std::byte*>(blocks_.back().memory) + used_;
    used_ += bytes;
    return memory;
  }

 private:
  struct Block {
    void* memory;
    std::size_t bytes;
  };

  void add(std::size_t bytes) {
    blocks_.reserve(blocks_.size() + 1);  // push_back must not throw after the allocation
    blocks_.push_back({source_.allocate(bytes), bytes});
  }
  void release() {
    for (const Block& block : blocks_) source_.release(block.memory);
    blocks_.clear();
  }

  Source source_;
  std::vector<Block> blocks_;
  std::size_t used_ = 0;  // bytes of the last block
};

}  // namespace redrive::kernels

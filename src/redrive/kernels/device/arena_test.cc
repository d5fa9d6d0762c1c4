// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/device/arena.h"

#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <map>
#include <vector>

#include <gtest/gtest.h>

namespace redrive::kernels {
namespace {

/// Memory that counts its blocks.
struct CountedMemory {
  std::map<void*, std::size_t>* blocks;
  int* allocations;

  void* allocate(std::size_t bytes) const {
    ++*allocations;
    void* const block = std::aligned_alloc(256, bytes);
    (*blocks)[block] = bytes;
    return block;
  }
  void release(void* block) const {
    EXPECT_EQ(blocks->erase(block), 1u);
    std::free(block);
  }
};

class ArenaOfCountedMemory : public testing::Test {
 protected:
  std::map<void*, std::size_t> blocks_;
  int allocations_ = 0;
};

TEST_F(ArenaOfCountedMemory, BlocksAreAlignedAndDisjoint) {
  Arena<CountedMemory> slab({&blocks_, &allocations_});
  for (int round = 0; round < 3; ++round) {
    slab.begin();
    std::vector<std::pair<std::byte*, std::size_t>> blocks;
    for (const std::size_t bytes : {1u, 256u, 0u, 257u, 100000u, 4u}) {
      auto* const block = static_cast<std::byte*>(slab.take(bytes));
      EXPECT_EQ(reinterpret_cast<std::uintptr_t>(block) % 256, 0u);
      std::memset(block, static_cast<int>(blocks.size()), bytes);
      blocks.push_back({block, bytes});
    }
    for (std::size_t i = 0; i < blocks.size(); ++i)
      for (std::size_t b = 0; b < blocks[i].second; ++b)
        ASSERT_EQ(std::to_integer<std::size_t>(blocks[i].first[b]), i)
            << "round " << round << ", byte " << b;
  }
}

TEST_F(ArenaOfCountedMemory, KeepsOneBlockForTheLargestUses) {
  Arena<CountedMemory> slab({&blocks_, &allocations_});
  const auto use = [&](std::initializer_list<std::size_t> sizes) {
    slab.begin();
    for (const std::size_t bytes : sizes) slab.take(bytes);
  };
  use({1000, 5000, 300});
  EXPECT_EQ(blocks_.size(), 3u);
  use({1000, 5000, 300});  // begins with one block for all three
  EXPECT_EQ(blocks_.size(), 1u);
  EXPECT_EQ(allocations_, 4);
  for (int again = 0; again < 5; ++again) {
    use({1000, 5000, 300});
    use({6000});
    use({});
  }
  EXPECT_EQ(allocations_, 4);
  use({9000});
  use({9000});
  EXPECT_EQ(blocks_.size(), 1u);
}

TEST_F(ArenaOfCountedMemory, ReleasesAllMemory) {
  {
    Arena<CountedMemory> slab({&blocks_, &allocations_});
    slab.take(10);
    slab.take(1 << 20);
  }
  EXPECT_TRUE(blocks_.empty());
  EXPECT_EQ(allocations_, 2);
}

}  // namespace
}  // namespace redrive::kernels

// SPDX-License-Identifier: Apache-2.0
#include "redrive/render/block_cache.h"

#include <atomic>
#include <map>
#include <mutex>
#include <stdexcept>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

namespace redrive {
namespace {

/// Counts the loads of blocks of 100 bytes.
class BlockCacheTest : public testing::Test {
 protected:
  std::shared_ptr<const LoadedBlock> load(int block) {
    const std::lock_guard lock(mutex_);
    ++loads_[block];
    if (block == broken_) throw std::runtime_error("broken");
    auto loaded = std::make_shared<LoadedBlock>();
    loaded->bytes = 100;
    return loaded;
  }
  int loads(int block) {
    const std::lock_guard lock(mutex_);
    return loads_[block];
  }
  BlockCache::Load loader() {
    return [this](int block) { return load(block); };
  }

  std::mutex mutex_;
  std::map<int, int> loads_;
  std::atomic<int> broken_ = -1;
};

TEST_F(BlockCacheTest, KeepsWhatWasUsedLastWithinItsBytes) {
  BlockCache cache(loader(), 450);
  for (int block = 0; block < 4; ++block) cache.get(block);
  EXPECT_EQ(cache.bytes(), 400u);
  cache.get(0);
  cache.get(4);  // lets 1 go
  EXPECT_EQ(cache.bytes(), 400u);
  cache.get(0);
  EXPECT_EQ(loads(0), 1);
  cache.get(1);
  EXPECT_EQ(loads(1), 2);
  EXPECT_LE(cache.bytes(), 450u);
}

TEST_F(BlockCacheTest, KeepsThreeBlocksWhateverTheirBytes) {
  BlockCache cache(loader(), 1);
  for (int block = 0; block < 10; ++block) {
    cache.get(block);
    EXPECT_LE(cache.size(), kLeastCachedBlocks);
  }
  for (int block = 7; block < 10; ++block) cache.get(block);
  for (int block = 0; block < 10; ++block) EXPECT_EQ(loads(block), 1) << block;
}

TEST_F(BlockCacheTest, ABlockThatIsUsedOutlivesItsPlace) {
  BlockCache cache(loader(), 1);
  const auto used = cache.get(0);
  for (int block = 1; block < 5; ++block) cache.get(block);
  EXPECT_EQ(used->bytes, 100u);
  EXPECT_EQ(used.use_count(), 1);
}

TEST_F(BlockCacheTest, TriesAgainAfterAnError) {
  BlockCache cache(loader(), 1000);
  broken_ = 3;
  EXPECT_THROW(cache.get(3), std::runtime_error);
  cache.prefetch(3);  // its error is left to get()
  EXPECT_THROW(cache.get(3), std::runtime_error);
  broken_ = -1;
  EXPECT_NE(cache.get(3), nullptr);
  EXPECT_EQ(cache.size(), 1u);
}

TEST_F(BlockCacheTest, LoadsAheadOnce) {
  BlockCache cache(loader(), 1000);
  cache.get(0);
  cache.prefetch(1);
  cache.prefetch(0);
  while (cache.size() < 2) std::this_thread::yield();
  cache.get(1);
  EXPECT_EQ(loads(0), 1);
  EXPECT_EQ(loads(1), 1);
}

TEST_F(BlockCacheTest, ThreadsShareALoad) {
  BlockCache cache(loader(), 1000);
  std::vector<std::thread> threads;
  for (int i = 0; i < 4; ++i)
    threads.emplace_back([&] {
      for (int block = 0; block < 5; ++block) {
        cache.prefetch(block + 1);
        cache.get(block);
      }
    });
  for (std::thread& thread : threads) thread.join();
  for (int block = 0; block < 5; ++block) EXPECT_EQ(loads(block), 1) << block;
}

}  // namespace
}  // namespace redrive

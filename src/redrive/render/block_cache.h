// SPDX-License-Identifier: Apache-2.0
// Keeps the last used blocks of a divided run in memory, and loads the next one in the background.
#pragma once

#include <condition_variable>
#include <cstdint>
#include <functional>
#include <list>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <thread>
#include <utility>

#include "redrive/model/trainee.h"

namespace redrive {

/// What rendering needs of a block.
struct LoadedBlock {
  std::unique_ptr<Trainee> model;
  Scene scene;  ///< without views
  std::uint64_t bytes = 0;
};

/// The block that renders and its neighbours on both sides.
constexpr std::size_t kLeastCachedBlocks = 3;

/// Safe to use from several threads.
class BlockCache {
 public:
  /// Called on the thread that needs the block or on the thread of prefetch(), for two blocks at a
  /// time.
  using Load = std::function<std::shared_ptr<const LoadedBlock>(int block)>;

  /// `bytes`: beyond it the least recently used blocks are evicted, but for kLeastCachedBlocks.
  BlockCache(Load load, std::uint64_t bytes) : load_(std::move(load)), most_bytes_(bytes) {}
  /// Waits for a block that is being loaded.
  ~BlockCache();
  BlockCache(const BlockCache&) = delete;
  BlockCache& operator=(const BlockCache&) = delete;

  /// Returns a block, loading it if necessary. Throws what loading throws; the next call tries
  /// again.
  std::shared_ptr<const LoadedBlock> get(int block);

  /// Begins to load a block on another thread, replacing one that waits there. get() throws what it
  /// throws.
  void prefetch(int block);

  std::uint64_t bytes() const;  ///< bytes of the loaded blocks
  std::size_t size() const;     ///< their number

 private:
  using Entry = std::pair<int, std::shared_ptr<const LoadedBlock>>;
  std::shared_ptr<const LoadedBlock> find(int block);
  std::shared_ptr<const LoadedBlock> get(int block, std::unique_lock<std::mutex>& lock);
  void run();

  const Load load_;
  const std::uint64_t most_bytes_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::list<Entry> entries_;  ///< latest first
  std::set<int> loading_;
  std::optional<int> wanted_;  ///< set by prefetch()
  bool ends_ = false;
  std::thread thread_;  ///< starts with the first prefetch()
};

}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
#include "redrive/render/block_cache.h"

#include <algorithm>
#include <exception>

namespace redrive {

BlockCache::~BlockCache() {
  {
    const std::lock_guard lock(mutex_);
    ends_ = true;
  }
  changed_.notify_all();
  if (thread_.joinable()) thread_.join();
}

/// Returns the block if it is loaded, and marks it as used last; null otherwise.
std::shared_ptr<const LoadedBlock> BlockCache::find(int block) {
  const auto found = std::ranges::find(entries_, block, &Entry::first);
  if (found == entries_.end()) return nullptr;
  entries_.splice(entries_.begin(), entries_, found);
  return entries_.front().second;
}

std::shared_ptr<const LoadedBlock> BlockCache::get(int block, std::unique_lock<std::mutex>& lock) {
  for (;;) {
    if (auto there = find(block)) return there;
    if (!loading_.contains(block)) break;
    changed_.wait(lock);
  }
  loading_.insert(block);
  lock.unlock();
  std::shared_ptr<const LoadedBlock> loaded;
  std::exception_ptr problem;
  try {
    loaded = load_(block);
  } catch (...) {
    problem = std::current_exception();
  }
  lock.lock();
  loading_.erase(block);
  changed_.notify_all();
  if (problem) std::rethrow_exception(problem);
  entries_.emplace_front(block, loaded);
  std::uint64_t bytes = 0;
  for (const Entry& entry : entries_) bytes += entry.second->bytes;
  while (entries_.size() > kLeastCachedBlocks && bytes > most_bytes_) {
    bytes -= entries_.back().second->bytes;
    entries_.pop_back();
  }
  return loaded;
}

std::shared_ptr<const LoadedBlock> BlockCache::get(int block) {
  std::unique_lock lock(mutex_);
  return get(block, lock);
}

void BlockCache::prefetch(int block) {
  {
    const std::lock_guard lock(mutex_);
    if (loading_.contains(block) ||
        std::ranges::find(entries_, block, &Entry::first) != entries_.end())
      return;
    wanted_ = block;
    if (!thread_.joinable()) thread_ = std::thread([this] { run(); });
  }
  changed_.notify_all();
}

void BlockCache::run() {
  std::unique_lock lock(mutex_);
  for (;;) {
    changed_.wait(lock, [this] { return ends_ || wanted_; });
    if (ends_) return;
    const int block = *std::exchange(wanted_, std::nullopt);
    try {
      get(block, lock);
    } catch (const std::exception&) {  // thrown again by get() where it is needed
    }
  }
}

std::uint64_t BlockCache::bytes() const {
  const std::lock_guard lock(mutex_);
  std::uint64_t bytes = 0;
  for (const Entry& entry : entries_) bytes += entry.second->bytes;
  return bytes;
}

std::size_t BlockCache::size() const {
  const std::lock_guard lock(mutex_);
  return entries_.size();
}

}  // namespace redrive

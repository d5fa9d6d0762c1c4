// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/image_cache.h"

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <exception>
#include <limits>
#include <map>
#include <mutex>
#include <new>
#include <set>
#include <thread>

#include "redrive/base/error.h"

namespace redrive {

Image8 halved(const Image8& image) {
  Image8 half;
  half.width = image.width / 2;
  half.height = image.height / 2;
  const std::size_t n = static_cast<std::size_t>(half.width) * half.height;
  half.rgb.resize(3 * n);
  if (!image.alpha.empty()) half.alpha.resize(n);
  if (!image.used.empty()) half.used.resize(n);
  for (int y = 0; y < half.height; ++y)
    for (int x = 0; x < half.width; ++x) {
      const std::size_t to = static_cast<std::size_t>(y) * half.width + x;
      const std::size_t at = static_cast<std::size_t>(2 * y) * image.width + 2 * x;
      const std::size_t from[4] = {at, at + 1, at + image.width, at + image.width + 1};
      const auto mean = [&](const std::vector<std::uint8_t>& channel, int stride, int offset) {
        int sum = 2;
        for (const std::size_t i : from) sum += channel[stride * i + offset];
        return static_cast<std::uint8_t>(sum / 4);
      };
      for (int c = 0; c < 3; ++c) half.rgb[3 * to + c] = mean(image.rgb, 3, c);
      if (!half.alpha.empty()) half.alpha[to] = mean(image.alpha, 1, 0);
      if (!half.used.empty())
        half.used[to] =
            std::ranges::all_of(from, [&](std::size_t i) { return image.used[i] != 0; });
    }
  return half;
}

std::uint64_t image_bytes(const Image8& image) {
  return image.rgb.size() + image.alpha.size() + image.used.size();
}

namespace {

constexpr std::uint64_t kNever = std::numeric_limits<std::uint64_t>::max();

}  // namespace

struct ImageCache::Impl {
  /// The order in which images are evicted, the last one first: by their next use in the plan;
  /// without one, by their last use.
  struct Rank {
    std::uint64_t next_use, unused_for;
    ImageKey key;
    auto operator<=>(const Rank&) const = default;
  };
  struct Entry {
    ImagePointer image;        ///< null while it is decoded, and after an error
    std::exception_ptr error;  ///< what Load threw
    std::uint64_t bytes = 0;   ///< counted in statistics.bytes
    Rank rank{};               ///< in `ranks` once it is decoded
  };

  int views;
  Load load;
  ImageCacheOptions options;
  std::mutex mutex;
  std::condition_variable decoded, planned;  ///< an entry is done; the decoders may find work
  bool ending = false;
  std::map<ImageKey, Entry> entries;
  std::set<Rank> ranks;
  std::uint64_t clock = 0;                              ///< calls of get()
  std::vector<ImageKey> plan;                           ///< calls of get()
  std::map<ImageKey, std::vector<std::uint64_t>> uses;  ///< uses in the plan, the next one last
  std::uint64_t at = 0;                                 ///< the plan before this index is over
  std::uint64_t scanned = 0;  ///< from `at` to here all images are decoded or begun
  Statistics statistics;
  std::vector<std::jthread> decoders;

  ~Impl() {  // runs also where a decoder could not be started
    {
      const std::lock_guard lock(mutex);
      ending = true;
    }
    planned.notify_all();
    decoders.clear();
  }

  std::uint64_t next_use(const ImageKey& key) {
    const auto found = uses.find(key);
    if (found == uses.end()) return kNever;
    std::vector<std::uint64_t>& of_key = found->second;
    while (!of_key.empty() && of_key.back() < at) of_key.pop_back();
    return of_key.empty() ? kNever : of_key.back();
  }

  Rank rank_of(const ImageKey& key) { return {next_use(key), kNever - clock, key}; }

  void rank(const ImageKey& key, Entry* entry) {
    ranks.erase(entry->rank);
    entry->rank = rank_of(key);
    ranks.insert(entry->rank);
  }

  std::uint64_t bytes_of(const ImageKey& key) const {  // at most
    return key.half ? options.image_bytes / 4 : options.image_bytes;
  }

  /// Evicts images until `key` fits, only images that the plan does not use before `from`. Returns
  /// false if it does not fit then.
  bool make_room(const ImageKey& key, std::uint64_t from) {
    for (auto last = ranks.end(); statistics.bytes + bytes_of(key) > options.bytes;) {
      if (last == ranks.begin() || (--last)->next_use < from) return false;
      const auto entry = entries.find(last->key);
      if (entry->second.image.use_count() > 1) continue;  // in use
      statistics.bytes -= entry->second.bytes;
      scanned = std::min(scanned, std::max(at, last->next_use));
      last = ranks.erase(last);
      entries.erase(entry);
    }
    return true;
  }

  /// Decodes without the lock. What fails is the error of the entry, for good.
  void decode(ImageKey key, std::unique_lock<std::mutex>* lock) {
    Entry& entry = entries[key];  // the entry stays: it is not in `ranks`
    entry.bytes = bytes_of(key);
    statistics.bytes += entry.bytes;
    statistics.most_bytes = std::max(statistics.most_bytes, statistics.bytes);
    lock->unlock();
    ImagePointer image;
    std::exception_ptr error;
    try {
      Image8 loaded = load(key.view);
      image = std::make_shared<const Image8>(key.half ? halved(loaded) : std::move(loaded));
    } catch (...) {
      error = std::current_exception();
    }
    lock->lock();
    statistics.bytes -= entry.bytes;
    entry.bytes = image ? image_bytes(*image) : 0;
    statistics.bytes += entry.bytes;
    entry.image = std::move(image);
    entry.error = error;
    decoded.notify_all();
    if (error) return;
    ++statistics.decoded;
    entry.rank = rank_of(key);
    ranks.insert(entry.rank);
  }

  /// Runs in a decoder: decodes the plan's missing images, in order, as far as they fit.
  /// Where there is no memory to note an image, get() decodes it and throws.
  void decode_ahead() {
    std::unique_lock lock(mutex);
    while (!ending) {
      while (scanned < plan.size() && entries.contains(plan[scanned])) ++scanned;
      bool decodes = scanned < plan.size() && make_room(plan[scanned], scanned + 1);
      try {
        if (decodes) decode(plan[scanned], &lock);
      } catch (const std::bad_alloc&) {
        decodes = false;
      }
      if (!decodes && !ending) planned.wait(lock);
    }
  }
};

ImageCache::ImageCache(int views, Load load, const ImageCacheOptions& options)
    : impl_(std::make_unique<Impl>()) {
  impl_->views = views;
  impl_->load = std::move(load);
  impl_->options = options;
  for (int i = 0; i < options.decoders; ++i)
    impl_->decoders.emplace_back([impl = impl_.get()] { impl->decode_ahead(); });
}

ImageCache::~ImageCache() = default;

int ImageCache::views() const { return impl_->views; }

ImagePointer ImageCache::get(const ImageKey& key) {
  REDRIVE_CHECK(key.view >= 0 && key.view < impl_->views);
  Impl& own = *impl_;
  std::unique_lock lock(own.mutex);
  ++own.statistics.reads;
  ++own.clock;
  if (const std::uint64_t next = own.next_use(key); next != kNever) {
    own.at = next + 1;
    own.scanned = std::max(own.scanned, own.at);
  }
  const auto begin = std::chrono::steady_clock::now();
  bool waits = false;
  while (true) {
    const auto found = own.entries.find(key);
    if (found != own.entries.end() && (found->second.image || found->second.error)) break;
    waits = true;
    if (found != own.entries.end()) {
      own.decoded.wait(lock);
      continue;
    }
    own.make_room(key, 0);
    own.decode(key, &lock);
  }
  if (waits)
    own.statistics.waited_s +=
        std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  Impl::Entry& entry = own.entries.at(key);
  if (entry.error) std::rethrow_exception(entry.error);
  own.rank(key, &entry);
  ImagePointer image = entry.image;
  own.planned.notify_one();
  return image;
}

void ImageCache::plan(std::vector<ImageKey> coming) {
  Impl& own = *impl_;
  const std::lock_guard lock(own.mutex);
  own.plan = std::move(coming);
  own.at = own.scanned = 0;
  own.uses.clear();
  for (std::size_t i = own.plan.size(); i-- > 0;) own.uses[own.plan[i]].push_back(i);
  own.ranks.clear();
  for (auto& [key, entry] : own.entries)
    if (entry.image) {
      entry.rank.next_use = own.next_use(key);
      own.ranks.insert(entry.rank);
    }
  own.planned.notify_all();
}

ImageCache::Statistics ImageCache::statistics() const {
  const std::lock_guard lock(impl_->mutex);
  return impl_->statistics;
}

}  // namespace redrive

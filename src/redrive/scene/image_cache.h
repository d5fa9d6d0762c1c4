// SPDX-License-Identifier: Apache-2.0
// Training images that need not all be in memory: background threads decode them ahead of their use
// into a cache of bounded size.
#pragma once

#include <compare>
#include <cstdint>
#include <functional>
#include <memory>
#include <utility>
#include <vector>

#include "redrive/image/image.h"

namespace redrive {

/// An image in use; while it is held, it is not evicted.
using ImagePointer = std::shared_ptr<const Image8>;

/// A training view's image, at full or half size.
struct ImageKey {
  int view = 0;  ///< index into Scene::views
  bool half = false;
  auto operator<=>(const ImageKey&) const = default;
};

/// Halves an image by area averaging; an odd row or column is dropped. A pixel that is masked in
/// part is masked.
Image8 halved(const Image8& image);

/// Bytes of an image's pixels.
std::uint64_t image_bytes(const Image8& image);

struct ImageCacheOptions {
  /// bytes that images take at most, unless more of them are in use at once
  std::uint64_t bytes = 0;
  std::uint64_t image_bytes = 0;  ///< bytes of the largest image, at full size
  int decoders = 1;               ///< background threads; 0: none
};

/// Holds the images that the plan needs soonest. Image bits do not depend on the size of the cache
/// or on threads. All members may be called from any thread.
class ImageCache {
 public:
  /// Returns the image of a view with its masks applied; called from several threads at once.
  using Load = std::function<Image8(int view)>;

  ImageCache(int views, Load load, const ImageCacheOptions& options);
  ~ImageCache();
  ImageCache(const ImageCache&) = delete;
  ImageCache& operator=(const ImageCache&) = delete;

  int views() const;
  /// Returns the image; decodes it in the caller's thread if no thread has begun to. Rethrows what
  /// Load throws, also on a background thread.
  ImagePointer get(const ImageKey& key);
  /// Replaces the plan: the keys of coming calls of get() in their order. They are decoded ahead as
  /// far as they fit, and the last needed are evicted first. Other calls of get() are allowed.
  void plan(std::vector<ImageKey> coming);

  struct Statistics {
    std::int64_t reads = 0;        ///< calls of get()
    std::int64_t decoded = 0;      ///< calls of Load that returned
    double waited_s = 0;           ///< time in get(), summed over threads
    std::uint64_t bytes = 0;       ///< bytes in the cache
    std::uint64_t most_bytes = 0;  ///< largest value so far
  };
  Statistics statistics() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// The images of a scene's training views: all in memory, or in a cache. Refers to either.
class ViewImages {
 public:
  /// images[i] belongs to scene.views[i]; images of held-out views are empty.
  ViewImages(const std::vector<Image8>& images) : all_(&images) {}
  explicit ViewImages(ImageCache& cache) : cache_(&cache) {}

  std::size_t size() const {
    return all_ ? all_->size() : static_cast<std::size_t>(cache_->views());
  }
  bool all_in_memory() const { return all_ != nullptr; }
  /// Returns the image of a training view. Throws as ImageCache::get.
  ImagePointer operator[](std::size_t view) const {
    return all_ ? ImagePointer(ImagePointer(), &(*all_)[view])
                : cache_->get({static_cast<int>(view), false});
  }
  /// Returns the halved image; where all images are in memory, a new one.
  ImagePointer half(std::size_t view) const {
    return all_ ? std::make_shared<const Image8>(halved((*all_)[view]))
                : cache_->get({static_cast<int>(view), true});
  }
  /// As ImageCache::plan; nothing where all images are in memory.
  void plan(std::vector<ImageKey> coming) const {
    if (cache_) cache_->plan(std::move(coming));
  }
  ImageCache::Statistics statistics() const {
    return cache_ ? cache_->statistics() : ImageCache::Statistics();
  }

 private:
  const std::vector<Image8>* all_ = nullptr;
  ImageCache* cache_ = nullptr;
};

}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/image_cache.h"

#include <atomic>
#include <mutex>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/rng.h"
#include "redrive/scene/load_views.h"
#include "redrive/scene/scene_testing.h"

namespace redrive {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

constexpr int kSide = 4;
constexpr std::uint64_t kBytes = 3 * kSide * kSide;  // bytes of an image

Image8 image_of(int view) {
  return {kSide, kSide, std::vector<std::uint8_t>(kBytes, static_cast<std::uint8_t>(view)), {}, {}};
}

ImageCacheOptions room_for(int images, int decoders) { return {images * kBytes, kBytes, decoders}; }

std::vector<ImageKey> keys(std::initializer_list<int> views) {
  std::vector<ImageKey> all;
  for (const int view : views) all.push_back({view, false});
  return all;
}

/// Reads the keys in order and returns how many were decoded.
std::int64_t decoded(ImageCache& cache, const std::vector<ImageKey>& read) {
  for (const ImageKey& key : read) EXPECT_EQ(cache.get(key)->rgb[0], key.view);
  return cache.statistics().decoded;
}

TEST(ImageCache, DecodesEachImageOnceWhereAllFit) {
  ImageCache cache(3, image_of, room_for(3, 0));
  EXPECT_EQ(decoded(cache, keys({0, 1, 2, 2, 1, 0, 1})), 3);
  EXPECT_EQ(cache.statistics().reads, 7);
  EXPECT_EQ(cache.statistics().bytes, 3 * kBytes);
}

TEST(ImageCache, LetsGoWhatThePlanNeedsLast) {
  ImageCache cache(3, image_of, room_for(2, 0));
  const auto order = keys({0, 1, 2, 0, 1});
  cache.plan(order);
  // 2 takes the place of 1, which is needed after 0.
  EXPECT_EQ(decoded(cache, order), 4);
}

TEST(ImageCache, WithoutAPlanLetsGoWhatWasUsedLongestAgo) {
  ImageCache cache(3, image_of, room_for(2, 0));
  EXPECT_EQ(decoded(cache, keys({0, 1, 0, 2, 0})), 3);
  EXPECT_EQ(decoded(cache, keys({1})), 4);
}

TEST(ImageCache, ImagesOfAnOldPlanAreLetGoFirst) {
  ImageCache cache(4, image_of, room_for(2, 0));
  cache.plan(keys({0, 1, 0, 1}));
  decoded(cache, keys({0, 1}));
  cache.plan(keys({2, 1, 3, 1, 2}));
  EXPECT_EQ(decoded(cache, keys({2, 1, 3, 1, 2})), 5) << "2 and 3, then 2 again";
}

TEST(ImageCache, HalfImagesTakeAQuarter) {
  ImageCache cache(4, image_of, room_for(1, 0));
  for (const int view : {0, 1, 2, 3, 0, 1, 2, 3}) {
    const ImagePointer half = cache.get({view, true});
    EXPECT_EQ(half->width, kSide / 2);
    EXPECT_EQ(half->rgb, std::vector<std::uint8_t>(kBytes / 4, static_cast<std::uint8_t>(view)));
  }
  EXPECT_EQ(cache.statistics().decoded, 4);
  EXPECT_EQ(cache.statistics().most_bytes, kBytes);
}

TEST(ImageCache, DecodesThePlanAheadInItsOrderAsFarAsItFits) {
  std::mutex mutex;
  std::vector<int> order;
  ImageCache cache(
      5,
      [&](int view) {
        const std::lock_guard lock(mutex);
        order.push_back(view);
        return image_of(view);
      },
      room_for(3, 1));
  const auto until = [&](std::size_t n) {  // returns the first n
    while (cache.statistics().decoded < static_cast<std::int64_t>(n)) std::this_thread::yield();
    const std::lock_guard lock(mutex);
    return std::vector<int>(order.begin(), order.begin() + static_cast<std::ptrdiff_t>(n));
  };
  cache.plan(keys({4, 1, 4, 3, 0, 2}));
  EXPECT_THAT(until(3), ElementsAre(4, 1, 3));
  EXPECT_EQ(cache.get({4, false})->rgb[0], 4) << "is needed once more: nothing is let go";
  EXPECT_EQ(cache.get({1, false})->rgb[0], 1);
  EXPECT_EQ(cache.get({4, false})->rgb[0], 4);
  EXPECT_THAT(until(4), ElementsAre(4, 1, 3, 0)) << "in the place of 1";
  EXPECT_EQ(cache.statistics().waited_s, 0);
  EXPECT_EQ(cache.statistics().most_bytes, 3 * kBytes);
}

TEST(ImageCache, ImagesInUseAreNotLetGo) {
  ImageCache cache(3, image_of, room_for(1, 0));
  const ImagePointer held = cache.get({0, false});
  decoded(cache, keys({1, 2, 1}));
  EXPECT_EQ(held->rgb[0], 0);
  EXPECT_EQ(cache.get({0, false}), held);
  EXPECT_EQ(cache.statistics().most_bytes, 2 * kBytes) << "one more than its size";
}

// In the order of a training run, with threads that ask for other images at the same time.
TEST(ImageCache, ManyThreadsGetTheirImagesWithinTheBound) {
  constexpr int kViews = 40, kReaders = 3, kRoom = 12;
  ImageCache cache(kViews, image_of, room_for(kRoom, 2));
  std::vector<ImageKey> order;
  for (std::uint64_t i = 0; i < 400; ++i)
    order.push_back({static_cast<int>(
                         permute_index(random_key(1, kStreamTest, i / kViews), i % kViews, kViews)),
                     false});
  cache.plan(order);
  std::atomic<int> wrong = 0;
  {
    std::vector<std::jthread> readers;
    for (int r = 0; r < kReaders; ++r)
      readers.emplace_back([&, r] {
        for (std::size_t i = 0; i < order.size(); ++i) {
          const int view = r == 0 ? order[i].view : static_cast<int>(7 * i + r) % kViews;
          wrong += cache.get({view, false})->rgb[0] != view;
        }
      });
  }
  EXPECT_EQ(wrong, 0);
  const ImageCache::Statistics statistics = cache.statistics();
  EXPECT_LE(statistics.most_bytes, kRoom * kBytes);
  EXPECT_EQ(statistics.reads, kReaders * 400);
  EXPECT_GE(statistics.decoded, kViews);
}

TEST(ImageCache, AnErrorOfABackgroundThreadReachesWhoAsksForTheImage) {
  std::atomic<int> failed = 0;
  ImageCache cache(
      3,
      [&](int view) {
        if (view != 1) return image_of(view);
        ++failed;
        throw InputError("drive/1.png", "", "", "the file is truncated");
      },
      room_for(3, 1));
  cache.plan(keys({0, 1, 2}));
  while (cache.statistics().decoded < 2) std::this_thread::yield();
  EXPECT_EQ(failed, 1);
  EXPECT_EQ(cache.get({0, false})->rgb[0], 0);
  for (int again = 0; again < 2; ++again) try {
      cache.get({1, false});
      ADD_FAILURE() << "no error";
    } catch (const InputError& error) {
      EXPECT_THAT(error.what(), HasSubstr("drive/1.png"));
    }
  EXPECT_EQ(failed, 1) << "it is not read again";
}

// As when the disk of a training machine fails: the file is cut after all were read once.
TEST(ImageCache, AFileThatBreaksLateIsAnErrorThatNamesIt) {
  const TemporaryFolder folder;
  const Recording recording = make_test_recording(folder.path);
  const Scene scene = make_scene(recording, {});
  ThreadPool pool(1);
  DamagedViews damaged;
  const ViewLoader load(scene, pool, &damaged);
  const int views = static_cast<int>(scene.views.size());
  const std::uint64_t bytes = image_bytes(load(scene.views.back()));
  for (const int decoders : {0, 1, 2}) {
    ImageCache cache(views,
                     [&](int view) { return load(scene.views[static_cast<std::size_t>(view)]); },
                     {.bytes = 2 * bytes, .image_bytes = bytes, .decoders = decoders});
    for (int view = 0; view < views; ++view) cache.get({view, false});
    damaged.close();  // what trains
    const std::filesystem::path file = scene.views[3].image;
    const std::string whole = read_file(file);
    write_file(file, whole.substr(0, whole.size() / 2));
    std::vector<ImageKey> plan;
    for (const int view : {0, 5, 7, 3, 1, 3}) plan.push_back({view, false});
    cache.plan(plan);
    int errors = 0;
    for (const ImageKey& key : plan) try {
        EXPECT_FALSE(cache.get(key)->rgb.empty());
      } catch (const InputError& error) {
        ++errors;
        EXPECT_EQ(key.view, 3);
        EXPECT_THAT(error.what(), HasSubstr(file.filename().string()));
      }
    EXPECT_EQ(errors, 2) << "for good, with " << decoders << " decoders";
    write_file(file, whole);
  }
}

TEST(ImageCache, HalvesByAveraging) {
  const Image8 image{3,
                     2,
                     {0, 10, 1, 4, 20, 1, 99, 99, 99, 8, 30, 1, 12, 40, 2, 99, 99, 99},
                     {255, 255, 0, 255, 251, 0},
                     {255, 255, 0, 255, 128, 0}};
  Image8 half = halved(image);
  EXPECT_EQ(half.width, 1);
  EXPECT_EQ(half.height, 1);
  EXPECT_THAT(half.rgb, ElementsAre(6, 25, 1));
  EXPECT_THAT(half.alpha, ElementsAre(254));
  EXPECT_THAT(half.used, ElementsAre(1));
  Image8 masked = image;
  masked.used[4] = 0;
  EXPECT_THAT(halved(masked).used, ElementsAre(0));
}

TEST(ViewImages, OfAVectorAreThoseThemselves) {
  const std::vector<Image8> images{image_of(0), image_of(1)};
  const ViewImages views = images;
  EXPECT_EQ(views.size(), 2u);
  EXPECT_TRUE(views.all_in_memory());
  EXPECT_EQ(views[1].get(), &images[1]);
  EXPECT_EQ(views.half(1)->width, kSide / 2);
  EXPECT_EQ(views.statistics().reads, 0);
}

}  // namespace
}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/tracks/tracks.h"

#include <opencv2/imgproc.hpp>

#include "redrive/align/tracks/cross_camera_tracks.h"
#include "redrive/align/tracks/epipolar_outliers.h"
#include "redrive/align/tracks/feature_tracker.h"
#include "redrive/align/tracks/patch.h"
#include "redrive/base/opencv_threads.h"
#include "redrive/base/progress.h"

namespace redrive {
namespace {

constexpr int kWidest = 800;  // wider images are also tracked at a smaller size: noise averages
                              // out, and blurred features become sharp
// distance in pixels of the smaller image: tracks this close in one image show the same point
constexpr double kSame_px = 4;

/// Tracks of the full images and new ones of the smaller images, in pixels of the smaller images.
std::vector<Track> track_at_both_sizes(const RigImages& full, const RigImages& small, int camera,
                                       const TrackOptions& options, Progress* progress) {
  std::vector<Track> tracks = track_features(full, camera, options, progress);
  const int factor = small.factor[camera];
  if (factor == 1) return tracks;
  std::vector<cv::Mat> taken;
  for (const cv::Mat& grey : small.grey[camera])
    taken.push_back(cv::Mat::zeros(grey.size(), CV_8U));
  for (Track& track : tracks)
    for (Observation& seen : track.seen) {
      seen.pixel = small.from_recorded(camera, seen.pixel);
      seen.sigma_px /= factor;
      cv::circle(taken[seen.frame], {cvRound(seen.pixel.x()), cvRound(seen.pixel.y())},
                 static_cast<int>(kSame_px), cv::Scalar(255), cv::FILLED);
    }
  for (Track& track : track_features(small, camera, options, progress))
    if (std::ranges::none_of(track.seen, [&](const Observation& seen) {
          return taken[seen.frame].at<std::uint8_t>(cvRound(seen.pixel.y()),
                                                    cvRound(seen.pixel.x())) != 0;
        }))
      tracks.push_back(std::move(track));
  return tracks;
}

std::ptrdiff_t images_of(const RigImages& images, int camera) {
  return std::ranges::count_if(images.grey[camera],
                               [](const cv::Mat& grey) { return !grey.empty(); });
}

/// Images of both sizes.
std::int64_t images_to_track(const RigImages& small) {
  std::int64_t n = 0;
  for (int c = 0; c < small.cameras(); ++c)
    n += images_of(small, c) * (small.factor[c] == 1 ? 1 : 2);
  return n;
}

bool has_few(const RigImages& images, int camera, const TrackOptions& options,
             const std::vector<Track>& tracks) {
  std::size_t points = 0;
  for (const Track& track : tracks) points += track.seen.size();
  const auto with_image = images_of(images, camera);
  return points < static_cast<std::size_t>(options.few * with_image);
}

}  // namespace

RigImages load_track_images(const Recording& recording, ThreadPool& pool,
                            const TrackOptions& options) {
  return load_rig_images(recording, options.masks, kPatchHalf, pool);
}

std::vector<Track> find_tracks(const RigImages& full, ThreadPool& pool,
                               const TrackOptions& options) {
  const RigImages images = downscaled_to_width(full, kWidest, kPatchHalf, pool);
  std::vector<std::vector<Track>> of_camera(images.cameras());
  std::vector<TrackOptions> camera_options(images.cameras(), options);
  Progress progress("finding feature tracks", images_to_track(images));
  pool.run(images.cameras(), [&](int c) {
    of_camera[c] = track_at_both_sizes(full, images, c, camera_options[c], &progress);
    if (has_few(images, c, options,
                of_camera[c])) {  // weak features are better than none; sigma_px weights them
      camera_options[c].max_sigma_px = options.relaxed_max_sigma_px;
      of_camera[c] = track_at_both_sizes(full, images, c, camera_options[c], &progress);
    }
    drop_epipolar_outliers(images, options, &of_camera[c]);
  });
  match_across_cameras(images, camera_options, pool, &of_camera);
  std::vector<Track> tracks;
  for (std::vector<Track>& found : of_camera) std::ranges::move(found, std::back_inserter(tracks));
  for (Track& track : tracks)
    for (Observation& seen : track.seen) {
      seen.pixel = images.recorded_pixel(seen.camera, seen.pixel);
      seen.sigma_px *= images.factor[seen.camera];
    }
  return tracks;
}

}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/tracks.h"

#include <opencv2/core/utility.hpp>

#include "redrive/align/camera_tracks.h"
#include "redrive/align/consistency.h"
#include "redrive/align/cross_tracks.h"
#include "redrive/align/patch.h"

namespace redrive {

std::vector<Track> find_tracks(const Recording& recording, ThreadPool& pool, const TrackOptions& options) {
  cv::setNumThreads(1);  // the cameras are what is done in parallel
  const RigImages images = load_rig_images(recording, options.masks, kPatchHalf, pool);
  std::vector<std::vector<Track>> of_camera(images.cameras());
  pool.run(images.cameras(), [&](int c) {
    of_camera[c] = follow_points(images, c, options);
    drop_inconsistent(images, options, &of_camera[c]);
  });
  join_cameras(images, options, pool, &of_camera);
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

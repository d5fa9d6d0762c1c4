// SPDX-License-Identifier: Apache-2.0
// Feature tracks: observations of static points in a recording's images.
#pragma once

#include <filesystem>
#include <vector>

#include <Eigen/Core>

#include "redrive/align/rig/rig_images.h"
#include "redrive/base/parallel.h"
#include "redrive/recording/core/recording.h"

namespace redrive {

/// One static point in one image.
struct Observation {
  int camera = 0;         ///< index into Recording::cameras
  int frame = 0;          ///< index into Recording::frames
  Eigen::Vector2d pixel;  ///< pixel of the image as recorded; integer coordinates are pixel centres
  double sigma_px = 0.1;  ///< standard deviation of the pixel from the image around it, for weights
};

/// One point in several images, of one camera over time or of several cameras.
struct Track {
  std::vector<Observation> seen;  ///< at least two, of different images
};

struct TrackOptions {
  int points_per_image =
      300;  ///< number of features that are tracked at a time, spread over the image
  /// least correlation of a patch with the track's first one, -1..1
  double min_correlation = 0.85;
  double max_sigma_px = 0.15;         ///< largest sigma_px of an observation
  double relaxed_max_sigma_px = 0.3;  ///< the same for cameras with few such points
  int few = 50;                       ///< observations per image, fewer are few
  double max_epipolar_error_px =
      1;  ///< largest error under the relative pose that most tracks of two images agree on
  int min_observations = 3;     ///< least number of observations in a track, >= 2
  std::filesystem::path masks;  ///< folder of masks (static_masks); empty: they are computed
};

/// Tracks of all images of the recording, held-out frames included, by camera and first frame.
/// Features on the vehicle, on annotated moving objects and on masked pixels are excluded. Poses
/// and calibration of the recording only guide the search; they may be off by 0.5 m and 1 degree.
/// The result does not depend on the number of threads. InputError as load_view, read_mask,
/// read_boxes.
std::vector<Track> find_tracks(const RigImages& images, ThreadPool& pool,
                               const TrackOptions& options = {});

/// The images for find_tracks, at full size.
RigImages load_track_images(const Recording& recording, ThreadPool& pool,
                            const TrackOptions& options = {});

}  // namespace redrive

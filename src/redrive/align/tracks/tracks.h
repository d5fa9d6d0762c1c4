// SPDX-License-Identifier: Apache-2.0
// Where static points of the scene are seen in a recording's images: what redrive align moves poses
// by.
#pragma once

#include <filesystem>
#include <vector>

#include <Eigen/Core>

#include "redrive/align/rig/rig_images.h"
#include "redrive/base/parallel.h"
#include "redrive/recording/recording.h"

namespace redrive {

/// One static point in one image.
struct Observation {
  int camera = 0;         ///< index into Recording::cameras
  int frame = 0;          ///< index into Recording::frames
  Eigen::Vector2d pixel;  ///< of the image as recorded; integer coordinates are pixel centres
  double sigma_px = 0.1;  ///< standard deviation of the pixel as its surroundings tell: for weights
};

/// The same point in several images, of one camera over time or of several cameras.
struct Track {
  std::vector<Observation> seen;  ///< at least two, of different images
};

struct TrackOptions {
  int points_per_image = 300;     ///< about so many are followed at a time, spread over the image
  double min_correlation = 0.85;  ///< of a patch with the track's first one, -1..1
  double max_sigma_px = 0.15;     ///< how well a patch's position has to be determined by its looks
  double relaxed_max_sigma_px = 0.3;  ///< the same for cameras without plenty of such points
  int plenty = 50;                    ///< points per image
  double max_epipolar_error_px = 1;   ///< from what most tracks of two images agree in
  int min_observations = 3;           ///< of a track, >= 2
  std::filesystem::path masks;        ///< folder of masks (static_masks); empty: they are found
};

/// Tracks of all images of the recording, those of held-out frames, too, by camera and first frame;
/// nothing on the vehicle itself, on annotated objects that move, or where images have masks. Poses
/// and calibration of the recording only guide the search: they may be wrong by 0.5 m and 1 degree.
/// The result does not depend on the number of threads. InputError as load_view, read_mask,
/// read_boxes.
std::vector<Track> find_tracks(const RigImages& images, ThreadPool& pool,
                               const TrackOptions& options = {});

/// All that is needed for it, at full size.
RigImages load_track_images(const Recording& recording, ThreadPool& pool,
                            const TrackOptions& options = {});

}  // namespace redrive

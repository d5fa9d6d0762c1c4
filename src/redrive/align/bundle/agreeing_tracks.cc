// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/bundle/agreeing_tracks.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "redrive/align/bundle/inverse_depth_point.h"

namespace redrive {
namespace {

constexpr double kMinSigma_px = 0.05;  // lower bound of the noise of an image
// share of a frame's observations that agree with its pose below which it restarts between its
// neighbours
constexpr double kContradicted = 0.5;
constexpr int kMostRestarts = 2;  // restarts of a frame, at most

/// Returns all tracks that can be triangulated with the present corrections, one per track.
std::vector<TriangulatedTrack> triangulate_tracks(const RigModel& model,
                                                  const std::vector<Track>& tracks,
                                                  const std::vector<double>& sigma_px,
                                                  ThreadPool& pool) {
  const ExposureMotions times(model);
  std::vector<std::optional<TriangulatedTrack>> found(tracks.size());
  pool.run_ranges(tracks.size(), 64, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i)
      if (const auto point = fit_inverse_depth_point(model, times, tracks[i], sigma_px))
        found[i] = TriangulatedTrack{static_cast<int>(i), *point,
                                     std::vector<std::uint8_t>(tracks[i].seen.size(), 1),
                                     reprojection_errors(model, times, tracks[i], *point)};
  });
  std::vector<TriangulatedTrack> triangulated;
  for (auto& entry : found)
    if (entry) triangulated.push_back(std::move(*entry));
  return triangulated;
}

/// Returns the noise of each camera from the median of the components' absolute values, which is
/// 0.6745 sigma. A point takes three degrees of freedom.
std::vector<double> measure_noise(const RigModel& model, const std::vector<Track>& tracks,
                                  const std::vector<TriangulatedTrack>& triangulated) {
  std::vector<std::vector<double>> sizes(model.cameras.size());
  for (const TriangulatedTrack& entry : triangulated) {
    const double n = 2 * static_cast<double>(entry.errors.size());
    if (n < 5) continue;  // two observations leave one degree of freedom
    for (std::size_t i = 0; i < entry.errors.size(); ++i)
      for (int k = 0; k < 2; ++k)
        sizes[tracks[entry.track].seen[i].camera].push_back(std::abs(entry.errors[i][k]) *
                                                            std::sqrt(n / (n - 3)));
  }
  std::vector<double> sigma_px;
  for (std::vector<double>& of_camera : sizes)
    sigma_px.push_back(of_camera.size() < 20
                           ? kStartSigma_px
                           : std::max(kMinSigma_px, median_or_zero(&of_camera) / 0.6745));
  return sigma_px;
}

/// Rejects outliers, and tracks with fewer than two inliers. Returns the rest of `frames`.
std::vector<FrameSupport> reject_outliers(const std::vector<Track>& tracks,
                                          const std::vector<double>& sigma_px, std::size_t frames,
                                          std::vector<TriangulatedTrack>* triangulated) {
  std::vector<FrameSupport> support(frames);
  std::vector<TriangulatedTrack> kept;
  for (TriangulatedTrack& entry : *triangulated) {
    const std::vector<Observation>& seen = tracks[entry.track].seen;
    int used = 0;
    for (std::size_t i = 0; i < entry.errors.size(); ++i) {
      entry.used[i] = entry.errors[i].norm() <= kOutlierSigmas * sigma_of(seen[i], sigma_px);
      used += entry.used[i];
    }
    for (std::size_t i = 0; i < seen.size(); ++i) {
      ++support[seen[i].frame].observed;
      support[seen[i].frame].used += used >= 2 && entry.used[i];
    }
    if (used >= 2) kept.push_back(std::move(entry));
  }
  *triangulated = std::move(kept);
  return support;
}

}  // namespace

double median_or_zero(std::vector<double>* values) {
  if (values->empty()) return 0;
  const auto middle = values->begin() + static_cast<std::ptrdiff_t>(values->size() / 2);
  std::nth_element(values->begin(), middle, values->end());
  return *middle;
}

AgreeingTracks find_agreeing(const std::vector<Track>& tracks, std::vector<double> sigma_px,
                             ThreadPool& pool, RigModel* model, std::vector<int>* restarts) {
  AgreeingTracks found{{}, std::move(sigma_px), {}};
  for (;;) {
    found.triangulated = triangulate_tracks(*model, tracks, found.sigma_px, pool);
    found.sigma_px = measure_noise(*model, tracks, found.triangulated);
    found.support =
        reject_outliers(tracks, found.sigma_px, model->initial_frames.size(), &found.triangulated);
    const std::vector<int> doubtful = doubtful_frames(found.support, kContradicted);
    if (std::ranges::all_of(doubtful, [&](int f) { return (*restarts)[f] >= kMostRestarts; }))
      return found;
    place_between_neighbours(doubtful, model);
    for (const int f : doubtful) ++(*restarts)[f];
  }
}

}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/tracks/epipolar_outliers.h"

#include <map>

#include "redrive/align/tracks/epipolar.h"

namespace redrive {
namespace {

constexpr std::array<int, 3> kImageSteps = {1, 2, 4};

/// One track in two images: indices into Track::seen.
struct Seen {
  std::size_t track, a, b;
};

/// Returns the recorded relative pose, and one that drives straight ahead, in case the recorded
/// translation is noise.
std::vector<Rigid3d> likely_poses(const Rigid3d& body_from_camera, const Rigid3d& b_from_a) {
  std::vector<Rigid3d> starts = {b_from_a};
  Rigid3d ahead = b_from_a;  // the older camera lies behind the newer one
  ahead.translation() = -(body_from_camera.linear().transpose() * Eigen::Vector3d::UnitX());
  starts.push_back(ahead);
  return starts;
}

}  // namespace

void drop_epipolar_outliers(const RigImages& images, const TrackOptions& options,
                            std::vector<Track>* tracks) {
  if (tracks->empty()) return;
  const int camera = tracks->front().seen.front().camera;
  std::map<std::pair<int, int>, std::vector<Seen>> by_images;
  for (std::size_t t = 0; t < tracks->size(); ++t) {
    const auto& seen = (*tracks)[t].seen;
    for (std::size_t a = 0; a < seen.size(); ++a)
      for (const int apart : kImageSteps)
        if (a + apart < seen.size())
          by_images[{seen[a].frame, seen[a + apart].frame}].push_back({t, a, a + apart});
  }

  struct Votes {
    int good = 0, bad = 0;
  };
  std::vector<std::vector<Votes>> votes(tracks->size());
  for (std::size_t t = 0; t < tracks->size(); ++t) votes[t].resize((*tracks)[t].seen.size());
  const Camera& model = images.camera(camera);
  for (const auto& [frames, seen] : by_images) {
    std::vector<RayPair> pairs;
    std::vector<Seen> of_pair;
    for (const Seen& s : seen) {
      const auto& o = (*tracks)[s.track].seen;
      if (const auto pair = make_ray_pair(model, o[s.a].pixel, model, o[s.b].pixel)) {
        pairs.push_back(*pair);
        of_pair.push_back(s);
      }
    }
    const auto& poses = images.world_from_camera[camera];
    const auto b_from_a = fit_relative_pose(
        pairs, likely_poses(images.scene.rig[camera].body_from_sensor,
                            poses[frames.second].inverse() * poses[frames.first]));
    if (!b_from_a) continue;  // too few points
    for (std::size_t i = 0; i < pairs.size(); ++i) {
      const bool good =
          std::abs(sampson_error_px(pairs[i], *b_from_a)) <= options.max_epipolar_error_px;
      for (const std::size_t at : {of_pair[i].a, of_pair[i].b})
        ++(good ? votes[of_pair[i].track][at].good : votes[of_pair[i].track][at].bad);
    }
  }

  std::vector<Track> kept;
  for (std::size_t t = 0; t < tracks->size(); ++t) {
    Track track;
    int good = 0, bad = 0;
    for (std::size_t i = 0; i < votes[t].size(); ++i) {
      good += votes[t][i].good;
      bad += votes[t][i].bad;
      if (votes[t][i].good > 2 * votes[t][i].bad) track.seen.push_back((*tracks)[t].seen[i]);
    }
    if (good > 4 * bad && static_cast<int>(track.seen.size()) >= options.min_observations)
      kept.push_back(std::move(track));
  }
  *tracks = std::move(kept);
}

}  // namespace redrive

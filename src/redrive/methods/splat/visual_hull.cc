// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/splat/visual_hull.h"

#include <algorithm>
#include <cmath>

namespace redrive {

VisualHull::VisualHull(const TrainingSet& data) {
  for (std::size_t v = 0; v < data.scene.views.size(); ++v) {
    const View& view = data.scene.views[v];
    if (view.held_out || data.scene.background == Background::kNone) continue;
    const ImagePointer image = data.images[v];
    if (image->alpha.empty()) continue;
    silhouettes_.push_back({&data.scene.rig[view.camera].camera,
                            data.scene.world_from_camera(view).inverse(Eigen::Isometry),
                            {}});
    for (const std::uint8_t alpha : image->alpha) silhouettes_.back().shown.push_back(alpha > 0);
  }
}

bool VisualHull::Silhouette::transparent_around(int x, int y) const {
  for (int v = std::max(y - 1, 0); v <= std::min(y + 1, camera->height - 1); ++v)
    for (int u = std::max(x - 1, 0); u <= std::min(x + 1, camera->width - 1); ++u)
      if (shown[static_cast<std::size_t>(v) * camera->width + u]) return false;
  return true;
}

bool VisualHull::contains(const Eigen::Vector3d& position) const {
  bool seen = silhouettes_.empty();
  for (const Silhouette& s : silhouettes_) {
    const auto pixel = s.camera->project(s.camera_from_world * position);
    if (!pixel) continue;
    const int x = static_cast<int>(std::floor(pixel->x() + 0.5)),
              y = static_cast<int>(std::floor(pixel->y() + 0.5));
    if (x < 0 || y < 0 || x >= s.camera->width || y >= s.camera->height) continue;
    if (s.transparent_around(x, y)) return false;
    seen = true;
  }
  return seen;
}

}  // namespace redrive

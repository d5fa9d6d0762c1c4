// SPDX-License-Identifier: Apache-2.0
// Dense points triangulated from feature tracks with the poses of the scene. Corners (Shi, Tomasi
// 1994) of every other image are tracked forward and backward by pyramidal Lucas-Kanade;
// observations that the poses do not explain are dropped.
#pragma once

#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/scene/image_cache.h"
#include "redrive/scene/point_cloud.h"
#include "redrive/scene/scene.h"

namespace redrive {

/// Returns the points that tracks of each camera's training images give, with the colour of the
/// pixel where the track starts; in the order of cameras and images. The consecutive images of a
/// camera must overlap: photographs too far apart give none. images[i] belongs to scene.views[i];
/// images of held-out views are not used, nor are masked or transparent pixels. A camera of whose
/// corners fewer than a twentieth become points, as with noise at night, is tracked from every
/// eighth start only. The poses are the poses of Scene::shutter_poses. The result does not depend
/// on the number of threads.
PointCloud track_points(const Scene& scene, const ViewImages& images, ThreadPool& pool);
/// Maximum number of images that track_points uses at once.
constexpr int kMostTrackImages = 32;

}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
// LiDAR returns as points, coloured by the images.
#pragma once

#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/scene/image_cache.h"
#include "redrive/scene/lidar/lidar_returns.h"
#include "redrive/scene/point_cloud.h"

namespace redrive {

/// Returns the end of each return that a training image sees, in the order of the returns. In a
/// drive the colour comes from the view exposed nearest to the return's time, of some views of each
/// camera nearest to it, that sees the point; for photographs (Scene::metric false), whose returns
/// are cloud_returns, from the view nearest to the return's origin. A view sees a point that
/// projects to an opaque pixel that is not masked; occlusion is not examined. images[i] belongs to
/// scene.views[i]; images of held-out views are not used.
PointCloud lidar_points(const Scene& scene, const ViewImages& images, const LidarReturns& returns,
                        ThreadPool& pool);

}  // namespace redrive

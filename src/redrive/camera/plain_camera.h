// SPDX-License-Identifier: Apache-2.0
// A camera in plain numbers for kernels that project points (math/plain_camera.h).
#pragma once

#include "redrive/camera/camera.h"
#include "redrive/math/plain_camera.h"

namespace redrive {

/// Points count up to 1.15 times the radius of the image's corners, so that what is centred beyond
/// the edge reaches into the image, or to where the model folds. Models without lanes of their own
/// are projected one point at a time: `camera` must outlive the result.
PlainCamera make_plain_camera(const Camera& camera);
PlainCamera make_plain_camera(const Camera&&) = delete;

/// Returns the camera of the window of width x height pixels from (x, y) on.
PlainCamera window_of(PlainCamera camera, int x, int y, int width, int height);

}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
// The pictures of a scene in memory, 8 bits a channel: 3 bytes a pixel, and one more where they are
// transparent or masked.
#pragma once

#include <filesystem>
#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/image/image.h"
#include "redrive/scene/scene.h"

namespace redrive {

/// The image of `view` as it is trained on: size and the mask's size checked against the
/// calibration (InputError), laid over the scene's background, undistorted if the scene says so,
/// area-averaged by the downscale factor. A pixel that the mask leaves out in part is left out.
/// Alpha stays: on another colour the pixel is rgb + (1 - alpha) (colour - background). UsageError:
/// transparent pixels without a background, or a background for images without alpha.
Image8 load_view(const Scene& scene, const View& view);

/// The true depth of a recorded image (16-bit PNG, mm along the ray, 0 and 65535 say nothing) as
/// `rig.camera` sees it: [height, width] metres, the nearest pixel's, since depths do not mix; 0
/// where it is not known. InputError as for images.
std::vector<float> load_depth(const std::filesystem::path& path, const RigCamera& rig);

/// All views, decoded in parallel; images[i] belongs to scene.views[i]. Held-out ones are looked
/// at, for what is wrong with them, and left empty.
std::vector<Image8> load_views(const Scene& scene, ThreadPool& pool);

}  // namespace redrive

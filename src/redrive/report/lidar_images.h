// SPDX-License-Identifier: Apache-2.0
// Images of a LiDAR scan, recorded and rendered.
#pragma once

#include <vector>

#include "redrive/report/report_images.h"

namespace redrive {

/// Returns the middle one of the scans that did not train, as recorded and as rendered along the
/// same rays, those without a return among them where the beams are known: ranges, intensities
/// where the run has them, and a view from above. Empty where no scan is held out.
std::vector<ImageRow> lidar_image_rows(const Run& run, kernels::Backend& backend);

}  // namespace redrive

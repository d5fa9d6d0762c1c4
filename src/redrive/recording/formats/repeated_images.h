// SPDX-License-Identifier: Apache-2.0
// Images that repeat the one before while the camera moves on, as a frozen grabber writes them.
#pragma once

#include "redrive/recording/core/recording.h"

namespace redrive {

/// Drops images of a drive with the pixels of the same camera's image before, while the camera is
/// more than 5 cm or half a degree away from where these pixels appeared first. A finding for each
/// camera names the frames. A camera whose images are all the same keeps them, with a finding.
/// Files are compared byte by byte, up to a few bytes of metadata, and read only where their sizes
/// are about the same. Photographs of a symmetric thing may well be equal.
void leave_out_repeated_images(Recording* recording);

}  // namespace redrive

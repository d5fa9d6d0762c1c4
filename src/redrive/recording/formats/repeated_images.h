// SPDX-License-Identifier: Apache-2.0
// Images that repeat the one before while the camera moves on, as a frozen grabber writes them.
#pragma once

#include "redrive/recording/core/recording.h"

namespace redrive {

/// Removes images of a drive with the pixels of the image before, of the same camera, while the
/// camera is more than 5 cm or half a degree away from where these pixels came first. A finding for
/// each camera names the frames. A camera whose images are all the same keeps them, with a finding.
/// Files are compared as they are, up to a few bytes of metadata; they are read only where their
/// sizes are about the same. Photographs of a symmetric thing may well be equal.
void leave_out_repeated_images(Recording* recording);

}  // namespace redrive

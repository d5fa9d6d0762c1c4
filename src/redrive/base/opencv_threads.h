// SPDX-License-Identifier: Apache-2.0
// Included wherever OpenCV is: turns its own threads off, since ours call it side by side.
#pragma once

#include <opencv2/core/utility.hpp>

namespace redrive {

/// Set once, before main: cv::setNumThreads replaces an arena of oneTBB that belongs to the whole
/// process, so two threads that call it at a time may crash.
inline const bool kOpenCvThreadsAreOff = [] {
  cv::setNumThreads(1);
  return true;
}();

}  // namespace redrive

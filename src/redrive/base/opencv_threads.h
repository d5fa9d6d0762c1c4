// SPDX-License-Identifier: Apache-2.0
// Include it wherever OpenCV is included: it turns OpenCV's own threads off, since our threads call
// it concurrently.
#pragma once

#include <opencv2/core/utility.hpp>

namespace redrive {

/// Set once, before main: cv::setNumThreads replaces an arena of oneTBB that belongs to the whole
/// process, so two threads that call it at the same time may crash.
inline const bool kOpenCvThreadsAreOff = [] {
  cv::setNumThreads(1);
  return true;
}();

}  // namespace redrive

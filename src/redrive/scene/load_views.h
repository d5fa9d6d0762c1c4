// SPDX-License-Identifier: Apache-2.0
// Loads the images of a scene as training uses them.
#pragma once

#include <atomic>
#include <filesystem>
#include <map>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/image/image.h"
#include "redrive/recording/core/recording.h"
#include "redrive/scene/resample.h"
#include "redrive/scene/scene.h"

namespace redrive {

/// Loads the image of `view` as it is trained on: composited over the scene's background,
/// undistorted if the scene demands it, area-averaged by the downscale factor. A pixel that is
/// masked in part is masked. Alpha is kept: over another colour the pixel is rgb + (1 - alpha)
/// (colour - background). InputError: the image's or its mask's size differs from the
/// calibration's. UsageError: transparent pixels without a background, or a background for images
/// without alpha.
Image8 load_view(const Scene& scene, const View& view);

/// Views whose files turned out to be damaged when they were decoded. Usable from any thread.
class DamagedViews {
 public:
  void add(const View& view, const std::string& why);
  bool contains(const View& view) const;
  /// From now on a damaged view is an error of the function that loads it.
  void close() { closed_ = true; }
  bool is_closed() const { return closed_; }
  /// Returns findings for each camera. InputError where more of the scene's views are damaged than
  /// the recording allows.
  std::vector<Finding> judge(const Recording& recording, const Scene& scene) const;

 private:
  mutable std::mutex mutex_;
  std::map<std::pair<int, int>, std::string> why_;  ///< key: camera and frame
  std::atomic<bool> closed_{false};
};

/// Loads the views of a scene one at a time, as load_view, from any thread.
class ViewLoader {
 public:
  /// `damaged`: takes the views that cannot be decoded, whose images are black without a used
  /// pixel; null: InputError as load_view.
  ViewLoader(const Scene& scene, ThreadPool& pool, DamagedViews* damaged = nullptr);
  Image8 operator()(const View& view) const;

 private:
  /// The options of Scene that loading needs; views are the caller's.
  Scene scene_;
  DamagedViews* damaged_;
  std::vector<ResampleMap> maps_;  ///< one per camera, where the scene undistorts
};

/// Loads the ground-truth depth of a recorded image (16-bit PNG, mm along the ray; 0 and 65535:
/// unknown) for the pixels of `rig.camera`: [height, width] metres, of the nearest recorded pixel,
/// since depths cannot be averaged; 0 where unknown. InputError as for images.
std::vector<float> load_depth(const std::filesystem::path& path, const RigCamera& rig);

/// Loads all views in parallel; images[i] belongs to scene.views[i]. Held-out images are loaded, so
/// that errors are found, and left empty. `damaged`: as in ViewLoader.
std::vector<Image8> load_views(const Scene& scene, ThreadPool& pool,
                               DamagedViews* damaged = nullptr);

}  // namespace redrive

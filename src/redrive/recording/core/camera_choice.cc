// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/core/camera_choice.h"

#include <algorithm>
#include <set>

#include "redrive/base/did_you_mean.h"
#include "redrive/base/error.h"
#include "redrive/image/image_head.h"
#include "redrive/image/image_io.h"

namespace redrive {
namespace {

constexpr std::size_t kLargestRig = 16;  // cameras; photographs may have one each

bool has_equal_channels(const Image8& image) {
  for (std::size_t i = 0; i + 2 < image.rgb.size(); i += 3)
    if (image.rgb[i] != image.rgb[i + 1] || image.rgb[i] != image.rgb[i + 2]) return false;
  return true;
}

bool is_grey(const RecordedCamera& camera, bool by_pixels) {
  if (camera.images.empty()) return false;
  const std::filesystem::path& path = camera.images.front().path;
  const auto head = read_image_head(path);
  if (!head || head->grey || !by_pixels) return head && head->grey;
  try {
    return has_equal_channels(read_image(path));
  } catch (const InputError&) {
    return false;  // reported where it is used
  }
}

}  // namespace

const RecordedCamera& named_camera(const Recording& recording, const std::string& name) {
  if (const RecordedCamera* const camera = recording.find_camera(name)) return *camera;
  std::vector<std::string> names;
  for (const RecordedCamera& camera : recording.cameras) names.push_back(camera.calibration.name);
  throw UsageError("--cameras", name, unknown_name(name, names));
}

void keep_cameras(const std::vector<std::string>& names, Recording* recording) {
  if (names.empty()) return;
  std::set<std::string> kept;
  for (const std::string& name : names) {
    named_camera(*recording, name);
    if (!kept.insert(name).second) throw UsageError("--cameras", name, "is named twice");
  }
  std::erase_if(recording->cameras, [&](const RecordedCamera& camera) {
    return !kept.contains(camera.calibration.name);
  });
}

std::vector<std::string> grey_cameras(const Recording& recording) {
  std::vector<std::string> names;
  for (const RecordedCamera& camera : recording.cameras)
    if (is_grey(camera, recording.cameras.size() <= kLargestRig))
      names.push_back(camera.calibration.name);
  return names;
}

}  // namespace redrive

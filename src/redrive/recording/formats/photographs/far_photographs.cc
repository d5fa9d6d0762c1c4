// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/photographs/far_photographs.h"

#include <algorithm>
#include <cstdio>
#include <limits>

#include "redrive/math/upper_median.h"
#include "redrive/recording/core/wording.h"

namespace redrive {
namespace {

constexpr double kFarFromMiddle = 20, kFarFromNext = 5;  // in median distances from the middle
// others needed; at most one of this many may be far
constexpr std::size_t kLeastOthers = 10, kMostShare = 20;

}  // namespace

void leave_out_far_photographs(Recording* recording) {
  std::vector<FramePose>& frames = recording->frames;
  const std::size_t n = frames.size();
  if (n <= kLeastOthers) return;
  const auto at = [&](std::size_t f) -> Eigen::Vector3d {
    return frames[f].global_from_body.translation();
  };
  Eigen::Vector3d middle;
  for (int k = 0; k < 3; ++k) {
    std::vector<double> values;
    for (std::size_t f = 0; f < n; ++f) values.push_back(at(f)[k]);
    middle[k] = upper_median(std::move(values));
  }
  std::vector<double> distances;
  for (std::size_t f = 0; f < n; ++f) distances.push_back((at(f) - middle).norm());
  const double usual = upper_median(distances);
  if (!(usual > 0)) return;
  std::vector<std::int64_t> far;
  for (std::size_t f = 0; f < n; ++f) {
    if (distances[f] <= kFarFromMiddle * usual) continue;
    double next = std::numeric_limits<double>::infinity();
    for (std::size_t other = 0; other < n; ++other)
      if (other != f) next = std::min(next, (at(other) - at(f)).norm());
    if (next > kFarFromNext * usual) far.push_back(frames[f].id);
  }
  if (far.empty() || far.size() > std::max<std::size_t>(1, n / kMostShare)) return;
  const auto is_far = [&](std::int64_t id) { return std::ranges::binary_search(far, id); };
  std::vector<std::string> names;
  for (RecordedCamera& camera : recording->cameras) {
    for (const ImageFile& image : camera.images)
      if (is_far(image.frame_id)) names.push_back(image.path.filename().string());
    std::erase_if(camera.images, [&](const ImageFile& image) { return is_far(image.frame_id); });
  }
  std::erase_if(recording->cameras,
                [](const RecordedCamera& camera) { return camera.images.empty(); });
  std::erase_if(frames, [&](const FramePose& frame) { return is_far(frame.id); });
  char than[100];
  std::snprintf(than, sizeof than,
                " left out, more than %.0f times as far from the middle as half of all are: ",
                kFarFromMiddle);
  recording->findings.push_back(
      {"poses", counted(far.size(), "photograph") + than + first_few(names)});
}

}  // namespace redrive

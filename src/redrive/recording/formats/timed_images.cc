// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/timed_images.h"

#include <algorithm>

#include "redrive/base/error.h"
#include "redrive/recording/core/damaged_text.h"
#include "redrive/recording/core/trajectory.h"

namespace redrive {
namespace {

// Cameras fire as the laser passes them, so a trigger of all of them repeats to a millisecond, and
// triggers are 50 ms apart or more. A car at 15 m/s moves by 7 cm in this time.
constexpr std::int64_t kSameFrame_ns = 5'000'000;

}  // namespace

std::vector<FramePose> join_frames(const std::vector<FramePose>& poses,
                                   const std::filesystem::path& file,
                                   std::vector<TimedImages>* cameras,
                                   std::vector<DamagedRecord>* damaged) {
  struct Image {
    std::int64_t t_ns;
    TimedImages* of;
    FrameFile file;
  };
  std::vector<Image> images;
  for (TimedImages& camera : *cameras) {
    for (FrameFile& image : camera.images)
      images.push_back({image.frame_id - camera.offset_ns, &camera, std::move(image)});
    camera.images.clear();
  }
  std::ranges::stable_sort(images, {}, &Image::t_ns);
  std::vector<FramePose> frames;
  for (Image& image : images) {
    if (frames.empty() || image.t_ns - frames.back().t_ns > kSameFrame_ns)
      frames.push_back({std::ssize(frames), image.t_ns, pose_at(poses, image.t_ns)});
    image.file.frame_id = frames.back().id;
    std::vector<FrameFile>& of_camera = image.of->images;
    const DamagedList times{"times of " + image.of->camera, damaged};
    if (parse_record(&times, image.file.frame_id, [&] {
          if (!of_camera.empty() && of_camera.back().frame_id == image.file.frame_id)
            throw InputError(file, image.of->camera, image.file.path.string(),
                             "less than 5 ms after " + of_camera.back().path.string());
        }))
      of_camera.push_back(std::move(image.file));
  }
  return frames;
}

const FramePose& nearest_frame(const std::vector<FramePose>& frames, std::int64_t t_ns) {
  auto frame = std::ranges::lower_bound(frames, t_ns, {}, &FramePose::t_ns);
  if (frame == frames.end() ||
      (frame != frames.begin() && t_ns - (frame - 1)->t_ns < frame->t_ns - t_ns))
    --frame;
  return *frame;
}

}  // namespace redrive

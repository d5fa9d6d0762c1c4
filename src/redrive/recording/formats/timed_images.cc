// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/timed_images.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "redrive/base/error.h"
#include "redrive/recording/core/damaged_text.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/core/upper_median.h"

namespace redrive {
namespace {

/// Median of the times of images after the images of the first camera that are nearest to `guess`
/// before them.
std::int64_t time_offset_of(const std::vector<FrameFile>& images,
                            const std::vector<FrameFile>& first, std::int64_t guess_ns,
                            std::int64_t same_trigger_ns) {
  std::vector<double> offsets;
  for (const FrameFile& image : images) {
    const std::int64_t t_ns = image.frame_id - guess_ns;
    auto after = std::ranges::lower_bound(first, t_ns, {}, &FrameFile::frame_id);
    if (after == first.end() ||
        (after != first.begin() && t_ns - (after - 1)->frame_id < after->frame_id - t_ns))
      --after;
    if (std::abs(t_ns - after->frame_id) < same_trigger_ns)
      offsets.push_back(static_cast<double>(image.frame_id - after->frame_id));
  }
  return offsets.empty() ? guess_ns : std::llround(upper_median(std::move(offsets)));
}

}  // namespace

void set_time_offsets(std::int64_t same_trigger_ns, std::vector<TimedImages>* cameras) {
  // Where offsets are near half a period, some images are nearer to the trigger before and some to
  // the one after; the second pass takes the same for all.
  for (TimedImages& camera : *cameras)
    for (int pass = 0; pass < 2 && &camera != &cameras->front(); ++pass)
      camera.offset_ns =
          time_offset_of(camera.images, cameras->front().images, camera.offset_ns, same_trigger_ns);
}

std::vector<FramePose> join_frames(const std::vector<FramePose>& poses,
                                   const std::filesystem::path& file,
                                   std::vector<TimedImages>* cameras,
                                   std::vector<DamagedRecord>* damaged, std::int64_t same_ns) {
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
    if (frames.empty() || image.t_ns - frames.back().t_ns > same_ns)
      frames.push_back({std::ssize(frames), image.t_ns, pose_at(poses, image.t_ns)});
    image.file.frame_id = frames.back().id;
    std::vector<FrameFile>& of_camera = image.of->images;
    const DamagedList times{"times of " + image.of->camera, damaged};
    if (parse_record(&times, image.file.frame_id, [&] {
          if (!of_camera.empty() && of_camera.back().frame_id == image.file.frame_id)
            throw InputError(file, image.of->camera, image.file.path.string(),
                             "less than " + std::to_string(same_ns / 1'000'000) + " ms after " +
                                 of_camera.back().path.string());
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

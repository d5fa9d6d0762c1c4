// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/timed_images.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "redrive/base/error.h"
#include "redrive/math/upper_median.h"
#include "redrive/recording/core/damaged_text.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/frame_files.h"

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

constexpr std::int64_t kBeyondPoses_ns = 250'000'000;  // further from a pose a frame has none
constexpr std::int64_t kScanToImage_ns = 100'000'000;

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

namespace {

/// Sets time offsets of cameras that are triggered together; others run freely, each image with a
/// frame of its own.
void set_offsets(std::int64_t same_ns, std::vector<TimedImages>* cameras) {
  std::vector<double> steps;
  const std::vector<FrameFile>& first = cameras->front().images;
  for (std::size_t i = 1; i < first.size(); ++i)
    steps.push_back(static_cast<double>(first[i].frame_id - first[i - 1].frame_id));
  if (steps.empty()) return;
  set_time_offsets(std::llround(upper_median(std::move(steps)) / 2), cameras);
  for (TimedImages& camera : *cameras) {
    std::vector<double> apart;
    for (const FrameFile& image : camera.images) {
      const std::int64_t t_ns = image.frame_id - camera.offset_ns;
      const auto after = std::ranges::lower_bound(first, t_ns, {}, &FrameFile::frame_id);
      double least = INFINITY;
      if (after != first.end()) least = static_cast<double>(after->frame_id - t_ns);
      if (after != first.begin())
        least = std::min(least, static_cast<double>(t_ns - (after - 1)->frame_id));
      apart.push_back(least);
    }
    if (apart.empty() || upper_median(std::move(apart)) > double(same_ns)) camera.offset_ns = 0;
  }
}

/// Number of a camera's images at the time of a pose: frames at these times have it as it is.
std::ptrdiff_t count_at_poses(const TimedImages& camera, const std::vector<FramePose>& poses) {
  constexpr std::int64_t kSameTime_ns = 2000;  // files may count in microseconds
  return std::ranges::count_if(camera.images, [&](const FrameFile& image) {
    return std::abs(nearest_frame(poses, image.frame_id).t_ns - image.frame_id) <= kSameTime_ns;
  });
}

/// Takes frames out that are too far from a pose in time.
void leave_out_unposed(const std::vector<FramePose>& poses, Recording* recording) {
  const auto is_far = [&](const FramePose& frame) {
    return std::abs(nearest_frame(poses, frame.t_ns).t_ns - frame.t_ns) > kBeyondPoses_ns;
  };
  const std::size_t count = std::erase_if(recording->frames, is_far);
  if (count > 0)
    recording->findings.push_back(
        {"poses", counted(count, "time") + " of images further than 0.25 s from a pose"});
}

}  // namespace

void add_posed_cameras(std::vector<TimedImages> cameras,
                       const std::map<std::string, CameraCalibration>& calibrations,
                       Recording* recording) {
  for (TimedImages& camera : cameras) {
    CameraCalibration calibration = calibrations.at(camera.camera);
    calibration.time_offset_ns = camera.offset_ns;
    std::vector<ImageFile> images = images_with_poses(std::move(camera.images), camera.camera,
                                                      recording->frames, &recording->findings);
    if (!images.empty()) recording->cameras.push_back({calibration, std::move(images)});
  }
  std::ranges::sort(recording->cameras, {},
                    [](const RecordedCamera& camera) { return camera.calibration.name; });
  require_cameras(*recording);
}

void add_timed_cameras(const std::vector<FramePose>& poses, const std::filesystem::path& file,
                       const PoseFields& fields, std::vector<TimedImages> cameras,
                       const std::map<std::string, CameraCalibration>& calibrations,
                       std::int64_t same_ns, Recording* recording) {
  std::erase_if(cameras, [](const TimedImages& camera) { return camera.images.empty(); });
  if (cameras.empty()) require_cameras(*recording);
  std::ranges::stable_sort(cameras, std::ranges::greater{}, [&](const TimedImages& camera) {
    return std::pair(camera.images.size(), count_at_poses(camera, poses));
  });
  set_offsets(same_ns, &cameras);
  recording->frames = join_frames(poses, file, &cameras, &recording->damaged, same_ns);
  leave_out_unposed(poses, recording);
  const DamagedList damaged{"poses", &recording->damaged};
  leave_out_impossible(file, fields, &damaged, &recording->frames);
  add_posed_cameras(std::move(cameras), calibrations, recording);
}

void add_timed_scans(std::vector<FrameFile> scans, const std::string& lidar, Recording* recording) {
  std::size_t without_frame = 0;
  for (FrameFile& scan : scans) {
    const FramePose& frame = nearest_frame(recording->frames, scan.frame_id);
    if (std::abs(frame.t_ns - scan.frame_id) > kScanToImage_ns) {
      ++without_frame;
      continue;
    }
    scan.frame_id = frame.id;
    recording->lidar_files.push_back(std::move(scan));
  }
  if (without_frame > 0)
    recording->findings.push_back(
        {lidar, counted(without_frame, "scan") + " not used: no image within 0.1 s"});
}

}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cstdlib>
#include <optional>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/progress.h"
#include "redrive/export/ncore/ncore_sensors.h"
#include "redrive/export/ncore/ncore_terms.h"
#include "redrive/image/image_head.h"
#include "redrive/image/image_io.h"
#include "redrive/image/png.h"
#include "redrive/recording/core/wording.h"

namespace redrive::ncore {
namespace {

struct EncodedImage {
  std::int64_t start_us = 0, end_us = 0;
  std::string bytes;
  const char* format = "";
};

/// Returns a recorded file where it is a PNG or a JPEG, else its image as PNG.
EncodedImage recorded_image(const std::filesystem::path& path, const CameraCalibration& camera) {
  EncodedImage image{0, 0, read_file(path, kMaxImageBytes), "png"};
  if (const auto head = parse_image_head(image.bytes);
      head && (head->width != camera.width || head->height != camera.height))
    throw InputError(path, "size", size_text(head->width, head->height),
                     "the calibration has " + size_text(camera.width, camera.height));
  if (image.bytes.starts_with("\xff\xd8"))
    image.format = "jpeg";
  else if (!is_png(image.bytes))
    image.bytes = encode_png(read_image(path));
  return image;
}

/// NCore exposes row v of h, or column v, at start + v / (h - 1) of the frame's time.
void set_times(const CameraCalibration& camera, std::int64_t frame_ns, const Sequence& sequence,
               EncodedImage* image) {
  const int lines = camera.readout_by_column ? camera.width : camera.height;
  const std::int64_t middle_ns = frame_ns + camera.time_offset_ns,
                     half_ns = std::abs(camera.readout_ns) / 2 * (lines - 1) / lines;
  image->start_us = sequence.us(middle_ns - half_ns);
  image->end_us = sequence.us(middle_ns + half_ns);
}

/// The mask that all images share, white where they are masked. Others are named.
std::string ego_mask(const RecordedCamera& camera, const Resampling* resampling,
                     DriveNotes* notes) {
  MaskFile mask = camera.images.front().mask;
  const bool same = std::ranges::all_of(
      camera.images, [&](const ImageFile& image) { return image.mask.path == mask.path; });
  if (!same) {
    notes->left_out.push_back("masks of single images of " + camera.calibration.name +
                              ": NCore has one mask for a camera");
    mask = {};
  }
  const std::optional<WrittenMask> pixels = written_mask(mask, resampling);
  if (!pixels) return {};
  Image8 image{pixels->width, pixels->height, {}, {}, {}};
  for (const std::uint8_t used : pixels->used)
    image.rgb.insert(image.rgb.end(), 3, static_cast<std::uint8_t>(255 - used));
  return encode_png(image);
}

}  // namespace

WrittenSensor write_camera(const RecordedCamera& camera, const std::vector<FramePose>& frames,
                           ThreadPool& pool, const std::atomic<bool>& stop, Sequence* sequence,
                           DriveNotes* notes) {
  const PhotoCamera photo = photo_camera(camera.calibration, has_model);
  std::optional<Resampling> resampling;
  if (photo.resampled) {
    resampling = make_resampling(photo);
    notes->changed.push_back("the images of " + camera.calibration.name + " (" +
                             camera.calibration.model + ") are resampled to " +
                             photo.calibration.model + " as PNG");
  }
  const Resampling* const how = resampling ? &*resampling : nullptr;
  WrittenSensor written{
      sequence->sensor_id(camera.calibration.name), camera.calibration.body_from_sensor,
      camera_model(photo.calibration, photo.camera), ego_mask(camera, how, notes)};
  const std::string component = sequence->component("cameras", written.id);
  FrameTimes times;
  std::size_t late = 0;
  Progress progress("writing images of " + written.id, std::ssize(camera.images));
  const auto make = [&](std::size_t i) {
    if (stop) throw Interrupted();
    const ImageFile& file = camera.images[i];
    EncodedImage image;
    if (how)
      image = {0, 0, encode_png(resampled_image(file.path, photo, *how)), "png"};
    else
      image = recorded_image(file.path, camera.calibration);
    const auto frame = std::ranges::lower_bound(frames, file.frame_id, {}, &FramePose::id);
    REDRIVE_CHECK(frame != frames.end() && frame->id == file.frame_id);
    set_times(camera.calibration, frame->t_ns, *sequence, &image);
    return image;
  };
  make_in_order(pool, camera.images.size(), make, [&](const EncodedImage& image) {
    progress.count();
    if (!times.add(image.start_us, image.end_us)) return void(++late);
    sequence->cover(image.start_us, image.end_us);
    const std::string frame = component + "/frames/" + std::to_string(image.end_us);
    sequence->store().file(frame + "/image", image.bytes, {{"format", image.format}});
    sequence->store().group(frame + "/generic_data", Json::object());
  });
  sequence->store().group(component + "/frames", {{"frames_timestamps_us", times.json()}});
  if (late > 0)
    notes->left_out.push_back(counted(late, "image") + " of " + written.id +
                              " in the same microsecond as another");
  return written;
}

}  // namespace redrive::ncore

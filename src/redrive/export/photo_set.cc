// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/photo_set.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <set>

#include "redrive/base/error.h"
#include "redrive/image/image_io.h"

namespace redrive {
namespace {

/// Returns a camera that COLMAP and nerfstudio have, at the same place with the same size.
CameraCalibration plain_camera_for(const CameraCalibration& calibration, const Camera& recorded) {
  CameraCalibration plain = calibration;
  plain.parameters.resize(4);
  if (recorded.info().perspective) {
    plain.model = "opencv_pinhole";
    plain.parameters.resize(9, 0);
    return plain;
  }
  // Pixels per radian around the axis stay the same.
  constexpr double kStep_rad = 1e-4;
  const auto axis = recorded.project({0, 0, 1});
  REDRIVE_CHECK(axis.has_value());
  const auto along = [&](const Eigen::Vector3d& direction) {
    const auto pixel = recorded.project(direction);
    REDRIVE_CHECK(pixel.has_value());
    return (*pixel - *axis).norm() / kStep_rad;
  };
  plain.model = "opencv_fisheye";
  plain.parameters[0] = along({kStep_rad, 0, 1});
  plain.parameters[1] = along({0, kStep_rad, 1});
  plain.parameters.resize(8, 0);
  return plain;
}

/// Whether the lens sees every pixel at the border of the image, and so all between.
bool sees_all(const PhotoCamera& photo) {
  const Camera &camera = photo.camera, &recorded = photo.recorded;
  const auto seen = [&](int x, int y) {
    const auto direction = camera.unproject({double(x), double(y)});
    const auto pixel =
        direction ? recorded.project(photo.recorded_from_written * *direction) : std::nullopt;
    return pixel && pixel->x() >= 0 && pixel->x() <= recorded.width - 1 && pixel->y() >= 0 &&
           pixel->y() <= recorded.height - 1;
  };
  for (int x = 0; x < camera.width; ++x)
    if (!seen(x, 0) || !seen(x, camera.height - 1)) return false;
  for (int y = 0; y < camera.height; ++y)
    if (!seen(0, y) || !seen(camera.width - 1, y)) return false;
  return true;
}

void list_left_out(const Recording& recording, const Scene& scene, PhotoSet* set) {
  std::string offsets, rolling;
  const auto add = [](const std::string& name, std::string* list) {
    *list += (list->empty() ? "" : ", ") + name;
  };
  for (std::size_t c = 0; c < scene.rig.size(); ++c) {
    const RigCamera& rig = scene.rig[c];
    if (rig.readout_ns != 0) add(rig.name, &rolling);
    if (rig.time_offset_ns != 0) add(rig.name, &offsets);
    if (!set->cameras[c].resampled) continue;
    std::string what = "the lens of " + rig.name + " (";
    what += rig.recorded.info().name;
    what += "): its images are resampled to " + set->cameras[c].calibration.model;
    set->left_out.push_back(what + ", with masks of pixels that the lens does not see");
  }
  if (!rolling.empty())
    set->left_out.emplace_back("rolling shutter of " + rolling +
                               ": each image has the pose of its middle row");
  if (!offsets.empty())
    set->left_out.emplace_back("time offsets of " + offsets +
                               ": each image has the pose of its own time");
  if (scene.metric) set->left_out.emplace_back("times, and the rig: every image has its own pose");
  if (!recording.box_files.empty()) set->left_out.emplace_back("boxes of annotated objects");
  if (!recording.novel.empty()) set->left_out.emplace_back("novel views with their ground truth");
  if (scene.background != Background::kNone)
    set->left_out.emplace_back("the background: images keep their transparency");
  if (recording.bounds) set->left_out.emplace_back("the bounds of the scene");
}

}  // namespace

PhotoCamera photo_camera(const CameraCalibration& recorded,
                         const std::function<bool(const CameraCalibration&)>& has_model) {
  const Camera camera = make_camera(recorded);
  PhotoCamera out{recorded, camera, camera};
  if (has_model(out.calibration)) return out;
  out.resampled = true;
  out.calibration = plain_camera_for(out.calibration, camera);
  out.camera = make_camera(out.calibration);
  return out;
}

PhotoCamera pinhole_photo_camera(const CameraCalibration& recorded,
                                 const std::optional<Eigen::Matrix3d>& body_from_written) {
  constexpr double kSameAxes = 1e-9;
  const Eigen::Matrix3d body_from_recorded = recorded.body_from_sensor.linear(),
                        written = body_from_written.value_or(body_from_recorded);
  const bool same_axes = (written - body_from_recorded).norm() < kSameAxes;
  PhotoCamera camera = photo_camera(recorded, [&](const CameraCalibration& calibration) {
    return same_axes && calibration.model == "opencv_pinhole" &&
           std::all_of(calibration.parameters.begin() + 4, calibration.parameters.end(),
                       [](double k) { return k == 0; });
  });
  if (!camera.recorded.info().perspective) {
    constexpr double kHalfAcross_rad = 50 * std::numbers::pi / 180;
    const double focal_px = 0.5 * recorded.width / std::tan(kHalfAcross_rad);
    camera.calibration.model = "opencv_pinhole";
    camera.calibration.parameters = {
        focal_px, focal_px, 0.5 * (recorded.width - 1), 0.5 * (recorded.height - 1), 0, 0, 0, 0, 0};
    camera.camera = make_camera(camera.calibration);
  }
  if (!same_axes) {
    camera.recorded_from_written = body_from_recorded.transpose() * written;
    camera.calibration.body_from_sensor.linear() = written;
    // What was at the principal point stays there.
    const Eigen::Vector3d axis = camera.recorded_from_written.transpose().col(2);
    std::vector<double>& p = camera.calibration.parameters;  // fx, fy, cx, cy
    p[2] -= p[0] * axis.x() / axis.z();
    p[3] -= p[1] * axis.y() / axis.z();
    camera.camera = make_camera(camera.calibration);
  }
  // A longer focal length crops what the lens does not see.
  constexpr double kStep = 1.02;
  constexpr int kMostSteps = 300;  // down to a third of a degree
  for (int i = 0; camera.resampled && i < kMostSteps && !sees_all(camera); ++i) {
    camera.calibration.parameters[0] *= kStep;
    camera.calibration.parameters[1] *= kStep;
    camera.camera = make_camera(camera.calibration);
  }
  return camera;
}

PhotoSet make_photo_set(const Recording& recording, const Scene& scene,
                        const std::function<bool(const CameraCalibration&)>& has_model) {
  PhotoSet set;
  set.world_from_scene = scene.metric ? Rigid3d::Identity() : scene.global_from_world;
  set.world = scene.metric ? "body axes (x forward, y left, z up) of frame " +
                                 std::to_string(recording.frames.front().id)
                           : "the recording's own axes";
  for (const RigCamera& rig : scene.rig)
    set.cameras.push_back(photo_camera(recording.find_camera(rig.name)->calibration, has_model));
  std::set<std::filesystem::path> names;
  for (const View& view : scene.views) {
    const PhotoCamera& camera = set.cameras[view.camera];
    // In COLMAP's text files a name ends at a blank.
    std::string name = view.image.filename().string();
    std::ranges::replace_if(
        name, [](char c) { return c == ' ' || c == '\t'; }, '_');
    std::filesystem::path file = name;
    if (camera.resampled) file.replace_extension(".png");
    // Folders of photographs may share names.
    const std::string once = file.string();
    for (int n = 1; !names.insert(camera.calibration.name / file).second; ++n)
      file = std::to_string(n) + "_" + once;
    set.photos.push_back({camera.calibration.name / file, view.image, view.camera,
                          set.world_from_scene * scene.world_from_camera(view), view.mask,
                          view.held_out});
  }
  list_left_out(recording, scene, &set);
  return set;
}

Resampling make_resampling(const PhotoCamera& camera) {
  Resampling out{make_resample_map(camera.camera, camera.recorded, camera.recorded_from_written),
                 {}};
  const std::vector<std::uint8_t> all(
      static_cast<std::size_t>(camera.recorded.width) * camera.recorded.height, 255);
  // Masks a pixel that is partly outside.
  out.seen = resample(out.map, all, camera.recorded.width, camera.recorded.height, 1, 0);
  for (std::uint8_t& seen : out.seen) {
    seen = seen == 255 ? 255 : 0;
    out.sees_all &= seen == 255;
  }
  return out;
}

Image8 resampled_image(const std::filesystem::path& file, const PhotoCamera& camera,
                       const Resampling& resampling) {
  const Image8 recorded = read_image(file);
  if (recorded.width != camera.recorded.width || recorded.height != camera.recorded.height)
    throw InputError(
        file, "size", size_text(recorded.width, recorded.height),
        "the calibration has " + size_text(camera.recorded.width, camera.recorded.height));
  Image8 image{resampling.map.width, resampling.map.height, {}, {}, {}};
  image.rgb = resample(resampling.map, recorded.rgb, recorded.width, recorded.height, 3, 0);
  return image;
}

std::optional<WrittenMask> written_mask(const MaskFile& file, const Resampling* resampling) {
  std::optional<Image8> mask;
  if (!file.path.empty()) mask = read_image(file.path);
  if (!mask && (!resampling || resampling->sees_all)) return std::nullopt;
  WrittenMask out;
  if (mask) {
    out.width = mask->width;
    out.height = mask->height;
    for (std::size_t i = 0; i < mask->rgb.size(); i += 3) {
      const bool black = mask->rgb[i] == 0 && mask->rgb[i + 1] == 0 && mask->rgb[i + 2] == 0;
      out.used.push_back(black == file.black_is_masked ? 0 : 255);
    }
  }
  if (resampling) {
    if (mask) out.used = resample(resampling->map, out.used, out.width, out.height, 1, 0);
    out.width = resampling->map.width;
    out.height = resampling->map.height;
    if (out.used.empty()) out.used = resampling->seen;
    for (std::size_t i = 0; i < out.used.size(); ++i)
      out.used[i] = out.used[i] == 255 && resampling->seen[i] ? 255 : 0;
  }
  return out;
}

}  // namespace redrive

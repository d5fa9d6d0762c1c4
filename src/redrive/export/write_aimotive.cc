// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cstdio>
#include <iterator>
#include <map>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/progress.h"
#include "redrive/export/drive.h"
#include "redrive/export/write_photo_set.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/formats/aimotive/aimotive_boxes.h"
#include "redrive/recording/formats/calibration_json.h"
#include "redrive/recording/formats/egomotion_json.h"
#include "redrive/recording/lidar/las.h"
#include "redrive/recording/lidar/ply.h"
#include "redrive/recording/parse/rigid_json.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;

constexpr const char* kLidarName = "LIDAR";
// Times in seconds and nanoseconds are doubles, which resolve today's Unix time to 0.1 us. Above
// this, whole days are subtracted.
constexpr std::int64_t kLatest_ns = 1'000'000'000'000'000, kDay_ns = 86'400'000'000'000;

std::string padded(std::int64_t frame_id) {
  char text[32];
  std::snprintf(text, sizeof text, "%07lld", static_cast<long long>(frame_id));
  return text;
}

nlohmann::json calibration_file(const Recording& drive) {
  nlohmann::json sensors = nlohmann::json::object();
  for (const RecordedCamera& camera : drive.cameras) {
    nlohmann::json entry = calibration_to_json(camera.calibration);
    const Eigen::Vector3d position = camera.calibration.body_from_sensor.translation();
    entry["pos_meter"] = {position.x(), position.y(), position.z()};
    sensors[camera.calibration.name] = entry;
  }
  if (!drive.lidars.empty())
    sensors[kLidarName] = {{"sensor_type", "lidar"},
                           {"RT_body_from_sensor", rigid_to_json(drive.lidars[0].body_from_lidar)}};
  return sensors;
}

void write_boxes(const fs::path& folder, const Recording& drive, std::int64_t earlier_ns) {
  make_folders(folder);
  for (const FrameFile& file : drive.box_files) {
    std::vector<Box> boxes = drive.reader->read_boxes(file);
    const auto frame = std::ranges::lower_bound(drive.frames, file.frame_id, {}, &FramePose::id);
    if (frame == drive.frames.end() || frame->id != file.frame_id) continue;
    // A file has one time: the boxes' own, or the frame's.
    const bool same =
        std::ranges::all_of(boxes, [&](const Box& box) { return box.t_ns == boxes.front().t_ns; });
    const std::int64_t t_ns = same && !boxes.empty() ? boxes.front().t_ns : frame->t_ns;
    const Rigid3d body_from_global = pose_at(drive.frames, t_ns).inverse(Eigen::Isometry);
    for (Box& box : boxes)
      if (box.t_ns != t_ns) {
        const Eigen::Vector3d velocity = velocity_in_global(box, drive.frames);
        box.body_from_box = body_from_global * global_from_box_at(box, drive.frames, t_ns);
        box.velocity_in_body_m_per_s =
            body_from_global.linear() * (velocity - velocity_at(drive.frames, t_ns));
      }
    write_file(folder / ("frame_" + padded(file.frame_id) + ".json"),
               aimotive::boxes_to_json(t_ns - earlier_ns, boxes).dump(1) + "\n");
  }
}

void write_points(const fs::path& file, const Recording& drive) {
  const Rigid3d body_from_global = drive.frames.front().global_from_body.inverse(Eigen::Isometry);
  std::vector<PlyPoint> points;
  for (const StaticPoint& point : drive.reader->read_points(drive))
    points.push_back({(body_from_global * point.in_global).cast<float>(), {0, 0, 0}, {}});
  write_file(file, make_ply(points, /*normals=*/false));
}

/// Coordinates are exact to 1 um, or to 10 um where 1 um does not fit.
std::string revolution_las(const std::vector<LidarPoint>& points) {
  constexpr double kFine_m = 1e-6, kCoarse_m = 1e-5;
  std::vector<LidarRecord> scan;
  double farthest_m = 0;
  for (const LidarPoint& point : points) {
    scan.push_back(
        {point.in_body_m.cast<double>(), point.t_ns, static_cast<float>(point.intensity) / 65535});
    farthest_m = std::max(farthest_m, scan.back().position_m.lpNorm<Eigen::Infinity>());
  }
  return make_las(scan, farthest_m < max_las_position_m(kFine_m) ? kFine_m : kCoarse_m);
}

}  // namespace

DriveNotes write_aimotive(const fs::path& folder, const Recording& drive, ThreadPool& pool,
                          const std::atomic<bool>& stop) {
  DriveNotes notes;
  PhotoSet photos;
  for (const RecordedCamera& camera : drive.cameras) {
    const std::string& name = camera.calibration.name;
    photos.cameras.push_back(photo_camera(camera.calibration, [](const auto&) { return true; }));
    add_photos(
        camera,
        [&](const ImageFile& image) {
          return fs::path(name) /
                 (name + "_" + padded(image.frame_id) + image.path.extension().string());
        },
        &photos);
    if (camera.calibration.model != "opencv_pinhole" && camera.calibration.model != "mei")
      notes.changed.push_back("the lens of " + name + " (" + camera.calibration.model +
                              ") has a name that redrive alone reads");
  }
  write_drive_images(folder, "sensor/camera", photos, pool, stop, &notes);
  make_folders(folder / "sensor/calibration");
  write_file(folder / "sensor/calibration/calibration.json",
             calibration_file(drive).dump(1) + "\n");

  std::vector<FramePose> frames = drive.frames;
  const std::int64_t earlier_ns =
      frames.front().t_ns > kLatest_ns ? frames.front().t_ns / kDay_ns * kDay_ns : 0;
  for (FramePose& frame : frames) frame.t_ns -= earlier_ns;
  if (earlier_ns != 0)
    notes.changed.emplace_back("times count from midnight (UTC) before the first frame");
  make_folders(folder / "sensor/gnssins");
  write_file(folder / "sensor/gnssins/egomotion2.json", egomotion_to_json(frames).dump(1) + "\n");

  if (!drive.lidars.empty() && !drive.lidar_files.empty()) {
    const fs::path scans = folder / "dynamic/raw-revolutions";
    make_folders(scans);
    std::map<std::int64_t, std::vector<FrameFile>> of_frame;
    const std::vector<FrameFile> files = drive.scans_of(0);
    for (const FrameFile& file : files) of_frame[file.frame_id].push_back(file);
    const std::vector<std::pair<std::int64_t, std::vector<FrameFile>>> revolutions(of_frame.begin(),
                                                                                   of_frame.end());
    Progress progress("writing LiDAR", std::ssize(revolutions));
    pool.run(static_cast<int>(revolutions.size()), [&](int r) {
      if (stop) throw Interrupted();
      const auto& [frame_id, of_one] = revolutions[static_cast<std::size_t>(r)];
      std::vector<LidarPoint> points;
      for (const FrameFile& file : of_one)
        std::ranges::copy(drive.read_lidar(file), std::back_inserter(points));
      if (of_one.size() > 1) std::ranges::stable_sort(points, {}, &LidarPoint::t_ns);
      for (LidarPoint& point : points) point.t_ns -= earlier_ns;
      write_file(scans / ("frame_" + padded(frame_id) + ".las"), revolution_las(points));
      progress.count();
    });
    if (revolutions.size() < files.size())
      notes.changed.emplace_back("LiDAR revolutions of the same frame are one file");
  }
  if (!drive.box_files.empty()) {
    write_boxes(folder / "dynamic/box/3d_body", drive, earlier_ns);
    notes.changed.emplace_back("people in boxes count as moving from 1 m/s on, as other objects");
  }
  if (!drive.points_file.empty()) write_points(folder / "points.ply", drive);
  note_left_out(drive, &notes);
  return notes;
}

}  // namespace redrive

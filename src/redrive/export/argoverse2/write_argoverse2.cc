// SPDX-License-Identifier: Apache-2.0
// Layout: https://argoverse.github.io/user-guide/datasets/sensor.html
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <set>
#include <string>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/progress.h"
#include "redrive/export/argoverse2/argoverse2_lasers.h"
#include "redrive/export/argoverse2/argoverse2_terms.h"
#include "redrive/export/compensated_scans.h"
#include "redrive/export/drive.h"
#include "redrive/export/write_photo_set.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/argoverse2/argoverse2_boxes.h"
#include "redrive/recording/formats/argoverse2/argoverse2_scan.h"
#include "redrive/recording/formats/argoverse2/argoverse2_tables.h"
#include "redrive/recording/parse/arrow_writer.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;
using argoverse2::LasersOfLidar;

/// Columns of poses.
class PoseRows {
 public:
  void add(const Rigid3d& pose) {
    const Eigen::Quaterniond q(pose.linear());
    const Eigen::Vector3d& t = pose.translation();
    const double values[] = {q.w(), q.x(), q.y(), q.z(), t.x(), t.y(), t.z()};
    for (std::size_t k = 0; k < 7; ++k) columns_[k].push_back(values[k]);
  }
  void write(ArrowWriter* table) const {
    for (std::size_t k = 0; k < 7; ++k) table->add(argoverse2::kPoseColumns[k], columns_[k]);
  }

 private:
  std::vector<double> columns_[7];
};

/// A row of annotations.feather.
struct WrittenCuboid {
  const Box* box = nullptr;
  Rigid3d vehicle_from_box;  ///< at the sweep's time
  std::size_t returns = 0;
};

/// A file of both LiDARs.
struct Sweep {
  std::int64_t t_ns = 0;  ///< time of its first return
  std::vector<std::pair<const LasersOfLidar*, const ScanOfDrive*>> scans;
  std::vector<Box> boxes;
  std::vector<WrittenCuboid> cuboids;
};

class LogWriter {
 public:
  LogWriter(const fs::path& folder, const Recording& drive, ThreadPool& pool,
            const std::atomic<bool>& stop, DriveNotes* notes)
      : folder_(folder),
        drive_(drive),
        pool_(pool),
        stop_(stop),
        notes_(*notes),
        city_from_global_(local_from_global(drive)),
        body_from_vehicle_(argoverse2::body_from_vehicle()) {
    note_world(drive, "city", notes);
    later_ns_ = added_to_times_ns(drive, notes);
    for (const FramePose& frame : drive.frames) times_ns_.insert(frame.t_ns);
  }

  void write() {
    make_folders(folder_ / "calibration");
    write_pictures();
    write_scans();
    write_sensors();
    write_poses();
  }

 private:
  Rigid3d city_from_vehicle(std::int64_t t_ns) const {
    return city_from_global_ * pose_at(drive_.frames, t_ns) * body_from_vehicle_;
  }
  std::string file_name(std::int64_t t_ns, const char* extension) const {
    return std::to_string(t_ns + later_ns_) + extension;
  }
  void write_table(const fs::path& name, ArrowWriter table) const {
    write_file(folder_ / name, table.bytes());
  }

  void write_pictures() {
    names_ = argoverse2::ring_names(drive_.cameras);
    PhotoSet photos;
    for (std::size_t c = 0; c < drive_.cameras.size(); ++c) {
      const RecordedCamera& camera = drive_.cameras[c];
      const std::string& name = camera.calibration.name;
      if (names_[c] != name) notes_.changed.push_back(name + " is " + names_[c]);
      add_pinhole(camera.calibration, &photos, &notes_);
      pinholes_.push_back(photos.cameras.back().calibration);
      std::size_t repacked = 0;
      for (const ImageFile& image : camera.images) {
        const std::int64_t t_ns =
            std::ranges::lower_bound(drive_.frames, image.frame_id, {}, &FramePose::id)->t_ns +
            camera.calibration.time_offset_ns;
        times_ns_.insert(t_ns);
        repacked += image.path.extension() != ".jpg";
        photos.photos.push_back({fs::path(names_[c]) / file_name(t_ns, ".jpg"),
                                 image.path,
                                 static_cast<int>(c),
                                 Rigid3d::Identity(),
                                 {},
                                 false});
      }
      if (repacked > 0)
        notes_.changed.push_back(counted(repacked, "image") + " of " + name +
                                 " become JPEG, as the format has them");
    }
    write_drive_images(folder_, "sensors/cameras", photos, pool_, stop_, &notes_);
  }

  /// Lists the sweeps: scans of the first LiDAR, each with the one of the other LiDAR that begins
  /// within half a revolution.
  void list_sweeps() {
    lasers_ = argoverse2::assign_lasers(drive_, &notes_);
    for (const LasersOfLidar& lasers : lasers_) files_.push_back(drive_.scans_of(lasers.lidar));
    for (const std::vector<FrameFile>& files : files_) {
      scans_.push_back(list_scans(drive_, files, pool_, stop_, &notes_));
      full_scale_.push_back(full_scale_of(scans_.back()));
    }
    if (scans_.empty()) return;
    std::vector<std::int64_t> begins;
    for (const ScanOfDrive& scan : scans_[0]) {
      sweeps_.push_back({scan.first_ns, {{&lasers_[0], &scan}}, {}, {}});
      begins.push_back(scan.first_ns);
    }
    for (std::size_t k = 1; k < scans_.size(); ++k) {
      std::size_t alone = 0;
      for (const ScanOfDrive& scan : scans_[k]) {
        const auto sweep = std::ranges::min_element(
            begins, {}, [&](std::int64_t begin_ns) { return std::abs(begin_ns - scan.first_ns); });
        const std::size_t s = static_cast<std::size_t>(sweep - begins.begin());
        if (sweep == begins.end() || sweeps_[s].scans.size() > k ||
            std::abs(*sweep - scan.first_ns) > argoverse2::kRevolution_ns / 2) {
          ++alone;
          continue;
        }
        sweeps_[s].scans.emplace_back(&lasers_[k], &scan);
        sweeps_[s].t_ns = std::min(sweeps_[s].t_ns, scan.first_ns);
      }
      if (alone > 0)
        notes_.left_out.push_back(counted(alone, "revolution") + " of " +
                                  drive_.lidars[lasers_[k].lidar].name + " without one of " +
                                  drive_.lidars[lasers_[0].lidar].name);
    }
  }

  void write_scans() {
    list_sweeps();
    for (Sweep& sweep : sweeps_) {
      times_ns_.insert(sweep.t_ns);
      for (const auto& [lasers, scan] : sweep.scans) times_ns_.insert(scan->last_ns);
      sweep.boxes = boxes_near(drive_, sweep.t_ns + argoverse2::kRevolution_ns / 2);
    }
    if (!sweeps_.empty()) make_folders(folder_ / "sensors/lidar");
    Progress progress("writing LiDAR", std::ssize(sweeps_));
    pool_.run(static_cast<int>(sweeps_.size()), [&](int s) {
      if (stop_) throw Interrupted();
      write_sweep(&sweeps_[static_cast<std::size_t>(s)]);
      progress.count();
    });
    if (sweeps_.empty()) add_boxes_of_frames();
    write_annotations();
  }

  /// Adds the boxes of a drive without scans, each at the time of its frame: the middle of a
  /// revolution.
  void add_boxes_of_frames() {
    for (const FrameFile& file : drive_.box_files) {
      const auto frame = std::ranges::lower_bound(drive_.frames, file.frame_id, {}, &FramePose::id);
      if (frame == drive_.frames.end() || frame->id != file.frame_id) continue;
      sweeps_.push_back(
          {frame->t_ns - argoverse2::kRevolution_ns / 2, {}, drive_.reader->read_boxes(file), {}});
    }
    for (Sweep& sweep : sweeps_) {
      times_ns_.insert(sweep.t_ns);
      add_cuboids(std::vector<ObjectReturns>(sweep.boxes.size(),
                                             {0, sweep.t_ns + argoverse2::kRevolution_ns / 2}),
                  &sweep);
    }
  }

  void add_cuboids(const std::vector<ObjectReturns>& returns, Sweep* sweep) const {
    const Rigid3d vehicle_from_global =
        (pose_at(drive_.frames, sweep->t_ns) * body_from_vehicle_).inverse(Eigen::Isometry);
    // A box is where its returns are, as the data set's are.
    for (std::size_t b = 0; b < sweep->boxes.size(); ++b)
      sweep->cuboids.push_back(
          {&sweep->boxes[b],
           vehicle_from_global *
               global_from_box_at(sweep->boxes[b], drive_.frames, returns[b].t_ns),
           returns[b].n});
  }

  /// Writes the returns where they would be at the sweep's time.
  void write_sweep(Sweep* sweep) const {
    const Rigid3d vehicle_from_global =
        (pose_at(drive_.frames, sweep->t_ns) * body_from_vehicle_).inverse(Eigen::Isometry);
    const Rigid3d global_from_lidar =
        pose_at(drive_.frames, sweep->t_ns) *
        spinning_axes(drive_.lidars[lasers_[0].lidar].body_from_lidar);
    ReturnsOnObjects on_objects(sweep->boxes, drive_.frames,
                                global_from_lidar.inverse(Eigen::Isometry));
    std::vector<float> xyz[3];
    std::vector<std::uint8_t> intensity, numbers;
    std::vector<std::int32_t> offset_ns;
    for (const auto& [lasers, scan] : sweep->scans) {
      const auto of_lidar = static_cast<std::size_t>(lasers - lasers_.data());
      const double full_scale = full_scale_[of_lidar];
      std::vector<LidarPoint> points = new_points(drive_, scan->file, scan->before);
      std::ranges::stable_sort(points, {}, &LidarPoint::t_ns);
      const std::vector<std::uint8_t> of_points = lasers->numbers(drive_, points);
      numbers.insert(numbers.end(), of_points.begin(), of_points.end());
      for_each_in_global(points, drive_.frames,
                         [&](const Eigen::Vector3d& in_global, const LidarPoint& point) {
                           const Eigen::Vector3d in_vehicle = vehicle_from_global * in_global;
                           for (int k = 0; k < 3; ++k)
                             xyz[k].push_back(static_cast<float>(in_vehicle[k]));
                           intensity.push_back(static_cast<std::uint8_t>(
                               std::lround(255 * std::min(1.0, point.intensity / full_scale))));
                           offset_ns.push_back(static_cast<std::int32_t>(point.t_ns - sweep->t_ns));
                           on_objects.count(in_global, point.t_ns);
                         });
    }
    ArrowWriter table;
    for (int k = 0; k < 3; ++k) table.add(std::string(1, "xyz"[k]), xyz[k]);
    table.add("intensity", intensity);
    table.add("laser_number", numbers);
    table.add("offset_ns", offset_ns);
    write_table("sensors/lidar/" + file_name(sweep->t_ns, ".feather"), std::move(table));
    add_cuboids(on_objects.returns(), sweep);
  }

  void write_annotations() {
    std::vector<std::int64_t> t_ns, returns;
    std::vector<std::string> tracks, categories;
    std::vector<double> sizes[3];
    PoseRows poses;
    std::set<std::string> renamed, others;
    for (const Sweep& sweep : sweeps_)
      for (const WrittenCuboid& cuboid : sweep.cuboids) {
        const Box& box = *cuboid.box;
        const std::string category = argoverse2::category_of(box.type);
        if (category != box.type) renamed.insert(box.type + " is " + category);
        if (!argoverse2::is_known_category(category)) others.insert(category);
        t_ns.push_back(sweep.t_ns + later_ns_);
        tracks.push_back(argoverse2::track_uuid(box.object_id));
        categories.push_back(category);
        for (int k = 0; k < 3; ++k) sizes[k].push_back(box.size_m[k]);
        poses.add(cuboid.vehicle_from_box);
        returns.push_back(static_cast<std::int64_t>(cuboid.returns));
      }
    if (!renamed.empty())
      notes_.changed.push_back("categories of boxes: " +
                               first_few(std::vector<std::string>(renamed.begin(), renamed.end())));
    if (!others.empty())
      notes_.changed.push_back("categories that Argoverse 2 lacks: " +
                               first_few(std::vector<std::string>(others.begin(), others.end())));
    const auto without = static_cast<std::size_t>(
        std::ranges::count_if(sweeps_, [](const Sweep& sweep) { return sweep.boxes.empty(); }));
    if (!drive_.box_files.empty() && without > 0)
      notes_.left_out.push_back(counted(without, "scan") + " without boxes within 0.3 s");
    if (drive_.box_files.empty()) return;
    ArrowWriter table;
    table.add("timestamp_ns", t_ns);
    table.add("track_uuid", tracks);
    table.add("category", categories);
    for (std::size_t k = 0; k < 3; ++k) table.add(argoverse2::kSizeColumns[k], sizes[k]);
    poses.write(&table);
    table.add("num_interior_pts", returns);
    write_table(argoverse2::kAnnotations, std::move(table));
  }

  void write_sensors() const {
    std::vector<std::string> names = names_;
    PoseRows places;
    const Rigid3d vehicle_from_body = body_from_vehicle_.inverse(Eigen::Isometry);
    for (const RecordedCamera& camera : drive_.cameras)
      places.add(vehicle_from_body * camera.calibration.body_from_sensor);
    for (const LasersOfLidar& lasers : lasers_)
      for (const bool down : {false, true}) {
        const int first = down ? argoverse2::kLasersOfLidar : 0;
        if (first < lasers.first || first >= lasers.first + lasers.count) continue;
        names.emplace_back(down ? argoverse2::kDownLidar : argoverse2::kUpLidar);
        places.add(vehicle_from_body * drive_.lidars[lasers.lidar].body_from_lidar);
      }
    ArrowWriter table;
    table.add("sensor_name", names);
    places.write(&table);
    write_table(argoverse2::kExtrinsics, std::move(table));

    std::vector<double> fx, fy, cx, cy;
    std::vector<std::uint16_t> width, height;
    for (const CameraCalibration& pinhole : pinholes_) {
      fx.push_back(pinhole.fx());
      fy.push_back(pinhole.fy());
      cx.push_back(pinhole.cx());
      cy.push_back(pinhole.cy());
      width.push_back(static_cast<std::uint16_t>(pinhole.width));
      height.push_back(static_cast<std::uint16_t>(pinhole.height));
    }
    ArrowWriter intrinsics;
    intrinsics.add("sensor_name", names_);
    intrinsics.add("fx_px", fx);
    intrinsics.add("fy_px", fy);
    intrinsics.add("cx_px", cx);
    intrinsics.add("cy_px", cy);
    for (const char* name : {"k1", "k2", "k3"})
      intrinsics.add(name, std::vector<double>(names_.size()));
    intrinsics.add("height_px", height);
    intrinsics.add("width_px", width);
    write_table(argoverse2::kIntrinsics, std::move(intrinsics));
  }

  void write_poses() const {
    std::vector<std::int64_t> t_ns;
    PoseRows poses;
    for (const std::int64_t time_ns : times_ns_) {
      t_ns.push_back(time_ns + later_ns_);
      poses.add(city_from_vehicle(time_ns));
    }
    ArrowWriter table;
    table.add("timestamp_ns", t_ns);
    poses.write(&table);
    write_table(argoverse2::kPoses, std::move(table));
  }

  const fs::path& folder_;
  const Recording& drive_;
  ThreadPool& pool_;
  const std::atomic<bool>& stop_;
  DriveNotes& notes_;
  Rigid3d city_from_global_, body_from_vehicle_;
  std::int64_t later_ns_ = 0;
  std::set<std::int64_t> times_ns_;  ///< times with a pose
  std::vector<std::string> names_;   ///< camera names
  std::vector<CameraCalibration> pinholes_;
  std::vector<LasersOfLidar> lasers_;
  /// Files and scans of each of lasers_.
  std::vector<std::vector<FrameFile>> files_;
  std::vector<std::vector<ScanOfDrive>> scans_;
  std::vector<double> full_scale_;  ///< full scale of the intensities, by LiDAR
  std::vector<Sweep> sweeps_;
};

}  // namespace

DriveNotes write_argoverse2(const fs::path& folder, const Recording& drive, ThreadPool& pool,
                            const std::atomic<bool>& stop) {
  DriveNotes notes;
  LogWriter(folder, drive, pool, stop, &notes).write();
  note_masks(drive, &notes);
  note_not_of_drives(drive, &notes);
  if (!drive.points_file.empty()) notes.left_out.emplace_back("the static point cloud");
  return notes;
}

}  // namespace redrive

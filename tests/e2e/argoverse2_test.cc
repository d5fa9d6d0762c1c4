// SPDX-License-Identifier: Apache-2.0
// A log of Argoverse 2: the street, its two pinholes without distortion, in that layout, aligned.
#include <algorithm>

#include "redrive/image/image_io.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/formats/pose_files.h"
#include "redrive/recording/formats/recording_reader.h"
#include "redrive/recording/parse/arrow_testing.h"
#include "redrive/scene/load_views.h"
#include "tests/e2e/end_to_end.h"

namespace redrive::testing {
namespace {

constexpr double kAxleHeight_m = 0.33;  // the vehicle's origin lies on the rear axle

class EndToEndArgoverse2 : public EndToEnd {
 protected:
  EndToEndArgoverse2() {
    SceneOptions options;
    options.cameras = {"F_MIDRANGECAM_C", "F_MIDLONGRANGECAM_CL"};
    options.undistort = true;
    options.first_frame = 1000;
    options.last_frame = 1015;
    const Scene scene = make_scene(street_, options);
    write_calibration(scene);
    for (const View& view : scene.views) {
      const fs::path folder = log_ / "sensors/cameras" / kCameras[view.camera];
      fs::create_directories(folder);
      const std::int64_t t_ns = scene.frames[view.frame].t_ns;
      write_image(folder / (std::to_string(t_ns) + ".jpg"), load_view(scene, view));
    }
    std::vector<std::int64_t> times_ns;
    std::vector<Rigid3d> poses;
    for (const Frame& frame : scene.frames) {
      times_ns.push_back(frame.t_ns);
      poses.push_back(world_from_vehicle(frame.t_ns));
      const auto file = std::ranges::find(street_.lidar_files, frame.id, &FrameFile::frame_id);
      if (file != street_.lidar_files.end()) write_sweep(*file, frame.t_ns);
    }
    ArrowFile table;
    table.add("timestamp_ns", times_ns);
    add_poses(poses, &table);
    write("city_SE3_egovehicle.feather", &table);
  }

  Rigid3d world_from_vehicle(std::int64_t t_ns) const {
    return street_.frames[0].global_from_body.inverse() * pose_at(street_.frames, t_ns) *
           Eigen::Translation3d(0, 0, kAxleHeight_m);
  }
  void write(const std::string& name, ArrowFile* table) const {
    fs::create_directories((log_ / name).parent_path());
    write_file(log_ / name, table->bytes());
  }
  static void add_poses(const std::vector<Rigid3d>& poses, ArrowFile* table) {
    std::vector<double> columns[7];
    for (const Rigid3d& pose : poses) {
      const Eigen::Quaterniond q(pose.linear());
      const double values[] = {q.w(),
                               q.x(),
                               q.y(),
                               q.z(),
                               pose.translation().x(),
                               pose.translation().y(),
                               pose.translation().z()};
      for (int k = 0; k < 7; ++k) columns[k].push_back(values[k]);
    }
    const char* const names[] = {"qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m"};
    for (int k = 0; k < 7; ++k) table->add(names[k], columns[k]);
  }
  void write_calibration(const Scene& scene) const {
    std::vector<std::string> names;
    std::vector<double> intrinsics[4];
    std::vector<std::uint16_t> sizes[2];
    std::vector<Rigid3d> places;
    for (const RigCamera& rig : scene.rig) {
      names.emplace_back(kCameras[names.size()]);
      const double values[] = {rig.camera.fx, rig.camera.fy, rig.camera.cx, rig.camera.cy};
      for (int k = 0; k < 4; ++k) intrinsics[k].push_back(values[k]);
      sizes[0].push_back(static_cast<std::uint16_t>(rig.camera.width));
      sizes[1].push_back(static_cast<std::uint16_t>(rig.camera.height));
      places.push_back(rig.body_from_sensor);
    }
    ArrowFile table;
    table.add("sensor_name", names);
    const char* const columns[] = {"fx_px", "fy_px", "cx_px", "cy_px"};
    for (int k = 0; k < 4; ++k) table.add(columns[k], intrinsics[k]);
    for (const char* name : {"k1", "k2", "k3"})
      table.add(name, std::vector<double>(names.size(), 0.0));
    table.add("width_px", sizes[0]);
    table.add("height_px", sizes[1]);
    write("calibration/intrinsics.feather", &table);
    for (const char* lidar : {"up_lidar", "down_lidar"}) {
      names.emplace_back(lidar);
      places.push_back(street_.lidars[0].body_from_lidar);
    }
    for (Rigid3d& place : places) place = Eigen::Translation3d(0, 0, -kAxleHeight_m) * place;
    ArrowFile sensors;
    sensors.add("sensor_name", names);
    add_poses(places, &sensors);
    write("calibration/egovehicle_SE3_sensor.feather", &sensors);
  }
  /// Points are compensated for the motion until the time of the frame, in floats of 16 bits.
  void write_sweep(const FrameFile& file, std::int64_t t_ns) const {
    const Rigid3d vehicle_from_world = world_from_vehicle(t_ns).inverse();
    std::vector<Eigen::half> xyz[3];
    std::vector<std::uint8_t> intensity, laser;
    std::vector<std::int32_t> offset_ns;
    for (const LidarPoint& point : street_.reader->read_lidar(file)) {
      const Eigen::Vector3d at =
          vehicle_from_world * world_from_vehicle(point.t_ns) *
          (point.in_body_m.cast<double>() - Eigen::Vector3d(0, 0, kAxleHeight_m));
      for (int k = 0; k < 3; ++k) xyz[k].emplace_back(static_cast<float>(at[k]));
      intensity.push_back(static_cast<std::uint8_t>(point.intensity / 257));
      laser.push_back(0);
      offset_ns.push_back(static_cast<std::int32_t>(point.t_ns - t_ns));
    }
    ArrowFile table;
    for (int k = 0; k < 3; ++k) table.add(std::string(1, "xyz"[k]), xyz[k]);
    table.add("intensity", intensity);
    table.add("laser_number", laser);
    table.add("offset_ns", offset_ns);
    write("sensors/lidar/" + std::to_string(t_ns) + ".feather", &table);
  }

  /// Returns by how much the motion over five frames differs from the truth, metres: the median.
  double error_of(const std::vector<FramePose>& frames) const {
    std::vector<double> errors_m;
    for (std::size_t f = 5; f < frames.size(); ++f) {
      const auto moved = [&](const auto& pose) {
        return (pose(frames[f - 5].t_ns).inverse() * pose(frames[f].t_ns)).translation();
      };
      const Eigen::Vector3d found = moved([&](std::int64_t t) { return pose_at(frames, t); }),
                            expected =
                                moved([&](std::int64_t t) { return pose_at(truth_.frames, t); });
      errors_m.push_back((found - expected).norm());
    }
    std::ranges::sort(errors_m);
    return errors_m.at(errors_m.size() / 2);
  }

  static constexpr const char* kCameras[] = {"ring_front_center", "ring_front_left"};
  const Recording street_ = open_recording(REDRIVE_SAMPLES "/street"),
                  truth_ = open_recording(REDRIVE_SAMPLES "/street", PoseSource::kGroundTruth);
  const fs::path log_ = folder_ / "7fab2350-7eaf-3b7e-a39d-6937a4c1bede";
};

TEST_F(EndToEndArgoverse2, IsAlignedTrainedAndExported) {
  const std::string log = log_.string(), aligned = (folder_ / "aligned").string();
  ProgramResult ended = redrive({"align", log, "--out", aligned});
  ASSERT_EQ(ended.exit_code, kExitOk) << ended.out << ended.err;
  const Recording recorded = open_recording(log_);
  EXPECT_EQ(recorded.format, "argoverse2");
  ASSERT_EQ(recorded.frames.size(), 16u);
  Recording corrected = recorded;
  apply_pose_files(read_pose_files(recorded, aligned), aligned, &corrected);
  const double before_m = error_of(recorded.frames), after_m = error_of(corrected.frames);
  EXPECT_GT(before_m, 0.03);
  EXPECT_LT(after_m, 0.01) << before_m << ended.out;

  const std::string run = (folder_ / "run").string();
  ended = redrive({"train", log, "--poses", aligned, "--out", run, "--downscale", "8",
                   "--max-seconds", "0", "--max-steps", "20", "--threads", "2"});
  ASSERT_EQ(ended.exit_code, kExitOk) << ended.err;
  ended = redrive({"export", run, "--to", "nuscenes", (folder_ / "nuscenes").string()});
  ASSERT_EQ(ended.exit_code, kExitOk) << ended.err;
  const Recording exported = open_recording(folder_ / "nuscenes");
  EXPECT_EQ(exported.frames.size(), 16u);
  EXPECT_LT(error_of(exported.frames), 0.01);
}

}  // namespace
}  // namespace redrive::testing

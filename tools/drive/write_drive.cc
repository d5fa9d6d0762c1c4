// SPDX-License-Identifier: Apache-2.0
#include "tools/drive/write_drive.h"

#include <cmath>
#include <cstdio>
#include <numbers>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/progress.h"
#include "redrive/base/rng.h"
#include "redrive/camera/mount.h"
#include "redrive/image/image_io.h"
#include "redrive/math/angles.h"
#include "redrive/recording/formats/calibration_json.h"
#include "redrive/recording/formats/egomotion_json.h"
#include "redrive/recording/lidar/las.h"
#include "redrive/recording/parse/rigid_json.h"
#include "tools/analytic/recording_writer.h"
#include "tools/drive/streams.h"

namespace redrive::drive {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr std::int64_t kFirstId = 1000, kFirstTime_ns = 5'000'000'000'000, kFrame_ns = 100'000'000;
static_assert(kFrame_ns * kFrameRate_hz == 1e9);
// length of the street before and after the drive
constexpr double kBehind_m = 120, kAhead_m = 350;
constexpr int kLidarSteps = 360;  // azimuths of a revolution, which takes 0.1 s
constexpr double kLidarRange_m = 100, kLidarNear_m = 1;

std::string file_name(const std::string& camera, int frame, const char* ending) {
  char text[80];
  std::snprintf(text, sizeof text, "%s_%07lld%s", camera.c_str(),
                static_cast<long long>(frame_id(frame)), ending);
  return text;
}

json calibration_file(const std::vector<CameraCalibration>& rig, bool lidar) {
  json sensors = json::object();
  for (const CameraCalibration& camera : rig) {
    json& entry = sensors[camera.name] = calibration_to_json(camera);
    const Eigen::Vector3d position = camera.body_from_sensor.translation();
    entry["pos_meter"] = {position.x(), position.y(), position.z()};
  }
  if (lidar)
    sensors["M_LIDAR_M"] = {{"sensor_type", "lidar"},
                            {"RT_body_from_sensor", rigid_to_json(body_from_lidar())}};
  return sensors;
}

/// Gain of an image: smooth over about ten frames, as an automatic exposure.
double gain_of(const DriveOptions& options, int camera, int frame) {
  if (options.exposure == 0) return 1;
  const std::uint64_t key = random_key(options.seed, kStreamExposure, std::uint64_t(camera));
  const auto knot = [&](int i) { return 2.0 * random_unit(key, std::uint64_t(i)) - 1; };
  constexpr int kKnot = 10;
  const double u = double(frame % kKnot) / kKnot, smooth = u * u * (3 - 2 * u),
               mixed = (1 - smooth) * knot(frame / kKnot) + smooth * knot(frame / kKnot + 1);
  // A uniform number on -1..1 has the variance 1/3, of which mixing leaves 26/35 on average.
  return std::exp2(options.exposure * mixed / std::sqrt(26.0 / 105));
}

/// Elevations of the beams from -25 to 15 degrees, denser at the horizon.
double elevation_rad(int beam, int beams) {
  const double u = beams > 1 ? 2.0 * beam / (beams - 1) - 1 : 0;
  return kRadiansPerDegree * (-3 + u * std::abs(u) * (u < 0 ? 22 : 18));
}

/// The revolution whose middle is the frame's time; points in the body at their own time.
std::vector<LidarRecord> revolution(const World& world, const Motion& motion,
                                    const DriveOptions& options, int frame) {
  const Rigid3d in_body = body_from_lidar();
  std::vector<LidarRecord> points;
  for (int step = 0; step < kLidarSteps; ++step) {
    const std::int64_t later_ns = kFrame_ns * (2 * step - kLidarSteps) / (2 * kLidarSteps);
    const Rigid3d pose = motion.world_from_body(time_s(frame) + 1e-9 * double(later_ns));
    const double azimuth = std::numbers::pi - 2 * std::numbers::pi * step / kLidarSteps;
    for (int beam = 0; beam < options.lidar_beams; ++beam) {
      const double elevation = elevation_rad(beam, options.lidar_beams);
      const Eigen::Vector3d ray =
          in_body.linear() * Eigen::Vector3d(std::cos(elevation) * std::cos(azimuth),
                                             std::cos(elevation) * std::sin(azimuth),
                                             std::sin(elevation));
      const World::Return found = world.range(pose * in_body.translation(), pose.linear() * ray);
      if (!(found.distance_m > kLidarNear_m && found.distance_m < kLidarRange_m)) continue;
      const std::uint64_t key = random_key(options.seed, kStreamLidar, std::uint64_t(frame));
      const auto drawn = 2 * std::uint64_t(step * options.lidar_beams + beam);
      const double noise =  // Box-Muller
          std::sqrt(-2 * std::log(1 - double(random_unit(key, drawn)))) *
          std::cos(2 * std::numbers::pi * random_unit(key, drawn + 1));
      points.push_back(
          {in_body.translation() + (found.distance_m + options.lidar_noise_m * noise) * ray,
           time_ns(frame) + later_ns, static_cast<float>(found.reflectance)});
    }
  }
  return points;
}

std::vector<int> novel_frames(const DriveOptions& options) {
  std::vector<int> frames;
  for (int f = options.novel_every / 2; options.novel_every > 0 && f < options.frames();
       f += options.novel_every)
    frames.push_back(f);
  return frames;
}

}  // namespace

int DriveOptions::frames() const { return static_cast<int>(std::lround(length_m / spacing_m)); }

double time_s(int frame) { return frame / kFrameRate_hz; }
std::int64_t time_ns(int frame) { return kFirstTime_ns + kFrame_ns * frame; }
std::int64_t frame_id(int frame) { return kFirstId + frame; }

Rigid3d body_from_lidar() { return Rigid3d(Eigen::Translation3d(1.1574, 0.0013, 1.6823)); }

World make_world(const DriveOptions& options) {
  return World(options.seed, -kBehind_m, options.length_m + kAhead_m, options.loop_m);
}

std::vector<CameraCalibration> true_rig(const DriveOptions& options) {
  const auto placed = [](double forward, double left, double up, double yaw, double pitch,
                         double roll) {
    return Mount{{forward, left, up}, yaw, pitch, roll}.body_from_sensor();
  };
  // Lenses and places as in tools/street, in proportion.
  std::vector<CameraCalibration> rig{
      {"F_MIDLONGRANGECAM_CL",
       "opencv_pinhole",
       {585.5, 500.5, 320.4, 175.1, -0.3007, 0.0842, 0.0020, 0.0006, 0},
       640,
       352,
       placed(1.93, 0.11, 1.25, -1.28, 0.49, -0.42)},
      {"F_MIDRANGECAM_C",
       "opencv_pinhole",
       {330, 330, 319.2, 176.4, -0.05, 0.01, 0.0004, -0.0003, 0},
       640,
       352,
       placed(1.9, -0.1, 1.3, 0.8, -1.1, 0.25)},
      {"M_FISHEYE_L",
       "mei",
       {288, 251, 320.6, 172.4, 0.034, -0.084, 0, 0, 0, 1.02},
       640,
       352,
       placed(2.1, 0.95, 1.05, 74, -16, 0.5)},
      {"M_FISHEYE_R",
       "mei",
       {288.4, 251.3, 321.3, 172.5, 0.027, -0.081, 0, 0, 0, 1.017},
       640,
       352,
       placed(2.1, -0.95, 1.05, -73, -16.5, -0.4)}};
  rig[2].time_offset_ns = -12'000'000;
  rig.resize(static_cast<std::size_t>(options.cameras));
  for (CameraCalibration& camera : rig) {
    for (const int k : {0, 1}) {
      camera.parameters[k] *= options.size;
      camera.parameters[2 + k] = (camera.parameters[2 + k] + 0.5) * options.size - 0.5;
    }
    camera.width = static_cast<int>(std::lround(camera.width * options.size));
    camera.height = static_cast<int>(std::lround(camera.height * options.size));
  }
  return rig;
}

std::vector<CameraCalibration> recorded_rig(const DriveOptions& options) {
  std::vector<CameraCalibration> rig = true_rig(options);
  for (CameraCalibration& camera : rig) camera.time_offset_ns = 0;
  constexpr double kYaw_rad = 0.15 * kRadiansPerDegree;
  rig[1].body_from_sensor.linear() =
      Eigen::AngleAxisd(kYaw_rad, Eigen::Vector3d::UnitZ()) * rig[1].body_from_sensor.linear();
  return rig;
}

const std::vector<NovelShift>& novel_shifts() {
  static const std::vector<NovelShift> shifts{{"left_1", {0, 1, 0}},
                                              {"left_2", {0, 2, 0}},
                                              {"right_1", {0, -1, 0}},
                                              {"forward_0.5", {0.5, 0, 0}}};
  return shifts;
}

void write_drive(const fs::path& folder, const DriveOptions& options, ThreadPool& pool) {
  const World world = make_world(options);
  const Motion motion(world.road(), options.spacing_m * kFrameRate_hz);
  const std::vector<CameraCalibration> rig = true_rig(options);
  const Rigid3d global_from_world = analytic::global_from_world();
  const bool lidar = options.lidar_beams > 0;

  std::vector<FramePose> exact, recorded;
  Rigid3d odometry = Rigid3d::Identity();
  for (int f = 0; f < options.frames(); ++f) {
    const Rigid3d pose = global_from_world * motion.world_from_body(time_s(f));
    exact.push_back({frame_id(f), time_ns(f), pose});
    const Vector6d error = pose_error(options.seed, f);
    Rigid3d moved = Rigid3d::Identity();
    moved.translation() = error.head<3>();
    moved.linear() =
        Eigen::AngleAxisd(error.tail<3>().norm(), error.tail<3>().normalized()).toRotationMatrix();
    // The odometry's lengths and, as much after 400 m, its turns are off.
    if (f == 0) {
      odometry = pose;
    } else {
      Rigid3d step = exact[f - 1].global_from_body.inverse(Eigen::Isometry) * pose;
      const double turn_rad = options.drift / 200 * step.translation().norm();
      step.translation() *= 1 + options.drift;
      odometry = odometry * step * Eigen::AngleAxisd(turn_rad, Eigen::Vector3d::UnitZ());
    }
    recorded.push_back({frame_id(f), time_ns(f), (options.drift != 0 ? odometry : pose) * moved});
  }
  const fs::path calibration = folder / "sensor/calibration", poses = folder / "sensor/gnssins",
                 images = folder / "sensor/camera", scans = folder / "dynamic/raw-revolutions";
  for (const fs::path& made : {calibration, poses, images, scans}) fs::create_directories(made);
  write_file(calibration / "calibration.json",
             calibration_file(recorded_rig(options), lidar).dump(1) + "\n");
  write_file(calibration / "calibration_true.json", calibration_file(rig, lidar).dump(1) + "\n");
  write_file(poses / "egomotion2.json", egomotion_to_json(recorded).dump(1) + "\n");
  write_file(poses / "egomotion2_true.json", egomotion_to_json(exact).dump(1) + "\n");

  std::vector<CameraRays> rays;
  for (const CameraCalibration& camera : rig) {
    rays.emplace_back(make_camera(camera));
    fs::create_directories(images / camera.name);
  }
  const int cameras = static_cast<int>(rig.size());
  const std::vector<int> chosen = novel_frames(options);
  Progress progress("casting rays", options.frames() * (cameras + lidar) +
                                        std::ssize(novel_shifts()) * std::ssize(chosen));
  pool.run(options.frames() * cameras, [&](int i) {
    const int frame = i / cameras, c = i % cameras;
    const CameraCalibration& camera = rig[c];
    const Rigid3d body =
        motion.world_from_body(time_s(frame) + 1e-9 * double(camera.time_offset_ns));
    write_image(images / camera.name / file_name(camera.name, frame, ".jpg"),
                draw(world, rays[c], body * camera.body_from_sensor, gain_of(options, c, frame)));
    progress.count();
  });
  if (lidar)
    pool.run(options.frames(), [&](int frame) {
      write_file(scans / file_name("frame", frame, ".las"),
                 make_las(revolution(world, motion, options, frame)));
      progress.count();
    });

  if (chosen.empty()) return;
  for (const NovelShift& novel : novel_shifts()) {
    const fs::path of_set = folder / "novel" / novel.name;
    fs::create_directories(of_set);
    json views = json::array();
    const auto shifted = [&](int frame) {
      Rigid3d pose = motion.world_from_body(time_s(frame));
      pose.translate(novel.shift_body_m);
      return pose;
    };
    for (const int frame : chosen)
      views.push_back({{"file", file_name(rig[0].name, frame, ".jpg")},
                       {"camera", rig[0].name},
                       {"frame_id", frame_id(frame)},
                       {"RT_ECEF_body", rigid_to_json(global_from_world * shifted(frame))},
                       {"shift_body_m",
                        {novel.shift_body_m.x(), novel.shift_body_m.y(), novel.shift_body_m.z()}}});
    write_file(
        of_set / "poses.json",
        json{{"calibration", calibration_file({rig[0]}, false)}, {"images", views}}.dump(1) + "\n");
    pool.run(static_cast<int>(chosen.size()), [&](int i) {
      const Rigid3d pose = shifted(chosen[i]) * rig[0].body_from_sensor;
      write_image(of_set / file_name(rig[0].name, chosen[i], ".jpg"),
                  draw(world, rays[0], pose, 1));
      write_png16(of_set / file_name(rig[0].name, chosen[i], "_depth.png"),
                  draw_depth(world, rays[0], pose));
      progress.count();
    });
  }
}

}  // namespace redrive::drive

// SPDX-License-Identifier: Apache-2.0
// The street recordings are complete and have the errors that tools/street/README.md states and no
// others. LiDAR, boxes, poses, cameras and depth agree with each other.
#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <vector>

#include <gtest/gtest.h>

#include "redrive/edit/traffic_edit.h"
#include "redrive/eval/novel_ground_truth.h"
#include "redrive/eval/novel_scans.h"
#include "redrive/image/image_io.h"
#include "redrive/math/angles.h"
#include "redrive/perception/masks.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/formats/recording_reader.h"
#include "redrive/recording/lidar/lost_rays.h"
#include "redrive/scene/lidar/lidar_returns.h"
#include "redrive/scene/load_views.h"
#include "redrive/train/run.h"

namespace redrive {
namespace {

const std::filesystem::path kStreet = REDRIVE_SAMPLES "/street",
                            kTraffic = REDRIVE_SAMPLES "/street_traffic",
                            kRolling = REDRIVE_SAMPLES "/street_rolling";

TEST(Street, IsComplete) {
  const Recording street = open_recording(kStreet);
  EXPECT_TRUE(street.findings.empty());
  ASSERT_EQ(street.frames.size(), 48u);
  ASSERT_EQ(street.cameras.size(), 4u);
  for (const RecordedCamera& camera : street.cameras) {
    EXPECT_EQ(camera.images.size(), 48u) << camera.calibration.name;
    EXPECT_EQ(camera.calibration.model,
              camera.calibration.name.starts_with("F_") ? "opencv_pinhole" : "mei");
    EXPECT_NE(camera.calibration.fx(), camera.calibration.fy());
  }
  EXPECT_EQ(street.lidar_files.size(), 48u);
  EXPECT_EQ(street.novel.size(), 12u);
  EXPECT_GT(street.frames[0].global_from_body.translation().norm(), 6.3e6);
  EXPECT_NEAR(street.frames[1].t_ns - street.frames[0].t_ns, 1e9 / 15, 1000);
}

// The noise is scaled to its RMS over all frames. The tolerance of 1e-6 covers rounding of ECEF in
// double (1e-9 m) and of a rotation's logarithm.
TEST(Street, HasTheStatedErrors) {
  const Recording recording = open_recording(kStreet),
                  ground_truth = open_recording(kStreet, PoseSource::kGroundTruth);
  ASSERT_EQ(recording.frames.size(), ground_truth.frames.size());
  Eigen::Array3d squares_m = Eigen::Array3d::Zero(), squares_deg = Eigen::Array3d::Zero();
  for (std::size_t i = 0; i < recording.frames.size(); ++i) {
    const Rigid3d error = ground_truth.frames[i].global_from_body.inverse(Eigen::Isometry) *
                          recording.frames[i].global_from_body;
    const Eigen::AngleAxisd turn(error.linear());
    squares_m += error.translation().array().square();
    squares_deg += (turn.axis().array() * turn.angle() * kDegreesPerRadian).square();
  }
  const double frames = static_cast<double>(recording.frames.size());
  EXPECT_TRUE((squares_m / frames).sqrt().isApprox(Eigen::Array3d(0.06, 0.06, 0.03), 1e-6));
  EXPECT_TRUE((squares_deg / frames).sqrt().isApprox(Eigen::Array3d::Constant(0.12), 1e-6));
  for (std::size_t c = 0; c < recording.cameras.size(); ++c) {
    const CameraCalibration &a = recording.cameras[c].calibration,
                            &b = ground_truth.cameras[c].calibration;
    const Eigen::Matrix3d turn =
        a.body_from_sensor.linear() * b.body_from_sensor.linear().transpose();
    const double yaw_deg = Eigen::AngleAxisd(turn).angle() * kDegreesPerRadian;
    EXPECT_NEAR(yaw_deg, a.name == "F_MIDRANGECAM_C" ? 0.15 : 0, 1e-6) << a.name;
    EXPECT_EQ(a.time_offset_ns, 0);
    EXPECT_EQ(b.time_offset_ns, a.name == "M_FISHEYE_L" ? -12'000'000 : 0);
    EXPECT_EQ(a.parameters, b.parameters);
  }
}

/// An untrained run of the street: its scene is needed to read the ground ground_truth of novel
/// views.
Run true_run(const std::filesystem::path& root) {
  Run run;
  run.recording = open_recording(root, PoseSource::kGroundTruth);
  run.scene = make_scene(run.recording, {});
  return run;
}

TEST(Street, PosesOfNovelViewsAgreeWithTheirShifts) {
  const redrive::Run run = true_run(kStreet);
  for (const NovelSet& set : run.recording.novel) {
    const ViewRequests poses = read_view_requests(set.poses_file);
    EXPECT_EQ(poses.views.size(), 6u) << set.name;
    EXPECT_EQ(NovelGroundTruth(run, set, {}).size(), set.name == "up_1" ? 0u : 6u) << set.name;
    for (const RequestedView& view : poses.views) {
      ASSERT_TRUE(view.global_from_body.has_value());
      const auto frame = std::find_if(run.recording.frames.begin(), run.recording.frames.end(),
                                      [&](const FramePose& f) { return f.id == view.frame_id; });
      ASSERT_NE(frame, run.recording.frames.end());
      const Rigid3d motion =
          frame->global_from_body.inverse(Eigen::Isometry) * *view.global_from_body;
      const double rotation_deg = Eigen::AngleAxisd(motion.linear()).angle() * kDegreesPerRadian;
      EXPECT_NEAR(rotation_deg, set.name == "yaw_15" ? 15 : 0, 1e-5) << set.name;
      if (view.shift_body_m) {
        EXPECT_LT((motion.translation() - *view.shift_body_m).norm(), 1e-6) << set.name;
      }
    }
  }
}

/// Adds the error of a point's distance from the depth of its pixel, as a part of the depth;
/// nothing where the image has none.
void add_depth_error(const GroundTruthView& view, const Eigen::Vector3d& in_camera,
                     std::vector<double>* errors) {
  const auto at = view.camera.project(in_camera);
  if (!at) return;
  const long x = std::lround(at->x()), y = std::lround(at->y());
  if (x < 0 || y < 0 || x >= view.camera.width || y >= view.camera.height) return;
  const float depth_m = view.depth_m[static_cast<std::size_t>(y) * view.camera.width + x];
  if (depth_m > 0) errors->push_back(std::abs(in_camera.norm() - depth_m) / depth_m);
}

// Projects LiDAR points at their own time into images from half a metre aside. The depth there is
// the point's distance except at edges, at points hidden from one of the two, and within 2 cm of
// noise and half a pixel. The latter is largest on the road, where a pixel spans distance / (camera
// height * focal length) of the distance: 10 m / (1.25 m * 375) = 2 %, half of it to either side.
TEST(Street, LidarAgreesWithDepth) {
  const redrive::Run run = true_run(kStreet);
  const auto set = std::find_if(run.recording.novel.begin(), run.recording.novel.end(),
                                [](const NovelSet& s) { return s.name == "left_0.5"; });
  ASSERT_NE(set, run.recording.novel.end());
  const NovelGroundTruth ground_truth(run, *set, {});
  const ViewRequests poses = read_view_requests(set->poses_file);
  const Rigid3d world_from_global = run.scene.global_from_world.inverse(Eigen::Isometry);
  for (std::size_t i = 0; i < ground_truth.size(); ++i) {
    const GroundTruthView view = ground_truth.load(i);
    const Rigid3d camera_from_world = view.world_from_camera.inverse(Eigen::Isometry);
    const auto file =
        std::find_if(run.recording.lidar_files.begin(), run.recording.lidar_files.end(),
                     [&](const FrameFile& f) { return f.frame_id == poses.views[i].frame_id; });
    ASSERT_NE(file, run.recording.lidar_files.end());
    std::vector<double> errors;
    for (const LidarPoint& point : run.recording.reader->read_lidar(*file)) {
      const Eigen::Vector3d world = world_from_global * pose_at(run.recording.frames, point.t_ns) *
                                    point.in_body_m.cast<double>();
      const Eigen::Vector3d in_camera = camera_from_world * world;
      add_depth_error(view, in_camera, &errors);
    }
    // 20 packets in view, the 10 channels of each that hit the road, some of them lost
    ASSERT_GE(errors.size(), 150u) << view.name;
    std::nth_element(errors.begin(), errors.begin() + errors.size() / 2, errors.end());
    EXPECT_LT(errors[errors.size() / 2], 0.01) << view.name;
  }
}

constexpr std::size_t kRays = 16 * 120;  // a revolution

/// Expects that lost rays follow from the returns: each of the rays is one of them.
void expect_all_rays(const std::vector<LidarPoint>& points, const Recording& recording) {
  const std::vector<LidarPoint> scans[] = {points};
  std::string why;
  const auto structure = estimate_structure(scans, recording.lidars[0].body_from_lidar, &why);
  ASSERT_TRUE(structure) << why;
  EXPECT_EQ(structure->sensor.beams.size(), 16u);
  EXPECT_EQ(structure->sensor.azimuth_steps, 120);
  const LostRays lost = lost_rays(points, recording.lidars[0].body_from_lidar, *structure, &why);
  EXPECT_EQ(points.size() + lost.size(), kRays) << why;
  EXPECT_NEAR(static_cast<double>(lost.size()), 0.1 * kRays, 0.06 * kRays);
}

TEST(Street, LostRaysFollowFromTheRecordedScans) {
  for (const std::filesystem::path& root : {kStreet, kTraffic}) {
    const Recording recording = open_recording(root);
    for (const FrameFile& file : recording.lidar_files) {
      SCOPED_TRACE(file.path);
      expect_all_rays(recording.reader->read_lidar(file), recording);
    }
  }
}

// As above for the recorded scans: what the sensor measures aside is what the camera sees there.
TEST(Street, ScansOfNovelViewsAgreeWithDepth) {
  const redrive::Run run = true_run(kStreet);
  std::vector<Finding> findings;
  const std::vector<NovelScans> sets = novel_scans(run, &findings);
  EXPECT_TRUE(findings.empty());
  ASSERT_EQ(sets.size(), 5u);
  for (const NovelScans& set : sets) {
    ASSERT_EQ(set.files.size(), 6u) << set.name;
    const auto views = std::ranges::find(run.recording.novel, set.name, &NovelSet::name);
    const NovelGroundTruth ground_truth(run, *views, {});
    for (std::size_t i = 0; i < set.files.size(); ++i) {
      SCOPED_TRACE(set.files[i].path);
      const std::vector<LidarPoint> points = run.recording.reader->read_lidar(set.files[i]);
      expect_all_rays(points, run.recording);
      if (ground_truth.size() == 0) continue;
      const GroundTruthView view = ground_truth.load(i);
      const Rigid3d camera_from_body =
          ground_truth.camera(i).body_from_sensor.inverse(Eigen::Isometry);
      std::vector<double> errors;
      for (const LidarPoint& point : points) {
        EXPECT_LE(point.intensity, 255);
        const Eigen::Vector3d in_camera = camera_from_body * point.in_body_m.cast<double>();
        add_depth_error(view, in_camera, &errors);
      }
      ASSERT_GE(errors.size(), 150u);
      std::nth_element(errors.begin(), errors.begin() + std::ssize(errors) / 2, errors.end());
      EXPECT_LT(errors[errors.size() / 2], 0.015);  // 2 cm of noise, and cars 2 m to the right
    }
  }
}

// 120 packets in 0.1 s, files 1/15 s apart. Every packet has points: its lowest channels hit the
// road.
LidarReturns returns_of(const redrive::Run& run) {
  ThreadPool pool(2);
  return load_lidar_returns(run.recording, run.scene, read_moving_objects(run.recording, run.scene),
                            pool);
}

// Projects returns of all revolutions into images of single frames: static points agree with the
// image's depth, or are hidden, or (at an edge, by noise) are a little nearer.
TEST(Street, ReturnsOfAllRevolutionsAreFixedInTheWorld) {
  const redrive::Run run = true_run(kStreet);
  const LidarReturns returns = returns_of(run);
  EXPECT_GT(returns.n, 48u * 500);
  EXPECT_NEAR(
      static_cast<double>(returns.repeated) / static_cast<double>(returns.n + returns.repeated),
      1.0 / 3, 0.05);
  EXPECT_EQ(returns.on_moving, 0u);
  const auto set = std::find_if(run.recording.novel.begin(), run.recording.novel.end(),
                                [](const NovelSet& s) { return s.name == "right_1"; });
  const NovelGroundTruth ground_truth(run, *set, {});
  int agree = 0, hidden = 0, nearer = 0;
  for (std::size_t i = 0; i < ground_truth.size(); ++i) {
    const GroundTruthView view = ground_truth.load(i);
    const Rigid3d camera_from_world = view.world_from_camera.inverse(Eigen::Isometry);
    LidarPoses poses(run.scene, returns);
    for (std::size_t k = 0; k < returns.n; ++k) {
      const Eigen::Vector3d in_camera = camera_from_world * poses.in_world(k);
      const auto at = view.camera.project(in_camera);
      if (!at) continue;
      const long x = std::lround(at->x()), y = std::lround(at->y());
      if (x < 0 || y < 0 || x >= view.camera.width || y >= view.camera.height) continue;
      const double depth_m = view.depth_m[static_cast<std::size_t>(y) * view.camera.width + x];
      if (depth_m <= 0) continue;
      const double off = (in_camera.norm() - depth_m) / depth_m;
      ++(off > 0.03 ? hidden : off < -0.03 ? nearer : agree);
    }
  }
  EXPECT_GT(agree, 10000);
  EXPECT_LT(nearer, 0.05 * agree);
}

TEST(Street, RevolutionsOverlapByAThird) {
  const Recording street = open_recording(kStreet);
  std::set<std::int64_t> before;
  for (const FrameFile& file : street.lidar_files) {
    std::set<std::int64_t> packets;
    for (const LidarPoint& point : street.reader->read_lidar(file)) packets.insert(point.t_ns);
    EXPECT_EQ(packets.size(), 120u) << file.path;
    const auto shared = std::count_if(packets.begin(), packets.end(),
                                      [&](std::int64_t t_ns) { return before.contains(t_ns); });
    EXPECT_EQ(shared, before.empty() ? 0 : 40) << file.path;
    before = std::move(packets);
  }
}

TEST(StreetRolling, HasTheFrontCamerasOfTheFirstHalfOfTheStreet) {
  const Recording rolling = open_recording(kRolling, PoseSource::kGroundTruth),
                  street = open_recording(kStreet, PoseSource::kGroundTruth);
  EXPECT_TRUE(rolling.findings.empty());
  ASSERT_EQ(rolling.frames.size(), 24u);
  ASSERT_EQ(rolling.cameras.size(), 2u);
  for (const RecordedCamera& camera : rolling.cameras) EXPECT_EQ(camera.images.size(), 24u);
  for (std::size_t i = 0; i < rolling.frames.size(); ++i)
    EXPECT_EQ(rolling.frames[i].global_from_body.matrix(),
              street.frames[i].global_from_body.matrix())
        << i;
}

// One of the three is parked: its relative velocity is the ego vehicle's, reversed. The velocity
// between poses 1/15 s apart differs from that at the first of them by at most half of 2.1 m/s^2 /
// 15 (tools/street/trajectory.py). The LiDAR sees every vehicle within 40 m (5 cm: its range noise,
// 2.5 sigma), and nothing in the air above it.
TEST(StreetTraffic, BoxesContainTheirVehicles) {
  const Recording traffic = open_recording(kTraffic, PoseSource::kGroundTruth);
  EXPECT_EQ(traffic.cameras.size(), 2u);
  EXPECT_EQ(traffic.frames.size(), 24u);
  ASSERT_EQ(traffic.box_files.size(), 24u);
  int parked = 0;
  for (const FrameFile& file : traffic.box_files) {
    const std::vector<Box> boxes = traffic.reader->read_boxes(file);
    ASSERT_EQ(boxes.size(), 3u);
    const auto frame = std::find_if(traffic.frames.begin(), traffic.frames.end(),
                                    [&](const FramePose& f) { return f.id == file.frame_id; });
    ASSERT_NE(frame, traffic.frames.end());
    const Rigid3d later = frame->global_from_body.inverse(Eigen::Isometry) *
                          pose_at(traffic.frames, frame->t_ns + 1'000'000);
    const auto cloud =
        std::find_if(traffic.lidar_files.begin(), traffic.lidar_files.end(),
                     [&](const FrameFile& f) { return f.frame_id == file.frame_id; });
    const std::vector<LidarPoint> points = traffic.reader->read_lidar(*cloud);
    for (const Box& box : boxes) {
      EXPECT_EQ(box.t_ns, frame->t_ns);
      parked += (box.velocity_in_body_m_per_s + later.translation() / 1e-3).norm() < 0.07;
      const Rigid3d box_from_body = box.body_from_box.inverse(Eigen::Isometry);
      int inside = 0, above = 0;
      for (const LidarPoint& point : points) {
        const Eigen::Vector3d at_box_time =
            point.in_body_m.cast<double>() +
            1e-9 * static_cast<double>(box.t_ns - point.t_ns) * box.velocity_in_body_m_per_s;
        const Eigen::Array3d in_box = box_from_body * at_box_time,
                             half = box.size_m.array() / 2 + 0.05;
        inside += (in_box.abs() <= half).all();
        above += ((in_box - Eigen::Array3d(0, 0, 2 * half.z())).abs() <= half).all();
      }
      if (box.body_from_box.translation().norm() < 40) {
        EXPECT_GE(inside, 1) << file.path;
      }
      EXPECT_EQ(above, 0) << file.path;
    }
  }
  EXPECT_EQ(parked, 24);
}

// samples/street is the same drive without the three vehicles: a ray of the same packet that is
// shorter here hits one of them. The remaining returns of such rays are on the parked one.
TEST(StreetTraffic, DropsReturnsOfMovingVehicles) {
  const redrive::Run run = true_run(kTraffic), empty = true_run(kStreet);
  const LidarReturns with = returns_of(run), without = returns_of(empty);
  EXPECT_GT(with.on_moving, 100u);
  std::multimap<std::int64_t, std::size_t> by_time;
  for (std::size_t i = 0; i < without.n; ++i) by_time.emplace(without.t_ns[i], i);
  int same = 0, earlier_on_parked = 0, earlier_elsewhere = 0;
  const std::vector<Box> boxes = run.recording.reader->read_boxes(run.recording.box_files[0]);
  const Rigid3d world_from_body = run.scene.global_from_world.inverse(Eigen::Isometry) *
                                  pose_at(run.recording.frames, boxes[0].t_ns);
  ASSERT_EQ(boxes[0].object_id, 1);  // the parked one
  const Rigid3d box_from_world =
      (world_from_body * boxes[0].body_from_box).inverse(Eigen::Isometry);
  LidarPoses poses(run.scene, with);
  for (std::size_t i = 0; i < with.n; ++i) {
    const auto [begin, end] = by_time.equal_range(with.t_ns[i]);
    const Eigen::Vector3d direction = with.direction_in_sensor(i);
    for (auto it = begin; it != end; ++it) {
      // Half of the angle between two channels or packets, and the rotation of near rays by the
      // files' rounding to millimetres.
      if ((without.direction_in_sensor(it->second) - direction).norm() > 2e-3) continue;
      if (std::abs(with.range_m[i] - without.range_m[it->second]) < 0.3) {
        ++same;
      } else if (with.range_m[i] < without.range_m[it->second]) {
        const Eigen::Vector3d in_box = box_from_world * poses.in_world(i);
        ++((in_box.cwiseAbs().array() <= boxes[0].size_m.array() / 2 + 0.1).all()
               ? earlier_on_parked
               : earlier_elsewhere);
      }
    }
  }
  EXPECT_GT(same, 5000);
  EXPECT_GT(earlier_on_parked, 20);
  EXPECT_LT(earlier_elsewhere, 10);
}

double share_left_out(const Mask& mask, int first_row, int last_row) {
  const auto begin = mask.used.begin() + static_cast<std::ptrdiff_t>(first_row) * mask.width,
             end = mask.used.begin() + static_cast<std::ptrdiff_t>(last_row) * mask.width;
  return static_cast<double>(std::count(begin, end, 0)) / static_cast<double>(end - begin);
}

// The bonnet is in the images of one camera, below row 203 of 256, and covers 11.5 % of them
// (counted by hand).
TEST(Street, MasksCoverOnlyTheBonnet) {
  for (const std::filesystem::path& root : {kStreet, kTraffic, kRolling}) {
    SCOPED_TRACE(root);
    const Recording recording = open_recording(root);
    const Scene scene = make_scene(recording, {});
    ThreadPool pool(2);
    const std::vector<Image8> images = load_views(scene, pool);
    const std::vector<Mask> masks = static_masks(scene, images, {}, pool, true);
    for (std::size_t c = 0; c < masks.size(); ++c) {
      const Mask& mask = masks[c];
      SCOPED_TRACE(scene.rig[c].name);
      if (scene.rig[c].name == "F_MIDRANGECAM_C") {
        EXPECT_EQ(share_left_out(mask, 0, 195), 0);
        EXPECT_NEAR(share_left_out(mask, 0, mask.height), 0.115, 0.02);
        EXPECT_EQ(mask.used[std::size_t{230} * mask.width + 208], 0);
      } else if (scene.rig[c].name.starts_with("F_")) {
        EXPECT_EQ(mask.left_out(), 0u);
      } else {
        // The corners outside the image circle are 12.1 % of an image (redrive inspect).
        EXPECT_NEAR(share_left_out(mask, 0, mask.height), 0.12, 0.01);
        EXPECT_EQ(mask.used[std::size_t(mask.height / 2) * mask.width + mask.width / 2], 1);
      }
    }
  }
}

// Edited images differ from the recorded ones where their masks say so; elsewhere by JPEG and by
// the noise of indirect light.
TEST(StreetTraffic, EditsChangeTheirImagesWhereTheMasksSay) {
  constexpr const char* kCamera = "F_MIDLONGRANGECAM_CL";
  for (const char* name : {"removed", "shifted", "turned"}) {
    const std::filesystem::path folder = kTraffic / "edited" / name;
    const TrafficEdit edit = read_traffic_edit(folder / "edit.json");
    ASSERT_EQ(edit.actors.size(), 1u) << name;
    const ActorChange& change = edit.actors.at(2);
    EXPECT_EQ(change.remove, std::string(name) == "removed");
    EXPECT_EQ(change.shift_m[1], std::string(name) == "shifted" ? 2 : 0);
    EXPECT_EQ(change.turn_deg, std::string(name) == "turned" ? 20 : 0);
    for (const int id : {1000, 1006, 1012, 1018}) {
      const std::string stem = std::string(kCamera) + "_000" + std::to_string(id);
      const Image8 edited = read_image(folder / (stem + ".jpg")),
                   changed = read_image(folder / (stem + "_changed.png")),
                   recorded = read_image(kTraffic / "sensor/camera" / kCamera / (stem + ".jpg"));
      ASSERT_EQ(edited.rgb.size(), recorded.rgb.size());
      ASSERT_EQ(edited.rgb.size(), changed.rgb.size());
      double inside = 0, outside = 0, share = 0;
      for (std::size_t i = 0; i < edited.rgb.size(); ++i) {
        const int difference = std::abs(int(edited.rgb[i]) - int(recorded.rgb[i]));
        (changed.rgb[i] > 127 ? inside : outside) += difference;
        share += changed.rgb[i] > 127;
      }
      const auto n = static_cast<double>(edited.rgb.size());
      EXPECT_GT(share / n, 0.02) << stem;
      EXPECT_LT(share / n, 0.2) << stem;
      EXPECT_GT(inside / share, 10) << stem;
      EXPECT_LT(outside / (n - share), 1) << stem;
    }
  }
}

}  // namespace
}  // namespace redrive

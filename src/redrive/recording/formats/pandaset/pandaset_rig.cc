// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/pandaset/pandaset_rig.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/math/angles.h"
#include "redrive/math/so3.h"
#include "redrive/math/upper_median.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/formats/calibration_fields.h"
#include "redrive/recording/formats/pandaset/pandaset_scan.h"
#include "redrive/recording/parse/json_numbers.h"
#include "redrive/recording/parse/rigid_json.h"

namespace redrive::pandaset {
namespace {

// Height of the rear axle over the road and place of the LiDAR: from scans and poses of sequence
// 001, in which the LiDAR repeats to 2 mm.
constexpr double kAxleHeight_m = 0.27;

struct Extrinsics {
  const char* camera;
  double rotation[4];     ///< w, x, y, z
  double translation[3];  ///< metres
};
/// Camera from Pandar64: pandaset-devkit, docs/static_extrinsic_calibration.yaml.
constexpr std::array<Extrinsics, 6> kCameras = {{
    {"back_camera",
     {0.713789231075861, 0.7003585531940812, -0.001595758695393934, -0.0005330311533742299},
     {-0.0004217634029916384, -0.21683144949675118, -1.0553445472201475}},
    {"front_camera",
     {0.016213200031258722, 0.0030578899383849464, 0.7114721800418571, -0.7025205466606356},
     {0.0002585796504896516, -0.03907777167811011, -0.0440125762408362}},
    {"front_left_camera",
     {0.33540022607039827, 0.3277491469609924, -0.6283486651480494, 0.6206973014480826},
     {-0.25842240863267835, -0.3070654284505582, -0.9244245686318884}},
    {"front_right_camera",
     {0.3537633879725252, 0.34931795852655334, 0.6120314641083645, -0.6150170047424814},
     {0.2546935700219631, -0.24929449717803095, -0.8686597280810242}},
    {"left_camera",
     {0.5050391917998245, 0.49253073152800625, -0.4989265501075421, 0.503409565706149},
     {0.23864835336611942, -0.2801448284013492, -0.5376795959387791}},
    {"right_camera",
     {0.5087448402081216, 0.4947520981649951, 0.4977829953071897, -0.49860920419297333},
     {-0.23097163411257893, -0.30843497058841024, -0.6850441215571058}},
}};

/// Axes with x forward and y left in ones with y forward and x right.
Eigen::Matrix3d quarter_turn() {
  return Eigen::AngleAxisd(M_PI / 2, Eigen::Vector3d::UnitZ()).toRotationMatrix();
}

Rigid3d rigid(const Eigen::Quaterniond& rotation, const Eigen::Vector3d& translation) {
  Rigid3d pose = Rigid3d::Identity();
  pose.linear() = rotation.normalized().toRotationMatrix();
  pose.translation() = translation;
  return pose;
}

Rigid3d parse_pose(const JsonField& field) {
  const JsonField position = field.at("position"), heading = field.at("heading");
  Eigen::Vector3d translation;
  for (int k = 0; k < 3; ++k)
    translation[k] = number_within(position.at(std::string_view("xyz").substr(std::size_t(k), 1)),
                                   -kMaxCoordinate_m, kMaxCoordinate_m, "metres, at most 1e7");
  const Eigen::Quaterniond rotation(heading.at("w").number(), heading.at("x").number(),
                                    heading.at("y").number(), heading.at("z").number());
  if (!is_rotation(rotation)) heading.fail("must be a quaternion of a rotation");
  return rigid(rotation, translation);
}

}  // namespace

std::vector<std::optional<Rigid3d>> parse_poses(std::string_view text,
                                                const std::filesystem::path& file,
                                                const DamagedList* damaged) {
  const nlohmann::json document = parse_json(text, file);
  const JsonField root(document, file);
  if (!document.is_array()) root.fail("must be a list of poses");
  std::vector<std::optional<Rigid3d>> poses(root.size());
  for (std::size_t i = 0; i < poses.size(); ++i)
    parse_record(damaged, static_cast<std::int64_t>(i), [&] { poses[i] = parse_pose(root.at(i)); });
  return poses;
}

Times parse_times(std::string_view text, const std::filesystem::path& file,
                  const DamagedList* damaged) {
  const nlohmann::json document = parse_json(text, file);
  const JsonField root(document, file);
  if (!document.is_array()) root.fail("must be a list of times");
  Times times_ns(root.size());
  std::int64_t before_ns = -1;
  for (std::size_t i = 0; i < times_ns.size(); ++i)
    parse_record(damaged, static_cast<std::int64_t>(i), [&] {
      const JsonField field = root.at(i);
      const std::int64_t t_ns =
          nanoseconds(number_within(field, 0, kMaxTime_s, "seconds, at least 0"));
      if (t_ns <= before_ns) field.fail("must be later than the time before it");
      times_ns[i] = before_ns = t_ns;
    });
  return times_ns;
}

void parse_intrinsics(std::string_view text, const std::filesystem::path& file,
                      CameraCalibration* camera) {
  const nlohmann::json document = parse_json(text, file);
  const JsonField root(document, file);
  camera->model = "opencv_pinhole";
  camera->parameters = {focal_length_from_json(root.at("fx")),
                        focal_length_from_json(root.at("fy")),
                        principal_point_from_json(root.at("cx"), camera->width),
                        principal_point_from_json(root.at("cy"), camera->height),
                        0,
                        0,
                        0,
                        0,
                        0};
}

std::vector<FramePose> posed_times(const std::vector<std::optional<Rigid3d>>& poses,
                                   const Times& times_ns) {
  std::vector<FramePose> posed;
  for (std::size_t i = 0; i < std::min(poses.size(), times_ns.size()); ++i)
    if (poses[i] && times_ns[i])
      posed.push_back({static_cast<std::int64_t>(i), *times_ns[i], *poses[i]});
  return posed;
}

Rigid3d body_of_car(const Rigid3d& world_from_car) {
  Rigid3d car_from_body = Rigid3d::Identity();
  car_from_body.linear() = quarter_turn();
  car_from_body.translation().z() = -kAxleHeight_m;
  return world_from_car * car_from_body;
}

std::vector<std::string> camera_names() {
  std::vector<std::string> names;
  for (const Extrinsics& camera : kCameras) names.emplace_back(camera.camera);
  return names;
}

std::optional<Rigid3d> camera_from_lidar(const std::string& camera) {
  const auto found = std::ranges::find(kCameras, camera, &Extrinsics::camera);
  if (found == kCameras.end()) return std::nullopt;
  const auto& [w, x, y, z] = found->rotation;
  Rigid3d camera_from_lidar = rigid({w, x, y, z}, Eigen::Vector3d(found->translation));
  camera_from_lidar.linear() *= quarter_turn().transpose();  // the Pandar64's -y looks ahead
  return camera_from_lidar;
}

Rigid3d pandar64_from_gt() {
  // front_gt in docs/static_extrinsic_calibration.yaml of the devkit.
  const Rigid3d published =
      rigid({0.021475754959146356, -0.002060907279494794, 0.01134678181520767, 0.9997028534282365},
            {-0.000451117754, -0.605646431446, -0.301525235176});
  return Rigid3d(quarter_turn()) * published * Rigid3d(quarter_turn());
}

Rigid3d usual_body_from_lidar() {
  const Eigen::Quaterniond rotation = Eigen::AngleAxisd(0.0332, Eigen::Vector3d::UnitZ()) *
                                      Eigen::AngleAxisd(-0.0157, Eigen::Vector3d::UnitY());
  return rigid(rotation, {0.811, 0, 1.855 + kAxleHeight_m});
}

Rigid3d body_from_camera(const std::vector<FramePose>& body, const std::vector<FramePose>& camera,
                         const std::filesystem::path& file, const DamagedList& damaged) {
  constexpr double kMost_m = 0.3, kMost_rad = 2 * kRadiansPerDegree;
  std::vector<Rigid3d> each;
  for (const FramePose& image : camera)
    each.push_back(pose_at(body, image.t_ns).inverse(Eigen::Isometry) * image.global_from_body);
  // Rotations have a median as vectors from a rotation near it, which three passes find.
  const auto turn = [](const Rigid3d& a, const Rigid3d& b) -> Eigen::Vector3d {
    return so3_log(a.linear().transpose() * b.linear());
  };
  const auto median = [&](const auto& component) {
    Eigen::Vector3d middle;
    for (int k = 0; k < 3; ++k) {
      std::vector<double> values;
      for (const Rigid3d& one : each) values.push_back(component(one)[k]);
      middle[k] = upper_median(std::move(values));
    }
    return middle;
  };
  Rigid3d result = each[each.size() / 2];
  for (int pass = 0; pass < 3; ++pass)
    result.linear() =
        result.linear() * so3_exp(median([&](const Rigid3d& one) { return turn(result, one); }));
  result.translation() =
      median([](const Rigid3d& one) -> Eigen::Vector3d { return one.translation(); });
  for (std::size_t i = 0; i < each.size(); ++i) {
    const double far_m = (each[i].translation() - result.translation()).norm(),
                 far_rad = turn(result, each[i]).norm();
    parse_record(&damaged, camera[i].id, [&] {
      if (far_m > kMost_m || far_rad > kMost_rad)
        throw InputError(file, "[" + std::to_string(camera[i].id) + "]",
                         std::to_string(far_m) + " m and " +
                             std::to_string(far_rad * kDegreesPerRadian) + " degrees",
                         "so far from the camera's place on the car in the other frames");
    });
  }
  return result;
}

}  // namespace redrive::pandaset

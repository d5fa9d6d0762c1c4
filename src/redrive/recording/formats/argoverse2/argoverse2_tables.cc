// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/argoverse2/argoverse2_tables.h"

#include <algorithm>
#include <cmath>

#include "redrive/base/error.h"
#include "redrive/recording/formats/calibration_fields.h"
#include "redrive/recording/parse/rigid_json.h"

namespace redrive::argoverse2 {
namespace {

constexpr double kAxleHeight_m = 0.33;  // argoverse-api, issue 286; scans of a log have 0.325
constexpr std::int64_t kApart_ns = 1'000'000;

std::string row_of(const std::string& column, std::size_t i) {
  return column + " of row " + std::to_string(i);
}

}  // namespace

PoseColumns::PoseColumns(const ArrowTable& table, const std::filesystem::path& file) : file_(file) {
  for (std::size_t k = 0; k < 7; ++k) columns_[k] = table.numbers(kPoseColumns[k]);
}

Rigid3d PoseColumns::at(std::size_t i) const {
  for (std::size_t k = 0; k < 7; ++k)
    if (!(std::abs(columns_[k][i]) <= kMaxCoordinate_m))
      throw InputError(file_, row_of(kPoseColumns[k], i), std::to_string(columns_[k][i]),
                       k < 4 ? "must be a number" : "metres, at most 1e7");
  const Eigen::Quaterniond rotation(columns_[0][i], columns_[1][i], columns_[2][i], columns_[3][i]);
  if (!is_rotation(rotation))
    throw InputError(file_, row_of("qw, qx, qy, qz", i), std::to_string(rotation.norm()) + " long",
                     "must be a quaternion of a rotation");
  Rigid3d pose = Rigid3d::Identity();
  pose.linear() = rotation.normalized().toRotationMatrix();
  pose.translation() = Eigen::Vector3d(columns_[4][i], columns_[5][i], columns_[6][i]);
  return pose;
}

Rigid3d body_from_vehicle() { return Rigid3d(Eigen::Translation3d(0, 0, kAxleHeight_m)); }

std::vector<FramePose> parse_poses(std::string_view feather, const std::filesystem::path& file,
                                   const DamagedList* damaged) {
  const ArrowTable table(feather, file);
  const std::vector<std::int64_t> times_ns = table.integers("timestamp_ns");
  const PoseColumns columns(table, file);
  const Rigid3d vehicle_from_body = body_from_vehicle().inverse(Eigen::Isometry);
  std::vector<FramePose> poses;
  for (std::size_t i = 0; i < table.rows(); ++i)
    parse_record(damaged, -1, [&] {
      if (times_ns[i] < 0 || times_ns[i] > kMaxTime_ns)
        throw InputError(file, row_of("timestamp_ns", i), std::to_string(times_ns[i]), kTimeRule);
      poses.push_back(
          {static_cast<std::int64_t>(i), times_ns[i], columns.at(i) * vehicle_from_body});
    });
  if (poses.empty()) throw InputError(file, "", "", "has no pose");
  std::ranges::stable_sort(poses, {}, &FramePose::t_ns);
  std::vector<FramePose> apart;
  for (const FramePose& pose : poses)
    if (apart.empty() || pose.t_ns - apart.back().t_ns >= kApart_ns) apart.push_back(pose);
  return apart;
}

std::map<std::string, Rigid3d> parse_extrinsics(std::string_view feather,
                                                const std::filesystem::path& file) {
  const ArrowTable table(feather, file);
  const std::vector<std::string> names = table.texts("sensor_name");
  const PoseColumns columns(table, file);
  std::map<std::string, Rigid3d> sensors;
  for (std::size_t i = 0; i < table.rows(); ++i)
    if (!sensors.emplace(names[i], body_from_vehicle() * columns.at(i)).second)
      throw InputError(file, row_of("sensor_name", i), names[i], "there are two such sensors");
  return sensors;
}

std::map<std::string, CameraCalibration> parse_intrinsics(std::string_view feather,
                                                          const std::filesystem::path& file) {
  const ArrowTable table(feather, file);
  const std::vector<std::string> names = table.texts("sensor_name");
  std::map<std::string, CameraCalibration> cameras;
  const auto column = [&](const char* name) {
    return [&file, name, values = table.numbers(name)](std::size_t i, double least, double most,
                                                       const char* rule) {
      if (!(values[i] >= least && values[i] <= most))
        throw InputError(file, row_of(name, i), std::to_string(values[i]), rule);
      return values[i];
    };
  };
  const auto fx = column("fx_px"), fy = column("fy_px"), cx = column("cx_px"), cy = column("cy_px"),
             width = column("width_px"), height = column("height_px");
  for (std::size_t i = 0; i < table.rows(); ++i) {
    CameraCalibration camera;
    camera.name = names[i];
    camera.model = "opencv_pinhole";
    const double w = width(i, 1, kMaxImageSize_px, "pixels, 1 to 65536"),
                 h = height(i, 1, kMaxImageSize_px, "pixels, 1 to 65536");
    if (w * h > static_cast<double>(kMaxPixels))
      throw InputError(file, row_of("width_px, height_px", i),
                       std::to_string(w) + ", " + std::to_string(h), "at most 2^28 pixels");
    camera.width = static_cast<int>(w);
    camera.height = static_cast<int>(h);
    constexpr const char *kFocal = "pixels, above 0, at most 1e6",
                         *kPrincipal = "pixels, at most one image size outside the image";
    constexpr double kLeastFocal_px = 1e-9;
    camera.parameters = {fx(i, kLeastFocal_px, kMaxFocalLength_px, kFocal),
                         fy(i, kLeastFocal_px, kMaxFocalLength_px, kFocal),
                         cx(i, -w, 2 * w, kPrincipal),
                         cy(i, -h, 2 * h, kPrincipal),
                         0,
                         0,
                         0,
                         0,
                         0};
    if (!cameras.emplace(names[i], camera).second)
      throw InputError(file, row_of("sensor_name", i), names[i], "there are two such cameras");
  }
  return cameras;
}

}  // namespace redrive::argoverse2

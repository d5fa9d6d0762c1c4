// SPDX-License-Identifier: Apache-2.0
#include "redrive/camera/mount.h"

#include <array>
#include <charconv>
#include <cmath>

#include <Eigen/Geometry>

#include "redrive/math/angles.h"

namespace redrive {
namespace {

constexpr double kMaxCoordinate_m = 1e4;  // as a shift, edit/view_requests.h
constexpr double kMaxAngle_deg = 360, kMinFov_deg = 1, kMaxFov_deg = 170;
constexpr int kMinSide = 16, kMaxSide = 4096;

/// Takes a number from the front of *text and then `end`, 0: the end of the text.
template <class Number>
bool take(std::string_view* text, char end, Number* number) {
  const auto [next, error] = std::from_chars(text->data(), text->data() + text->size(), *number);
  if (error != std::errc{}) return false;
  text->remove_prefix(next - text->data());
  if (end == 0) return text->empty();
  if (text->empty() || text->front() != end) return false;
  text->remove_prefix(1);
  return true;
}

}  // namespace

Rigid3d Mount::body_from_sensor() const {
  Eigen::Matrix3d level;  // columns: the camera's x, y, z axes in body axes
  level << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  const auto turn = [](double angle_deg, const Eigen::Vector3d& axis) {
    return Eigen::AngleAxisd(kRadiansPerDegree * angle_deg, axis).toRotationMatrix();
  };
  Rigid3d pose = Rigid3d::Identity();
  pose.linear() = turn(yaw_deg, Eigen::Vector3d::UnitZ()) * level *
                  turn(pitch_deg, Eigen::Vector3d::UnitX()) *
                  turn(roll_deg, Eigen::Vector3d::UnitZ());
  pose.translation() = position_m;
  return pose;
}

Camera Lens::pinhole() const {
  const double f = 0.5 * width / std::tan(0.5 * kRadiansPerDegree * fov_deg);
  return {OpenCvPinhole{}, f, f, 0.5 * (width - 1), 0.5 * (height - 1), width, height};
}

std::optional<Mount> parse_mount(std::string_view text) {
  std::array<double, 6> numbers{};
  for (std::size_t i = 0; i < 6; ++i)
    if (!take(&text, i < 5 ? ',' : '\0', &numbers[i]) ||
        !(std::abs(numbers[i]) <= (i < 3 ? kMaxCoordinate_m : kMaxAngle_deg)))
      return std::nullopt;
  return Mount{{numbers[0], numbers[1], numbers[2]}, numbers[3], numbers[4], numbers[5]};
}

std::optional<Lens> parse_lens(std::string_view text) {
  constexpr std::string_view kPinhole = "pinhole:";
  Lens lens;
  if (!text.starts_with(kPinhole)) {
    lens.camera = text;
    return text.empty() ? std::nullopt : std::optional(lens);
  }
  text.remove_prefix(kPinhole.size());
  if (!take(&text, ':', &lens.fov_deg) || !take(&text, 'x', &lens.width) ||
      !take(&text, '\0', &lens.height))
    return std::nullopt;
  const auto is_side = [](int side) { return side >= kMinSide && side <= kMaxSide; };
  if (!(lens.fov_deg >= kMinFov_deg && lens.fov_deg <= kMaxFov_deg) || !is_side(lens.width) ||
      !is_side(lens.height))
    return std::nullopt;
  return lens;
}

}  // namespace redrive

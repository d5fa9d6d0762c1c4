// SPDX-License-Identifier: Apache-2.0
#include "redrive/perception/line_pen.h"

namespace redrive {
namespace {

constexpr int kStepsOfLine = 16;

}  // namespace

void LinePen::begin(const char* kind, std::string label) {
  kind_ = kind;
  label_ = std::move(label);
  open_ = false;
  last_.reset();
}

void LinePen::to(const Eigen::Vector3d& in_world) {
  if (!last_) {
    add(in_world);
  } else {
    for (int i = 1; i <= kStepsOfLine; ++i)
      add(*last_ + (in_world - *last_) * (static_cast<double>(i) / kStepsOfLine));
  }
  last_ = in_world;
}

void LinePen::add(const Eigen::Vector3d& in_world) {
  const auto at = project_(in_world);
  if (at) {
    if (!open_) lines_.push_back({kind_, std::exchange(label_, ""), {}});
    lines_.back().points.push_back(*at);
  }
  open_ = at.has_value();
}

Eigen::Vector3d box_corner(const Rigid3d& world_from_box, const Eigen::Vector3d& size_m, int i) {
  const Eigen::Vector3d sign(i & 1 ? 1 : -1, i & 2 ? 1 : -1, i & 4 ? 1 : -1);
  return world_from_box * (0.5 * sign.cwiseProduct(size_m));
}

void draw_box(const char* kind, const std::string& label, const Eigen::Vector3d& size_m,
              const Rigid3d& world_from_box, LinePen* pen) {
  const auto to = [&](int i) { pen->to(box_corner(world_from_box, size_m, i)); };
  pen->begin(kind, label);
  for (const int i : {4, 5, 7, 6, 4, 0, 1, 3, 2, 0}) to(i);
  for (const int i : {1, 2, 3}) {
    pen->begin(kind);
    to(i);
    to(i + 4);
  }
}

}  // namespace redrive

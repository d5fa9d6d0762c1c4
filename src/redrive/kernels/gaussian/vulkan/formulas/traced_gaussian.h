// SPDX-License-Identifier: Apache-2.0
// The projection of a Gaussian and its adjoint (field/gaussian.h) as expressions, for each camera
// model and for LiDAR. Inputs and outputs are called as in formulas.glsl (write_formulas.cc).
#pragma once

#include <array>
#include <bit>
#include <string>
#include <type_traits>
#include <variant>
#include <vector>

#include "redrive/camera/models.h"
#include "redrive/field/gaussian.h"
#include "redrive/kernels/gaussian/pair_sums.h"
#include "redrive/kernels/gaussian/vulkan/formulas/trace.h"

namespace redrive {

/// Shaders have floats.
template <>
constexpr trace::Sym SpherePlane::least_w<trace::Sym>() {
  return double(least_w<float>());
}

namespace trace {

/// Follows both ways of a radial factor that branches on the camera's numbers.
template <class Radial>
struct TracedRadial {
  template <class M, class C>
  static RadialFactor<M> radial_factor(const C& c, Sym s) {
    branch = {};
    const RadialFactor<M> no = Radial::template radial_factor<M>(c, s);
    if (branch.condition.id < 0) return no;
    branch.taken = true;
    const RadialFactor<M> yes = Radial::template radial_factor<M>(c, s);
    const SymMask condition = branch.condition;
    return {M::select(condition, yes.value, no.value), M::select(condition, yes.slope, no.slope)};
  }
};
template <class Model>
struct TracedModel : Model {
  using Radial = TracedRadial<typename Model::Radial>;
};

inline std::string indexed(const char* name, int k) {
  return name + ("[" + std::to_string(k) + "]");
}
template <std::size_t n>
std::array<Sym, n> inputs(const char* name) {
  std::array<Sym, n> all;
  for (std::size_t k = 0; k < n; ++k) all[k] = input(indexed(name, static_cast<int>(k)));
  return all;
}

/// A PlainCamera of one model, and SphericalCamera.
struct TracedLens {
  Sym fx = input("c.fx"), fy = input("c.fy"), cx = input("c.cx"), cy = input("c.cy"),
      max_radius2 = input("c.max_radius2");
};
template <class Model>
struct TracedCamera : TracedLens {
  using Numbers = typename Model::template Numbers<Sym>;
  static constexpr bool perspective = Model::kPerspective;
  Numbers numbers = std::bit_cast<Numbers>(inputs<sizeof(Numbers) / sizeof(Sym)>("c.numbers"));
};
struct TracedLidar : TracedLens {
  static constexpr bool perspective = false;
};

template <class M, class Model>
PlainPixel<M> project(const TracedCamera<Model>& c, Sym x, Sym y, Sym z) {
  const auto at = project_lens<TracedModel<Model>, M>(c.numbers, c.max_radius2, x, y, z);
  return {c.fx * at.x + c.cx, c.fy * at.y + c.cy, at.valid};
}
template <class M>
PlainPixel<M> project(const TracedLidar& c, Sym x, Sym y, Sym z) {
  const PlanePoint<M> at = SphericalPlane::project<M>(x, y, z);
  return {c.fx * at.x, c.fy * at.y, M::both(at.seen, at.s <= c.max_radius2)};
}
template <class M, class Model>
void project_adjoint(const TracedCamera<Model>& c, Sym x, Sym y, Sym z, Sym d_u, Sym d_v,
                     Sym* d_point) {
  project_lens_adjoint<TracedModel<Model>, M>(c.numbers, c.max_radius2, x, y, z, d_u * c.fx,
                                              d_v * c.fy, d_point);
}
template <class M>
void project_adjoint(const TracedLidar& c, Sym x, Sym y, Sym z, Sym d_u, Sym d_v, Sym* d_point) {
  SphericalPlane::adjoint<M>(x, y, z, d_u * c.fx, d_v * c.fy, d_point);
}

}  // namespace trace

template <>
inline constexpr bool kIsLidar<trace::TracedLidar> = true;

namespace trace {

/// Calls use(camera, name) for the camera of each model, in the order of CameraModel.
template <int i = 0, class Use>
void for_each_model(const Use& use) {
  if constexpr (i < static_cast<int>(std::variant_size_v<CameraModel>)) {
    using Model = std::variant_alternative_t<i, CameraModel>;
    use(TracedCamera<Model>(), std::string(Model::kName));
    for_each_model<i + 1>(use);
  }
}

/// The projection of one Gaussian by a camera.
template <class C>
struct TracedGaussian {
  C camera;
  GaussianPose<TraceMath> pose;
  std::array<Sym, kGaussianRows> rows = inputs<kGaussianRows>("rows");
  ProjectedGaussian<TraceMath> at;

  explicit TracedGaussian(const C& of) : camera(of) {
    std::ranges::copy(inputs<9>("pose.rotation"), pose.rotation);
    std::ranges::copy(inputs<3>("pose.centre"), pose.centre);
    project_mean<TraceMath>(camera, pose, rows.data() + kPositionRow, &at);
  }

  /// project_mean.
  std::vector<Output> mean() const {
    return {{"mean[0]", at.mean[0]}, {"mean[1]", at.mean[1]}, {"visible", at.visible}};
  }

  /// project_gaussian.
  std::vector<Output> projection() {
    project_gaussian<TraceMath>(camera, pose, rows.data(), &at);
    std::vector<Output> to = {{"o.visible", at.visible},
                              {"o.alpha", at.alpha},
                              {"o.distance", at.length},
                              {"o.covariance", at.covariance}};
    const auto add = [&](const char* name, const Sym* x, int n) {
      for (int k = 0; k < n; ++k) to.emplace_back(indexed(name, k), x[k]);
    };
    add("o.mean", at.mean, 2);
    add("o.conic", at.conic, 3);
    add("o.variance", at.variance, 2);
    add("o.slope", at.slope, 2);
    add("o.colour", at.colour, 3);
    return to;
  }

  /// project_gaussian_adjoint, given sums over pixels. To be called after `projection`.
  std::vector<Output> adjoint() const {
    const auto sum = inputs<kernels::kPairSums>("sum");
    Sym d_rows[kGaussianRows];
    GaussianPoseGradient<TraceMath> d_pose;
    project_gaussian_adjoint<TraceMath>(camera, pose, rows.data(), at,
                                        kernels::gradient_of_sums<TraceMath>(sum.data(), at),
                                        d_rows, &d_pose);
    std::vector<Output> to;
    for (int k = 0; k < kGaussianRows; ++k) to.emplace_back(indexed("d_rows", k), d_rows[k]);
    for (int k = 0; k < 3; ++k) to.emplace_back(indexed("d_pose", k), d_pose.translation[k]);
    for (int k = 0; k < 3; ++k) to.emplace_back(indexed("d_pose", 3 + k), d_pose.rotation[k]);
    return to;
  }
};

}  // namespace trace
}  // namespace redrive

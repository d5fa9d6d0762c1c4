// SPDX-License-Identifier: Apache-2.0
// Traced formulas against the templates that they were traced from, in double.
#include "redrive/kernels/gaussian/vulkan/formulas/trace.h"

#include <cmath>
#include <map>
#include <random>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "redrive/bench/roofline.h"
#include "redrive/camera/example_cameras_testing.h"
#include "redrive/kernels/gaussian/vulkan/formulas/traced_gaussian.h"
#include "redrive/math/angle_of.h"
#include "redrive/optim/ssim_gradient.h"

namespace redrive::trace {
namespace {

using Math = NumberMath<double>;
using Inputs = std::map<std::string, double>;

TEST(Trace, IsWrittenAsGlsl) {
  nodes.clear();
  known.clear();
  const Sym x = input("x"), y = input("y"), d = x - y * TraceMath::constant(2);
  EXPECT_EQ(d.id, (x - y * TraceMath::constant(2)).id) << "an expression is written once";
  const SymMask less = d < x;
  const Sym chosen = TraceMath::select(less, d, -x), power = TraceMath::exp(d);
  EXPECT_EQ(function("void f()", {{"a", chosen}, {"b", power / 3.0}, {"c", less}}),
            R"(void f() {
  float t3 = y * 2.0;
  float t4 = x - t3;
  bool t5 = t4 < x;
  float t6 = -x;
  float t7 = t5 ? t4 : t6;
  float t8 = exp(t4);
  float t10 = t8 / 3.0;
  a = t7;
  b = t10;
  c = t5;
}  // 7 operations

)");
}

TEST(Trace, AngleIsAccurate) {
  for (double angle = 0; angle <= 3.1416; angle += 0.00037)
    for (const double length : {1e-6, 1.0, 1e5}) {
      const double y = length * std::fabs(std::sin(angle)), x = length * std::cos(angle);
      ASSERT_NEAR(angle_of<Math>(y, x), std::atan2(y, x), 3e-7) << angle;
    }
}

TEST(Trace, SsimIsTheTemplate) {
  const Sym m[5] = {input("m0"), input("m1"), input("m2"), input("m3"), input("m4")};
  const SsimGradient<TraceMath> s = ssim_gradient<TraceMath>(m[0], m[1], m[2], m[3], m[4]);
  const SsimGradient<Math> n = ssim_gradient<Math>(0.4, 0.3, 0.21, 0.13, 0.14);
  const std::vector<double> value =
      values({{"ssim", s.ssim}, {"by_x", s.by_x}, {"by_xx", s.by_xx}, {"by_xy", s.by_xy}},
             {{"m0", 0.4}, {"m1", 0.3}, {"m2", 0.21}, {"m3", 0.13}, {"m4", 0.14}});
  EXPECT_EQ(value, (std::vector{n.ssim, n.by_x, n.by_xx, n.by_xy}));
}

/// A Gaussian, the pose of who sees it and sums over its pixels.
struct Case {
  double rows[kGaussianRows], sum[kernels::kPairSums];
  GaussianPose<Math> pose;
};
Case make_case(std::mt19937* random) {
  std::normal_distribution<double> normal;
  const auto next = [&](double sigma) {
    return static_cast<double>(float(sigma * normal(*random)));
  };
  Case c;
  for (double& row : c.rows) row = next(1);
  for (int k = 0; k < 3; ++k) c.rows[kPositionRow + k] = next(4);
  for (int k = 0; k < 3; ++k) c.rows[kLogScaleRow + k] -= 2;
  for (double& sum : c.sum) sum = next(1);
  const double q[4] = {1, next(0.1), next(0.1), next(0.1)};
  double r[3][3];
  rotation_from_quaternion<Math>(q, r);
  for (int k = 0; k < 9; ++k) c.pose.rotation[k] = r[k / 3][k % 3];
  for (int k = 0; k < 3; ++k) c.pose.centre[k] = next(0.5);
  return c;
}

Inputs inputs_of(const PlainCamera& camera, const Case& c) {
  Inputs in = {{"c.fx", camera.fx},
               {"c.fy", camera.fy},
               {"c.cx", camera.cx},
               {"c.cy", camera.cy},
               {"c.max_radius2", camera.max_radius2}};
  const auto add = [&](const char* name, const auto& numbers) {
    int k = 0;
    for (const double x : numbers) in[indexed(name, k++)] = x;
  };
  add("c.numbers", camera.numbers);
  add("pose.rotation", c.pose.rotation);
  add("pose.centre", c.pose.centre);
  add("rows", c.rows);
  add("sum", c.sum);
  return in;
}

/// What the templates compute for the three functions, in the order of TracedGaussian.
struct Answers {
  std::vector<double> mean, projection, adjoint;
  bool visible;
};
template <class C>
Answers answers(const C& camera, const Case& c) {
  Answers out;
  ProjectedGaussian<Math> at;
  project_mean<Math>(camera, c.pose, c.rows + kPositionRow, &at);
  out.visible = at.visible;
  out.mean = {at.mean[0], at.mean[1], double(at.visible)};
  project_gaussian<Math>(camera, c.pose, c.rows, &at);
  out.projection = {double(at.visible), at.alpha,       at.length,      at.covariance,
                    at.mean[0],         at.mean[1],     at.conic[0],    at.conic[1],
                    at.conic[2],        at.variance[0], at.variance[1], at.slope[0],
                    at.slope[1],        at.colour[0],   at.colour[1],   at.colour[2]};
  double d_rows[kGaussianRows] = {};
  GaussianPoseGradient<Math> d_pose;
  project_gaussian_adjoint<Math>(camera, c.pose, c.rows, at,
                                 kernels::gradient_of_sums<Math>(c.sum, at), d_rows, &d_pose);
  out.adjoint.assign(d_rows, d_rows + kGaussianRows);
  out.adjoint.insert(out.adjoint.end(), d_pose.translation, d_pose.translation + 3);
  out.adjoint.insert(out.adjoint.end(), d_pose.rotation, d_pose.rotation + 3);
  return out;
}

void expect_same(const std::vector<Output>& outputs, const Inputs& in,
                 const std::vector<double>& expected) {
  const std::vector<double> value = values(outputs, in);
  ASSERT_EQ(value.size(), expected.size());
  for (std::size_t i = 0; i < value.size(); ++i)
    EXPECT_TRUE(value[i] == expected[i] || (std::isnan(value[i]) && std::isnan(expected[i])))
        << outputs[i].name << ": " << value[i] << " instead of " << expected[i];
}

/// Compares random Gaussians; some are behind the camera or beyond its edge.
template <class C>
void compare(const PlainCamera& camera, TracedGaussian<C> traced, int* hidden) {
  const std::vector<Output> mean = traced.mean(), projection = traced.projection(),
                            adjoint = traced.adjoint();
  std::mt19937 random(7);
  int visible = 0;
  for (int i = 0; i < 60; ++i) {
    const Case c = make_case(&random);
    const Inputs in = inputs_of(camera, c);
    const Answers expected =
        with_camera(camera, [&](const auto& lens) { return answers(lens, c); });
    visible += expected.visible;
    ASSERT_NO_FATAL_FAILURE(expect_same(mean, in, expected.mean));
    ASSERT_NO_FATAL_FAILURE(expect_same(projection, in, expected.projection));
    ASSERT_NO_FATAL_FAILURE(expect_same(adjoint, in, expected.adjoint));
  }
  EXPECT_GT(visible, 2);
  *hidden += 60 - visible;
}

TEST(Trace, EveryCameraIsTheTemplate) {
  int compared = 0, hidden = 0;
  for (const ExampleCamera& example : example_cameras()) {
    SCOPED_TRACE(example.name);
    const PlainCamera camera = make_plain_camera(example.camera);
    for_each_model([&](const auto& traced, const std::string& name) {
      if (name != example.camera.info().name) return;
      ++compared;
      compare(camera, TracedGaussian(traced), &hidden);
    });
  }
  EXPECT_EQ(compared, static_cast<int>(example_cameras().size()));
  EXPECT_GT(hidden, 10 * compared);
}

TEST(Trace, LidarIsTheTemplate) {
  int hidden = 0;
  compare(make_spherical_camera(400, 1.2, 640, 64), TracedGaussian(TracedLidar()), &hidden);
  EXPECT_GT(hidden, 2);
}

TEST(Trace, TheRooflineHasTheNumberOfOperations) {
  for_each_model([](const auto& of, const std::string& name) {
    if (name != "opencv_pinhole") return;
    TracedGaussian gaussian(of);
    const auto operations = [](const std::vector<Output>& outputs) {
      const std::vector<bool> needed = needed_for(outputs);
      double n = 0;
      for (std::size_t i = 0; i < nodes.size(); ++i) n += needed[i] && nodes[i].operation;
      return n;
    };
    EXPECT_NEAR(operations(gaussian.projection()), bench::kProjectOperations,
                0.02 * bench::kProjectOperations);
    EXPECT_NEAR(operations(gaussian.adjoint()), bench::kAdjointOperations,
                0.02 * bench::kAdjointOperations);
  });
}

}  // namespace
}  // namespace redrive::trace

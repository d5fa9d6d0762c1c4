// SPDX-License-Identifier: Apache-2.0
#include "redrive/camera/lenses/double_sphere.h"

#include <gtest/gtest.h>

#include "redrive/camera/example_cameras_testing.h"
#include "redrive/camera/lenses/eucm.h"

namespace redrive {
namespace {

std::optional<std::array<double, 2>> projected(const auto& lens, const Eigen::Vector3d& point) {
  return lens.project(std::array<double, 3>{point.x(), point.y(), point.z()});
}

// The published formulas, written out.
TEST(DoubleSphere, IsUsenkosModel) {
  const double xi = -0.18, alpha = 0.59;
  const DoubleSphere lens(std::array{xi, alpha});
  const Eigen::Vector3d p(0.7, -0.4, 0.5);
  const double d1 = p.norm(), d2 = std::hypot(p.x(), p.y(), xi * d1 + p.z()),
               w = alpha * d2 + (1 - alpha) * (xi * d1 + p.z());
  const auto at = projected(lens, p);
  ASSERT_TRUE(at);
  EXPECT_NEAR((*at)[0], p.x() / w, 1e-15);
  EXPECT_NEAR((*at)[1], p.y() / w, 1e-15);
}

TEST(Eucm, IsKhomutenkosModel) {
  const double alpha = 0.55, beta = 1.2;
  const Eucm lens(std::array{alpha, beta});
  const Eigen::Vector3d p(0.7, -0.4, -0.1);
  const double d = std::sqrt(beta * (p.x() * p.x() + p.y() * p.y()) + p.z() * p.z()),
               w = alpha * d + (1 - alpha) * p.z();
  const auto at = projected(lens, p);
  ASSERT_TRUE(at);
  EXPECT_NEAR((*at)[0], p.x() / w, 1e-15);
  EXPECT_NEAR((*at)[1], p.y() / w, 1e-15);
}

// With one sphere both are the unified model, whose xi is alpha / (1 - alpha) at another scale.
TEST(DoubleSphere, WithoutASecondSphereIsTheUnifiedModel) {
  for (const double alpha : {0.3, 0.5, 0.7}) {
    const DoubleSphere lens(std::array{0.0, alpha});
    const Eucm other(std::array{alpha, 1.0});
    const Mei unified(std::array{0.0, 0.0, 0.0, 0.0, 0.0, alpha / (1 - alpha)});
    for (const Eigen::Vector3d& direction : directions(500)) {
      const auto a = projected(lens, direction), b = projected(other, direction),
                 c = projected(unified, direction);
      EXPECT_EQ(a.has_value(), b.has_value());
      EXPECT_EQ(a.has_value(), c.has_value());
      if (!a || !b || !c) continue;
      const double scale = 1 + std::hypot((*a)[0], (*a)[1]);
      for (int k = 0; k < 2; ++k) {
        EXPECT_NEAR((*a)[k], (*b)[k], 1e-9 * scale);
        EXPECT_NEAR((*a)[k] * (1 - alpha), (*c)[k], 1e-9 * scale);
      }
    }
  }
}

// Every direction up to the edge comes back, and none beyond has a pixel: the radius grows up to
// there.
TEST(DoubleSphere, EndsWhereItFolds) {
  for (const auto& [xi, alpha] : {std::pair(-0.2, 0.59), {-0.5, 0.9}, {0.6, 0.8}, {0.3, 0.2}}) {
    const DoubleSphere lens(std::array{xi, alpha});
    const auto w_at = [&](double angle) {
      const double k = xi + std::cos(angle), d2 = std::hypot(std::sin(angle), k);
      return alpha * d2 + (1 - alpha) * k;
    };
    double before = -1;
    bool ended = false;
    for (int i = 0; i < 20000; ++i) {
      const double angle = M_PI * i / 20000, w = w_at(angle);
      const Eigen::Vector3d direction(std::sin(angle), 0, std::cos(angle));
      const auto at = projected(lens, direction);
      if (!at) {
        ended = true;
        EXPECT_TRUE(w <= 1e-9 || std::sin(angle) / w <= before * (1 + 1e-6)) << "too early";
        continue;
      }
      ASSERT_FALSE(ended);
      EXPECT_GE((*at)[0], before);
      before = (*at)[0];
      const auto back = lens.unproject({(*at)[0], 0});
      ASSERT_TRUE(back);
      EXPECT_LT((back->normalized() - direction).norm(), 1e-6);
    }
    EXPECT_TRUE(ended);
  }
}

}  // namespace
}  // namespace redrive

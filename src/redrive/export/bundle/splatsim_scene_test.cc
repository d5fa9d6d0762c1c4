// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/bundle/splatsim_scene.h"

#include <cmath>

#include <gtest/gtest.h>
#include <Eigen/Geometry>
#include <nlohmann/json.hpp>

#include "redrive/edit/actor_body.h"
#include "redrive/field/splat_numbers.h"
#include "redrive/math/local_level.h"
#include "redrive/model/gaussians_testing.h"

namespace redrive {
namespace {

class SplatSim : public testing::Test {
 protected:
  static constexpr std::size_t kCount = 200;
  const std::vector<float> storage_ = gaussians_of_test(kCount, 15);
  const Rigid3d enu_ = ecef_from_enu({0.83, 0.33, 120});
  SplatSimInput input_;

  SplatSim() {
    input_.scene_id = "street";
    input_.version = "0.1";
    input_.gaussians.n = kCount;
    input_.gaussians.numbers = storage_;
  }
  static const std::string& member(const SplatSimScene& scene, const std::string& name) {
    for (const auto& [is, bytes] : scene.members)
      if (is == name) return bytes;
    throw std::runtime_error(name + " is missing");
  }
};

/// Colour of a channel along a direction, as splat viewers compute it.
double colour(const SplatNumbers& of, int channel, const Eigen::Vector3d& direction) {
  double harmonics[kHarmonics];
  const double d[3] = {direction.x(), direction.y(), direction.z()};
  spherical_harmonics(d, harmonics);
  double sum = 0.5 + harmonics[0] * of.dc[channel];
  for (int j = 0; j < 3; ++j) sum += harmonics[1 + j] * of.rest[channel][j];
  return sum;
}

/// Where the scene lies, each Gaussian looks as before, turned with the world.
TEST_F(SplatSim, HasItsGaussiansWhereTheyAreOnTheEarth) {
  Rigid3d enu_from_gaussians = Rigid3d::Identity();
  enu_from_gaussians.linear() = (Eigen::AngleAxisd(2.1, Eigen::Vector3d::UnitZ()) *
                                 Eigen::AngleAxisd(0.03, Eigen::Vector3d::UnitY()))
                                    .toRotationMatrix();
  input_.ecef_from_gaussians = enu_ * enu_from_gaussians;
  const SplatSimScene scene = make_splatsim_scene(input_);
  EXPECT_EQ(scene.members[0].first, "default.usda");
  const auto json = nlohmann::json::parse(member(scene, "scene.json"));
  EXPECT_EQ(json["schema"], "splatsim.scene/v3");
  EXPECT_EQ(json["world"]["frame_convention"]["quaternion_order"], "xyzw");
  const nlohmann::json& anchor = json["world"]["ecef_anchor"];
  for (int row = 0; row < 4; ++row)
    for (int column = 0; column < 4; ++column)
      EXPECT_NEAR(anchor[row][column].get<double>(), enu_.matrix()(row, column), 1e-3);

  // The chunks' Gaussians are found by their opacity.
  std::size_t found = 0;
  for (const nlohmann::json& chunk : json["gaussians"]["chunks"]) {
    const ActorBody body = parse_actor_body(member(scene, chunk["uri"]), "chunk.spz");
    EXPECT_EQ(body.n, chunk["n_points"].get<std::size_t>());
    for (std::size_t k = 0; k < body.n; ++k) {
      const SplatNumbers is = splat_numbers(body.numbers, k);
      const Eigen::Vector3d at(is.position[0], is.position[1], is.position[2]);
      for (int c = 0; c < 3; ++c) {
        EXPECT_GE(at[c], chunk["bbox_min"][c].get<double>() - 1e-3);
        EXPECT_LE(at[c], chunk["bbox_max"][c].get<double>() + 1e-3);
      }
      const Eigen::Vector3d in_gaussians = enu_from_gaussians.inverse() * at;
      for (std::size_t i = 0; i < kCount; ++i) {
        const SplatNumbers was = splat_numbers(storage_, i);
        if ((in_gaussians - Eigen::Vector3d(was.position[0], was.position[1], was.position[2]))
                .norm() > 2e-3)
          continue;
        ++found;
        const Eigen::Vector3d direction = Eigen::Vector3d(0.3, -0.8, 0.5).normalized();
        for (int c = 0; c < 3; ++c)
          EXPECT_NEAR(colour(is, c, enu_from_gaussians.linear() * direction),
                      colour(was, c, direction), 0.03)
              << "bytes";
        const auto axes = [](const SplatNumbers& of) {
          return Eigen::Quaterniond(of.quaternion[0], of.quaternion[1], of.quaternion[2],
                                    of.quaternion[3])
              .toRotationMatrix();
        };
        EXPECT_LT((axes(is) - enu_from_gaussians.linear() * axes(was)).norm(), 0.02);
      }
    }
  }
  EXPECT_EQ(found, kCount);
  EXPECT_EQ(json["gaussians"]["n_gaussians"], kCount);
}

TEST_F(SplatSim, DividesThePlane) {
  const SplatSimScene scene = make_splatsim_scene(input_);
  const auto json = nlohmann::json::parse(member(scene, "scene.json"));
  EXPECT_EQ(scene.chunks, 4u) << "about the origin";
  EXPECT_EQ(json["gaussians"]["chunks"].size(), scene.chunks);
  EXPECT_EQ(json["world"]["ecef_anchor"][0], (std::vector<double>{1, 0, 0, 0}));
  EXPECT_EQ(member(scene, "metadata.yaml"), member(make_splatsim_scene(input_), "metadata.yaml"));
}

}  // namespace
}  // namespace redrive

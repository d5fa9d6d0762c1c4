// SPDX-License-Identifier: Apache-2.0
// The file read back by a parser of its own. tests/browser/mesh_test.mjs has Khronos's validator.
#include "redrive/model/gaussian_gltf.h"

#include <cmath>
#include <cstring>

#include <gtest/gtest.h>
#include <Eigen/Geometry>
#include <nlohmann/json.hpp>

#include "redrive/field/splat_numbers.h"
#include "redrive/model/gaussians_testing.h"

namespace redrive {
namespace {

class Gltf : public testing::Test {
 protected:
  static constexpr std::size_t kCount = 37;
  const std::vector<float> storage_ = gaussians_of_test(kCount, 20);
  std::string bytes_;
  nlohmann::json json_, attributes_;
  std::size_t bin_ = 0;  ///< where the buffer begins

  std::uint32_t word(std::size_t at) const {
    std::uint32_t number = 0;
    std::memcpy(&number, bytes_.data() + at, sizeof number);
    return number;
  }
  void write(int sh_degree) {
    kernels::Gaussians gaussians;
    gaussians.n = kCount;
    gaussians.numbers = storage_;
    bytes_ = gaussian_gltf(gaussians, sh_degree);
    ASSERT_EQ(bytes_.substr(0, 4), "glTF");
    ASSERT_EQ(word(4), 2u);
    ASSERT_EQ(word(8), bytes_.size());
    const std::size_t json_bytes = word(12);
    json_ = nlohmann::json::parse(bytes_.substr(20, json_bytes));
    bin_ = 28 + json_bytes;
    ASSERT_EQ(bin_ % 4, 0u);
    ASSERT_EQ(word(bin_ - 8), bytes_.size() - bin_);
    ASSERT_EQ(json_["buffers"][0]["byteLength"], bytes_.size() - bin_);
    attributes_ = json_["meshes"][0]["primitives"][0]["attributes"];
  }
  /// Number k of Gaussian i.
  float at(const std::string& attribute, std::size_t i, int k) const {
    const nlohmann::json& accessor = json_["accessors"][attributes_.at(attribute).get<int>()];
    const int width = accessor["type"] == "SCALAR" ? 1 : accessor["type"] == "VEC3" ? 3 : 4;
    const std::size_t view = json_["bufferViews"][accessor["bufferView"].get<int>()]["byteOffset"];
    float number = 0;
    std::memcpy(&number, bytes_.data() + bin_ + view + 4 * (width * i + k), sizeof number);
    return number;
  }
};

TEST_F(Gltf, HasTheNumbersOfTheGaussians) {
  write(1);
  const std::string prefix = "KHR_gaussian_splatting:";
  for (std::size_t i = 0; i < kCount; ++i) {
    const SplatNumbers of = splat_numbers(storage_, i);
    for (int k = 0; k < 3; ++k) {
      EXPECT_FLOAT_EQ(at("POSITION", i, k), of.position[k]);
      EXPECT_FLOAT_EQ(at(prefix + "SCALE", i, k), std::exp(of.log_scale[k]));
      EXPECT_FLOAT_EQ(at(prefix + "ROTATION", i, k), of.quaternion[1 + k]);
      EXPECT_FLOAT_EQ(at(prefix + "SH_DEGREE_0_COEF_0", i, k), of.dc[k]);
      for (int j = 0; j < 3; ++j)
        EXPECT_FLOAT_EQ(at(prefix + "SH_DEGREE_1_COEF_" + std::to_string(j), i, k), of.rest[k][j]);
      EXPECT_LE(json_["accessors"][0]["min"][k], at("POSITION", i, k));
      EXPECT_GE(json_["accessors"][0]["max"][k], at("POSITION", i, k));
    }
    EXPECT_FLOAT_EQ(at(prefix + "ROTATION", i, 3), of.quaternion[0]);
    EXPECT_FLOAT_EQ(at(prefix + "OPACITY", i, 0), 1 / (1 + std::exp(-of.opacity)));
  }
  const nlohmann::json& turn = json_["nodes"][0]["rotation"];
  const Eigen::Quaterniond node(turn[3].get<double>(), turn[0].get<double>(), turn[1].get<double>(),
                                turn[2].get<double>());
  EXPECT_TRUE((node * Eigen::Vector3d::UnitZ()).isApprox(Eigen::Vector3d::UnitY(), 1e-12))
      << "up is y";
  EXPECT_TRUE((node * Eigen::Vector3d::UnitX()).isApprox(Eigen::Vector3d::UnitZ(), 1e-12));
}

TEST_F(Gltf, LeavesDegreesOut) {
  write(0);
  EXPECT_EQ(attributes_.size(), 5u);
  EXPECT_EQ(bytes_.size() - bin_, kCount * 14 * sizeof(float));
}

}  // namespace
}  // namespace redrive

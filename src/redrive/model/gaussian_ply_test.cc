// SPDX-License-Identifier: Apache-2.0
// The file read back by a parser of its own: numbers as the code of 3D Gaussian Splatting
// interprets them are those that the Gaussians are rendered with.
#include "redrive/model/gaussian_ply.h"

#include <cmath>
#include <cstring>
#include <map>
#include <random>
#include <sstream>
#include <string>
#include <vector>

#include <gtest/gtest.h>

namespace redrive {
namespace {

constexpr std::size_t kGaussiansOfTest = 19;  // a block and a part of one
constexpr double kTolerance = 4e-7;           // some roundings to float of numbers of about 1

/// Vertices of a PLY by the names of their properties.
struct PlyVertices {
  std::vector<std::string> names;
  std::vector<std::map<std::string, double>> vertices;
};

PlyVertices parsed(const std::string& bytes) {
  PlyVertices out;
  const std::string end = "end_header\n";
  const std::size_t body = bytes.find(end) + end.size();
  std::istringstream header(bytes.substr(0, body));
  std::string line, word, type, name;
  std::size_t n = 0;
  std::getline(header, line);
  EXPECT_EQ(line, "ply");
  std::getline(header, line);
  EXPECT_EQ(line, "format binary_little_endian 1.0");
  std::getline(header, line);
  EXPECT_EQ(std::sscanf(line.c_str(), "element vertex %zu", &n), 1) << line;
  while (header >> word && word == "property" && header >> type >> name) {
    EXPECT_EQ(type, "float");
    out.names.push_back(name);
  }
  EXPECT_EQ(word, "end_header");
  EXPECT_EQ(bytes.size(), body + 4 * n * out.names.size());
  for (std::size_t i = 0; i < n; ++i) {
    out.vertices.emplace_back();
    for (std::size_t p = 0; p < out.names.size(); ++p) {
      float number = 0;
      std::memcpy(&number, bytes.data() + body + 4 * (i * out.names.size() + p), sizeof number);
      out.vertices.back()[out.names[p]] = number;
    }
  }
  return out;
}

/// Gaussians of random numbers, in blocks.
std::vector<float> random_gaussians() {
  std::mt19937 random(51);
  std::uniform_real_distribution<float> uniform(-1, 1);
  std::vector<float> numbers(gaussian_blocks(kGaussiansOfTest) * kBlockSize, 1e9f);
  for (std::size_t i = 0; i < kGaussiansOfTest; ++i)
    for (int row = 0; row < kGaussianRows; ++row) numbers[gaussian_slot(i, row)] = uniform(random);
  for (std::size_t i = 0; i < kGaussiansOfTest; ++i) {
    for (int k = 0; k < 3; ++k) numbers[gaussian_slot(i, kColourRow + k)] += 3;  // none is clamped
    numbers[gaussian_slot(i, kPositionRow + 2)] += 4;
  }
  return numbers;
}

PlyVertices exported(const std::vector<float>& numbers, int sh_degree) {
  return parsed(gaussian_ply({kGaussiansOfTest, numbers}, sh_degree));
}

TEST(GaussianPly, HasThePropertiesThatViewersExpectInTheirOrder) {
  const std::vector<std::string> degree_0 = {
      "x",       "y",       "z",       "nx",      "ny",    "nz",    "f_dc_0", "f_dc_1", "f_dc_2",
      "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2",  "rot_3"};
  std::vector<std::string> degree_1 = degree_0;
  for (int i = 0; i < 9; ++i)
    degree_1.insert(degree_1.begin() + 9 + i, "f_rest_" + std::to_string(i));
  const std::vector<float> numbers = random_gaussians();
  EXPECT_EQ(exported(numbers, 0).names, degree_0);
  EXPECT_EQ(exported(numbers, 1).names, degree_1);
  EXPECT_EQ(exported(numbers, 0).vertices.size(), kGaussiansOfTest);
  EXPECT_TRUE(parsed(gaussian_ply({}, 1)).vertices.empty());
}

TEST(GaussianPly, KeepsPositionScaleAndOpacityAndNormalisesTheRotation) {
  const std::vector<float> numbers = random_gaussians();
  const PlyVertices ply = exported(numbers, 1);
  for (std::size_t i = 0; i < kGaussiansOfTest; ++i) {
    std::map<std::string, double> at = ply.vertices[i];
    const auto row = [&](int r) { return double(numbers[gaussian_slot(i, r)]); };
    const char* const axes[] = {"x", "y", "z"};
    double norm = 0;
    for (int k = 0; k < 4; ++k) norm = std::hypot(norm, row(kQuaternionRow + k));
    for (int k = 0; k < 3; ++k) {
      EXPECT_EQ(at[axes[k]], row(kPositionRow + k));
      EXPECT_EQ(at[std::string("n") + axes[k]], 0);
      EXPECT_EQ(at["scale_" + std::to_string(k)], row(kLogScaleRow + k));
    }
    EXPECT_EQ(at["opacity"], row(kOpacityRow));
    for (int k = 0; k < 4; ++k)
      EXPECT_NEAR(at["rot_" + std::to_string(k)] * norm, row(kQuaternionRow + k), kTolerance);
  }
}

// The formula of the code of 3D Gaussian Splatting against the projection that is rendered.
TEST(GaussianPly, HasTheColoursThatAreRendered) {
  constexpr double kC0 = 0.28209479177387814, kC1 = 0.4886025119029199;
  std::mt19937 random(52);
  std::uniform_real_distribution<double> uniform(-2, 2);
  const std::vector<float> numbers = random_gaussians();
  const PlyVertices degree_0 = exported(numbers, 0), degree_1 = exported(numbers, 1);
  PlainCamera camera;
  camera.fx = camera.fy = 100;
  camera.width = camera.height = 100;
  GaussianPose<NumberMath<double>> pose = {{1, 0, 0, 0, 1, 0, 0, 0, 1}, {}};
  for (std::size_t i = 0; i < kGaussiansOfTest; ++i) {
    double rows[kGaussianRows];
    for (int row = 0; row < kGaussianRows; ++row) rows[row] = numbers[gaussian_slot(i, row)];
    std::map<std::string, double> at = degree_1.vertices[i], at_0 = degree_0.vertices[i];
    for (int view = 0; view < 5; ++view) {
      for (int k = 0; k < 3; ++k) pose.centre[k] = uniform(random);
      const double to[3] = {at["x"] - pose.centre[0], at["y"] - pose.centre[1],
                            at["z"] - pose.centre[2]};
      const double length = std::hypot(to[0], to[1], to[2]);
      const double x = to[0] / length, y = to[1] / length, z = to[2] / length;
      ProjectedGaussian<NumberMath<double>> projected;
      project_mean<NumberMath<double>>(camera, pose, rows, &projected);
      project_gaussian<NumberMath<double>>(camera, pose, rows, &projected);
      for (int c = 0; c < 3; ++c) {
        const auto rest = [&](int k) { return at["f_rest_" + std::to_string(3 * c + k)]; };
        const std::string dc = "f_dc_" + std::to_string(c);
        EXPECT_NEAR(0.5 + kC0 * at[dc] - kC1 * y * rest(0) + kC1 * z * rest(1) - kC1 * x * rest(2),
                    projected.colour[c], 4 * kTolerance);
        EXPECT_NEAR(0.5 + kC0 * at_0[dc], rows[kColourRow + c], 4 * kTolerance);
      }
      EXPECT_NEAR(1 / (1 + std::exp(-at["opacity"])), projected.opacity, kTolerance);
    }
  }
}

}  // namespace
}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
#include "redrive/render/normals.h"

#include <cmath>

#include <gtest/gtest.h>

#include "redrive/camera/example_cameras_testing.h"

namespace redrive {
namespace {

constexpr float kLength = 4;  // length of the rays to the second plane, metres

/// Image of the plane normal . x = -distance on pixels left of `edge`, and of one that faces the
/// camera's pixels at kLength metres on the others; 0 where a ray misses.
RenderedImage image_of_planes(const RayTable& table, const Eigen::Vector3f& normal, float distance,
                              int edge) {
  const std::size_t pixels = static_cast<std::size_t>(table.width) * table.height;
  RenderedImage image;
  image.width = table.width;
  image.height = table.height;
  image.depth.assign(pixels, 0);
  image.opacity.assign(pixels, 0);
  for (std::size_t k = 0; k < table.pixel.size(); ++k) {
    const std::size_t i = table.pixel[k];
    const Eigen::Map<const Eigen::Vector3f> ray(&table.direction[3 * k]);
    const float depth =
        static_cast<int>(i % table.width) < edge ? -distance / normal.dot(ray) : kLength;
    if (!(depth > 0) || !(depth < 100)) continue;
    image.depth[i] = depth;
    image.opacity[i] = 1;
  }
  return image;
}

TEST(Normals, OfAPlaneAreExactInEveryCamera) {
  const Eigen::Vector3f normal = Eigen::Vector3f(0.1f, -0.9f, -0.4f).normalized();
  for (const ExampleCamera& example : example_cameras()) {
    const RayTable table = make_ray_table(example.camera);
    const RenderedImage image = image_of_planes(table, normal, 1.6f, table.width);
    const std::vector<float> normals = surface_normals(image, table);
    int found = 0;
    for (std::size_t k = 0; k < table.pixel.size(); ++k) {
      const std::size_t i = table.pixel[k];
      const Eigen::Map<const Eigen::Vector3f> at(&normals[3 * i]);
      if (image.opacity[i] == 0) {
        EXPECT_TRUE(at.isZero()) << example.name << i;
        continue;
      }
      if (at.isZero()) continue;  // no neighbour with a depth
      ++found;
      // A point errs by half an ulp of its distance, a tangent is two pixels' angle of it long and,
      // at grazing incidence, longer; the normal faces the camera.
      const Eigen::Map<const Eigen::Vector3f> ray(&table.direction[3 * k]);
      const float error = 8 * 6e-8f / table.pixel_angle / std::fabs(normal.dot(ray));
      ASSERT_LT((at - normal).norm(), 10 * error) << example.name << i;
    }
    EXPECT_GT(found, 1000) << example.name;
  }
}

TEST(Normals, AreNotBentByAnEdgeOfDepth) {
  const RayTable table = make_ray_table(example_cameras().front().camera);
  const Eigen::Vector3f normal(0, 0, -1);
  const int edge = 160;
  const RenderedImage image = image_of_planes(table, normal, 30, edge);
  const std::vector<float> normals = surface_normals(image, table);
  for (int y = 2; y < table.height - 2; ++y)
    for (int x = 2; x < edge; ++x)
      ASSERT_LT(
          (Eigen::Map<const Eigen::Vector3f>(&normals[3 * (y * table.width + x)]) - normal).norm(),
          1e-2f)
          << x << " " << y;
}

TEST(Normals, ImageHasXRightYUpAndZToTheCamera) {
  const RayTable table = make_ray_table(example_cameras().front().camera);
  const auto colour = [&](const Eigen::Vector3f& normal) {
    const Image8 image = normals_image(image_of_planes(table, normal, 2, table.width), table);
    const std::size_t middle = 3 * (static_cast<std::size_t>(table.height / 2) * table.width +
                                    static_cast<std::size_t>(table.width / 2));
    return std::array<int, 3>{image.rgb[middle], image.rgb[middle + 1], image.rgb[middle + 2]};
  };
  EXPECT_EQ(colour({0, 0, -1}), (std::array<int, 3>{128, 128, 255}));
  // A floor: its normal is up, -y.
  const std::array<int, 3> floor = colour(Eigen::Vector3f(0, -0.28f, -0.96f));
  EXPECT_EQ(floor, (std::array<int, 3>{128, 163, 250}));
}

TEST(Normals, AreZeroWhereNothingIsSeen) {
  const RayTable table = make_ray_table(example_cameras().front().camera);
  RenderedImage image = image_of_planes(table, {0, 0, -1}, 2, table.width);
  std::fill(image.opacity.begin(), image.opacity.end(), 0.4f);
  for (const float n : surface_normals(image, table)) ASSERT_EQ(n, 0);
}

}  // namespace
}  // namespace redrive

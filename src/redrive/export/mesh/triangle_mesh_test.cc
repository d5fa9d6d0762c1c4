// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/mesh/triangle_mesh.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "redrive/recording/parse/little_endian.h"

namespace redrive {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

/// Two triangles of a square, and one alone, which faces +x.
TriangleMesh example() {
  TriangleMesh mesh;
  for (const Eigen::Vector3f& p : std::initializer_list<Eigen::Vector3f>{
           {0, 0, 0}, {2, 0, 0}, {2, 2, 0}, {0, 2, 0}, {9, 0, 0}, {9, 1, 0}, {9, 0, 3}})
    mesh.vertices.push_back({p, Eigen::Vector3f::Zero(), {255, 0, 188}});
  mesh.triangles = {{0, 1, 2}, {0, 2, 3}, {4, 5, 6}};
  return mesh;
}

TEST(TriangleMesh, RemovesSmallPieces) {
  TriangleMesh mesh = example();
  remove_small_pieces(2, &mesh);
  EXPECT_THAT(mesh.triangles, ElementsAre(Triangle{0, 1, 2}, Triangle{0, 2, 3}));
  EXPECT_EQ(mesh.vertices.size(), 4u);
  remove_small_pieces(3, &mesh);
  EXPECT_TRUE(mesh.vertices.empty());
}

TEST(TriangleMesh, NormalsFollowTheOrderOfVertices) {
  TriangleMesh mesh = example();
  compute_normals(&mesh);
  EXPECT_EQ(mesh.vertices[0].normal, Eigen::Vector3f::UnitZ());
  EXPECT_EQ(mesh.vertices[6].normal, Eigen::Vector3f::UnitX());
}

TEST(TriangleMesh, PlyHasFacesBehindThePoints) {
  const TriangleMesh mesh = example();
  const std::string bytes = make_ply(mesh.vertices, true, mesh.triangles);
  EXPECT_THAT(bytes, HasSubstr("element face 3\nproperty list uchar int vertex_indices\n"));
  const std::size_t last = bytes.size() - 13;
  EXPECT_EQ(bytes[last], 3);
  for (int k = 0; k < 3; ++k)
    EXPECT_EQ(little_endian<std::int32_t>(bytes, last + 1 + 4 * static_cast<std::size_t>(k)),
              4 + k);
  const std::vector<Eigen::Vector3d> points = parse_ply(bytes, "mesh.ply");
  ASSERT_EQ(points.size(), 7u);
  EXPECT_EQ(points[6], Eigen::Vector3d(9, 0, 3));
}

TEST(TriangleMesh, ObjCountsFromOne) {
  const std::string text = make_obj(example());
  EXPECT_THAT(text, HasSubstr("v 9 0 3 1.0000 0.0000 0.7373\n"));
  EXPECT_THAT(text, HasSubstr("f 5 6 7\n"));
}

TEST(TriangleMesh, GlbHasItsUpAlongYAndLinearColours) {
  const std::string bytes = make_glb(example());
  EXPECT_EQ(bytes.substr(0, 4), "glTF");
  EXPECT_EQ(little_endian<std::uint32_t>(bytes, 4), 2u);
  EXPECT_EQ(little_endian<std::uint32_t>(bytes, 8), bytes.size());
  const std::size_t json_bytes = little_endian<std::uint32_t>(bytes, 12);
  EXPECT_EQ(json_bytes % 4, 0u);
  const nlohmann::json gltf = nlohmann::json::parse(bytes.substr(20, json_bytes));
  EXPECT_EQ(bytes.substr(24 + json_bytes, 4), std::string("BIN\0", 4));
  const std::size_t bin = 28 + json_bytes;
  EXPECT_EQ(gltf["buffers"][0]["byteLength"], bytes.size() - bin);
  EXPECT_EQ(gltf["accessors"][0]["max"], nlohmann::json({2, 3, 9}));
  // Vertex 6: x, y, z = 9, 0, 3.
  const std::size_t vertex = bin + 6 * 12;
  EXPECT_EQ(little_endian<float>(bytes, vertex), 0);
  EXPECT_EQ(little_endian<float>(bytes, vertex + 4), 3);
  EXPECT_EQ(little_endian<float>(bytes, vertex + 8), 9);
  const std::size_t colours = bin + gltf["bufferViews"][1]["byteOffset"].get<std::size_t>();
  EXPECT_EQ(little_endian<std::uint16_t>(bytes, colours), 65535);
  EXPECT_EQ(little_endian<std::uint16_t>(bytes, colours + 2), 0);
  EXPECT_NEAR(little_endian<std::uint16_t>(bytes, colours + 4), 0.5 * 65535, 400)
      << "sRGB 188 is half of the light";
}

}  // namespace
}  // namespace redrive

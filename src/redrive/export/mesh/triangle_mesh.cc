// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/mesh/triangle_mesh.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <numeric>

#include <Eigen/Geometry>
#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files/glb.h"
#include "redrive/optim/flip.h"

namespace redrive {
namespace {

constexpr auto kNoVertex = std::numeric_limits<std::uint32_t>::max();

/// Sets of vertices that triangles connect, as trees.
class Pieces {
 public:
  explicit Pieces(std::size_t vertices) : parent_(vertices) {
    std::iota(parent_.begin(), parent_.end(), 0u);
  }
  std::uint32_t root(std::uint32_t v) {
    while (parent_[v] != v) v = parent_[v] = parent_[parent_[v]];
    return v;
  }
  void join(std::uint32_t a, std::uint32_t b) { parent_[root(a)] = root(b); }

 private:
  std::vector<std::uint32_t> parent_;
};

template <class T>
void append(const T& value, std::string* bytes) {
  bytes->append(reinterpret_cast<const char*>(&value), sizeof value);
}

/// Returns a position in glTF's axes.
Eigen::Vector3f turned(const Eigen::Vector3f& p) { return {p.y(), p.z(), p.x()}; }

/// Sizes of a GLB's arrays, which follow each other.
struct GlbBytes {
  std::size_t positions, colours, indices;
  std::size_t all() const { return positions + colours + indices; }
};

/// Returns what a GLB's JSON says about its arrays.
nlohmann::json describe_glb(const TriangleMesh& mesh, const GlbBytes& bytes) {
  Eigen::Vector3f low = turned(mesh.vertices[0].position), high = low;
  for (const PlyPoint& vertex : mesh.vertices) {
    low = low.cwiseMin(turned(vertex.position));
    high = high.cwiseMax(turned(vertex.position));
  }
  constexpr int kFloat = 5126, kUnsignedShort = 5123, kUnsignedInt = 5125;
  constexpr int kArrayBuffer = 34962, kElementArrayBuffer = 34963, kTriangles = 4;
  return {{"asset", {{"version", "2.0"}, {"generator", "redrive"}}},
          {"extensionsUsed", {"KHR_materials_unlit"}},
          {"scene", 0},
          {"scenes", {{{"nodes", {0}}}}},
          {"nodes", {{{"mesh", 0}}}},
          {"meshes",
           {{{"primitives",
              {{{"attributes", {{"POSITION", 0}, {"COLOR_0", 1}}},
                {"indices", 2},
                {"material", 0},
                {"mode", kTriangles}}}}}}},
          {"materials",
           {{{"pbrMetallicRoughness", {{"metallicFactor", 0}, {"roughnessFactor", 1}}},
             {"doubleSided", true},
             {"extensions", {{"KHR_materials_unlit", nlohmann::json::object()}}}}}},
          {"accessors",
           {{{"bufferView", 0},
             {"componentType", kFloat},
             {"count", mesh.vertices.size()},
             {"type", "VEC3"},
             {"min", {low.x(), low.y(), low.z()}},
             {"max", {high.x(), high.y(), high.z()}}},
            {{"bufferView", 1},
             {"componentType", kUnsignedShort},
             {"normalized", true},
             {"count", mesh.vertices.size()},
             {"type", "VEC4"}},
            {{"bufferView", 2},
             {"componentType", kUnsignedInt},
             {"count", 3 * mesh.triangles.size()},
             {"type", "SCALAR"}}}},
          {"bufferViews",
           {{{"buffer", 0},
             {"byteOffset", 0},
             {"byteLength", bytes.positions},
             {"target", kArrayBuffer}},
            {{"buffer", 0},
             {"byteOffset", bytes.positions},
             {"byteLength", bytes.colours},
             {"target", kArrayBuffer}},
            {{"buffer", 0},
             {"byteOffset", bytes.positions + bytes.colours},
             {"byteLength", bytes.indices},
             {"target", kElementArrayBuffer}}}},
          {"buffers", {{{"byteLength", bytes.all()}}}}};
}

}  // namespace

void remove_small_pieces(std::size_t least, TriangleMesh* mesh) {
  Pieces pieces(mesh->vertices.size());
  for (const Triangle& t : mesh->triangles) {
    pieces.join(t[0], t[1]);
    pieces.join(t[0], t[2]);
  }
  std::vector<std::size_t> size(mesh->vertices.size());
  for (const Triangle& t : mesh->triangles) ++size[pieces.root(t[0])];
  std::erase_if(mesh->triangles,
                [&](const Triangle& t) { return size[pieces.root(t[0])] < least; });

  std::vector<std::uint32_t> now(mesh->vertices.size(), kNoVertex);
  for (const Triangle& t : mesh->triangles)
    for (const std::uint32_t v : t) now[v] = 0;
  std::vector<PlyPoint> kept;
  for (std::size_t v = 0; v < now.size(); ++v) {
    if (now[v] == kNoVertex) continue;
    now[v] = static_cast<std::uint32_t>(kept.size());
    kept.push_back(mesh->vertices[v]);
  }
  mesh->vertices = std::move(kept);
  for (Triangle& t : mesh->triangles)
    for (std::uint32_t& v : t) v = now[v];
}

void compute_normals(TriangleMesh* mesh) {
  for (PlyPoint& vertex : mesh->vertices) vertex.normal.setZero();
  for (const Triangle& t : mesh->triangles) {
    const Eigen::Vector3f& a = mesh->vertices[t[0]].position;
    const Eigen::Vector3f twice_area =
        (mesh->vertices[t[1]].position - a).cross(mesh->vertices[t[2]].position - a);
    for (const std::uint32_t v : t) mesh->vertices[v].normal += twice_area;
  }
  for (PlyPoint& vertex : mesh->vertices) vertex.normal.normalize();  // 0 stays 0
}

std::string make_obj(const TriangleMesh& mesh) {
  std::string text = "# redrive: x y z and r g b of each vertex\n";
  char line[128];
  for (const PlyPoint& vertex : mesh.vertices) {
    const Eigen::Vector3f& p = vertex.position;
    std::snprintf(line, sizeof line, "v %.7g %.7g %.7g %.4f %.4f %.4f\n", double(p.x()),
                  double(p.y()), double(p.z()), vertex.rgb[0] / 255.0, vertex.rgb[1] / 255.0,
                  vertex.rgb[2] / 255.0);
    text += line;
  }
  for (const Triangle& t : mesh.triangles) {
    std::snprintf(line, sizeof line, "f %u %u %u\n", t[0] + 1, t[1] + 1, t[2] + 1);
    text += line;
  }
  return text;
}

std::string make_glb(const TriangleMesh& mesh) {
  REDRIVE_CHECK(!mesh.triangles.empty());
  const std::size_t n = mesh.vertices.size();
  const GlbBytes sizes{n * 3 * sizeof(float), n * 4 * sizeof(std::uint16_t),
                       mesh.triangles.size() * sizeof(Triangle)};
  if (sizes.all() > kMostGlbBytes)
    throw UsageError("--voxel", "", "must be larger: a GLB holds 4 GiB");
  std::string bytes = glb_head(describe_glb(mesh, sizes), sizes.all());
  bytes.reserve(bytes.size() + sizes.all());
  for (const PlyPoint& vertex : mesh.vertices)
    for (const float x : turned(vertex.position)) append(x, &bytes);
  for (const PlyPoint& vertex : mesh.vertices) {
    for (const std::uint8_t c : vertex.rgb)
      append(static_cast<std::uint16_t>(std::lround(
                 65535 * linear_from_srgb<NumberMath<float>>(static_cast<float>(c) / 255))),
             &bytes);
    append(std::uint16_t{65535}, &bytes);
  }
  for (const Triangle& t : mesh.triangles) append(t, &bytes);
  return bytes;
}

}  // namespace redrive

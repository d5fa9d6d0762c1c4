// SPDX-License-Identifier: Apache-2.0
#include "redrive/model/gaussian_gltf.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files/glb.h"
#include "redrive/field/splat_numbers.h"

namespace redrive {
namespace {

constexpr int kPoints = 0, kFloat = 5126, kArrayBuffer = 34962;
constexpr const char* kExtension = "KHR_gaussian_splatting";

/// An attribute. In the buffer one follows the other.
struct Attribute {
  std::string name;
  int count;  ///< numbers of a Gaussian
  void (*numbers)(const SplatNumbers& of, double* out);

  const char* type() const { return count == 1 ? "SCALAR" : count == 3 ? "VEC3" : "VEC4"; }
};

template <int j>
void rest(const SplatNumbers& of, double* out) {
  for (int c = 0; c < 3; ++c) out[c] = of.rest[c][j];
}

std::vector<Attribute> attributes_of(int sh_degree) {
  const std::string prefix = std::string(kExtension) + ":";
  std::vector<Attribute> all = {
      {"POSITION", 3,
       [](const SplatNumbers& of, double* out) { std::ranges::copy(of.position, out); }},
      {prefix + "ROTATION", 4,
       [](const SplatNumbers& of, double* out) {
         for (int k = 0; k < 4; ++k) out[k] = of.quaternion[(k + 1) % 4];
       }},
      {prefix + "SCALE", 3,
       [](const SplatNumbers& of, double* out) {
         for (int k = 0; k < 3; ++k) out[k] = std::exp(of.log_scale[k]);
       }},
      {prefix + "OPACITY", 1,
       [](const SplatNumbers& of, double* out) { *out = 1 / (1 + std::exp(-of.opacity)); }},
      {prefix + "SH_DEGREE_0_COEF_0", 3,
       [](const SplatNumbers& of, double* out) { std::ranges::copy(of.dc, out); }}};
  if (sh_degree > 0) {
    all.push_back({prefix + "SH_DEGREE_1_COEF_0", 3, rest<0>});
    all.push_back({prefix + "SH_DEGREE_1_COEF_1", 3, rest<1>});
    all.push_back({prefix + "SH_DEGREE_1_COEF_2", 3, rest<2>});
  }
  return all;
}

nlohmann::json describe(const std::vector<Attribute>& attributes, std::size_t n,
                        const std::array<std::array<float, 3>, 2>& bounds) {
  nlohmann::json names, accessors, views;
  std::size_t offset = 0;
  for (const Attribute& attribute : attributes) {
    const std::size_t bytes = n * static_cast<std::size_t>(attribute.count) * sizeof(float);
    names[attribute.name] = accessors.size();
    views.push_back(
        {{"buffer", 0}, {"byteOffset", offset}, {"byteLength", bytes}, {"target", kArrayBuffer}});
    accessors.push_back({{"bufferView", accessors.size()},
                         {"componentType", kFloat},
                         {"count", n},
                         {"type", attribute.type()}});
    offset += bytes;
  }
  accessors[0]["min"] = bounds[0];
  accessors[0]["max"] = bounds[1];
  // A third of a turn about (1, 1, 1), as the meshes' (x, y, z) -> (y, z, x).
  constexpr std::array<double, 4> kTurn = {-0.5, -0.5, -0.5, 0.5};
  return {{"asset", {{"version", "2.0"}, {"generator", "redrive"}}},
          {"extensionsUsed", {kExtension}},
          {"scene", 0},
          {"scenes", {{{"nodes", {0}}}}},
          {"nodes", {{{"mesh", 0}, {"rotation", kTurn}}}},
          {"meshes",
           {{{"primitives",
              {{{"attributes", names},
                {"mode", kPoints},
                {"extensions",
                 {{kExtension,
                   {{"kernel", "ellipse"},
                    {"colorSpace", "srgb_rec709_display"},
                    {"projection", "perspective"},
                    {"sortingMethod", "cameraDistance"}}}}}}}}}}},
          {"accessors", accessors},
          {"bufferViews", views},
          {"buffers", {{{"byteLength", offset}}}}};
}

}  // namespace

std::string gaussian_gltf(const kernels::Gaussians& gaussians, int sh_degree) {
  REDRIVE_CHECK_OP(sh_degree, >=, 0);
  REDRIVE_CHECK_OP(sh_degree, <=, 1);
  const std::vector<Attribute> attributes = attributes_of(sh_degree);
  std::vector<std::vector<float>> numbers(attributes.size());
  std::size_t bytes = 0;
  for (const Attribute& attribute : attributes)
    bytes += gaussians.n * static_cast<std::size_t>(attribute.count) * sizeof(float);
  if (bytes > kMostGlbBytes)
    throw UsageError("--to", "splat-gltf", "holds 4 GiB, and the Gaussians take more");
  for (std::size_t i = 0; i < gaussians.n; ++i) {
    const SplatNumbers of = splat_numbers(gaussians.numbers, i);
    for (std::size_t a = 0; a < attributes.size(); ++a) {
      double out[4];
      attributes[a].numbers(of, out);
      for (int k = 0; k < attributes[a].count; ++k)
        numbers[a].push_back(static_cast<float>(out[k]));
    }
  }
  std::array<std::array<float, 3>, 2> bounds{};
  for (std::size_t i = 0; i < numbers[0].size(); ++i) {
    float &low = bounds[0][i % 3], &high = bounds[1][i % 3];
    low = i < 3 ? numbers[0][i] : std::min(low, numbers[0][i]);
    high = i < 3 ? numbers[0][i] : std::max(high, numbers[0][i]);
  }
  std::string file = glb_head(describe(attributes, gaussians.n, bounds), bytes);
  file.reserve(file.size() + bytes);
  for (const std::vector<float>& some : numbers)
    file.append(reinterpret_cast<const char*>(some.data()), some.size() * sizeof(float));
  return file;
}

}  // namespace redrive

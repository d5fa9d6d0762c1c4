// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/bundle/splatsim_scene.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>

#include <Eigen/Geometry>
#include <nlohmann/json.hpp>

#include "redrive/base/buffer.h"
#include "redrive/export/bundle/content_id.h"
#include "redrive/field/gaussian.h"
#include "redrive/math/local_level.h"
#include "redrive/math/wgs84.h"
#include "redrive/model/gaussian_spz.h"

namespace redrive {
namespace {

using Json = nlohmann::ordered_json;

/// Gaussians of a chunk: their indices.
using Chunk = std::vector<std::size_t>;

Eigen::Vector3d vector_at(std::span<const float> numbers, std::size_t i, int row, int step = 1) {
  return {numbers[gaussian_slot(i, row)], numbers[gaussian_slot(i, row + step)],
          numbers[gaussian_slot(i, row + 2 * step)]};
}

void set_vector(const Eigen::Vector3d& vector, std::size_t i, int row, Buffer<float>* numbers,
                int step = 1) {
  for (int k = 0; k < 3; ++k)
    (*numbers)[gaussian_slot(i, row + k * step)] = static_cast<float>(vector[k]);
}

/// Copies Gaussian `from` to `to`, moved by `pose`: its mean, its axes and its change of colour by
/// direction, which is a vector for each channel.
void copy_moved(std::span<const float> numbers, std::size_t from, const Rigid3d& pose,
                std::size_t to, Buffer<float>* moved) {
  for (int row = 0; row < kGaussianRows; ++row)
    (*moved)[gaussian_slot(to, row)] = numbers[gaussian_slot(from, row)];
  set_vector(pose * vector_at(numbers, from, kPositionRow), to, kPositionRow, moved);
  const auto q = [&](int k) -> double { return numbers[gaussian_slot(from, kQuaternionRow + k)]; };
  const Eigen::Quaterniond turned =
      Eigen::Quaterniond(pose.linear()) * Eigen::Quaterniond(q(0), q(1), q(2), q(3)).normalized();
  (*moved)[gaussian_slot(to, kQuaternionRow)] = static_cast<float>(turned.w());
  set_vector(turned.vec(), to, kQuaternionRow + 1, moved);
  for (int channel = 0; channel < 3; ++channel)
    set_vector(pose.linear() * vector_at(numbers, from, kHarmonicsRow + channel, 3), to,
               kHarmonicsRow + channel, moved, 3);
}

/// Gaussians by squares of the plane, each list of kSplatSimMost at most.
std::vector<Chunk> chunks_of(std::span<const float> numbers, std::size_t n, const Rigid3d& pose) {
  std::map<std::pair<int, int>, Chunk> squares;
  for (std::size_t i = 0; i < n; ++i) {
    const Eigen::Vector2d at =
        (pose * vector_at(numbers, i, kPositionRow)).head<2>() / kSplatSimChunk_m;
    squares[{static_cast<int>(std::floor(at.x())), static_cast<int>(std::floor(at.y()))}].push_back(
        i);
  }
  std::vector<Chunk> chunks;
  for (const auto& [square, all] : squares)
    for (std::size_t i = 0; i < all.size(); i += kSplatSimMost) {
      const auto begin = all.begin() + static_cast<std::ptrdiff_t>(i);
      chunks.emplace_back(
          begin, begin + static_cast<std::ptrdiff_t>(std::min(kSplatSimMost, all.size() - i)));
    }
  return chunks;
}

/// The only conventions that the schema allows.
Json frame_convention() {
  return {{"world", {{"handedness", "right"}, {"up_axis", "z"}, {"type", "ENU"}}},
          {"rig",
           {{"forward", "+x"}, {"left", "+y"}, {"up", "+z"}, {"origin", "ground_under_rear_axle"}}},
          {"camera", {{"model_axes", "opencv_+z_forward"}}},
          {"lidar", {{"axes", "+x_forward_+y_left_+z_up"}}},
          {"quaternion_order", "xyzw"},
          {"matrix_layout", "row_major"},
          {"vector_convention", "column_vector_child_to_parent"},
          {"length_units", "meters"},
          {"time_units", "microseconds"}};
}

Json rows_of(const Rigid3d& pose) {
  Json rows = Json::array();
  for (int row = 0; row < 4; ++row) {
    const Eigen::RowVector4d r = pose.matrix().row(row);
    rows.push_back({r[0], r[1], r[2], r[3]});
  }
  return rows;
}

constexpr const char* kStage = R"(#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 1
    upAxis = "Z"
)

def Xform "World"
{
    custom asset sceneIndex = @./scene.json@
}
)";

}  // namespace

SplatSimScene make_splatsim_scene(const SplatSimInput& input) {
  const std::span<const float> numbers = input.gaussians.numbers;
  Rigid3d anchor = Rigid3d::Identity(), world_from_gaussians = Rigid3d::Identity();
  if (input.ecef_from_gaussians) {
    const Eigen::Vector3d at = input.ecef_from_gaussians->translation();
    anchor = ecef_from_enu(geodetic_from_ecef(at.x(), at.y(), at.z()));
    world_from_gaussians = anchor.inverse(Eigen::Isometry) * *input.ecef_from_gaussians;
  }
  std::vector<std::pair<std::string, std::string>> files;
  Json index = Json::array();
  std::uint64_t hash = hash_of("");
  for (const Chunk& chunk : chunks_of(numbers, input.gaussians.n, world_from_gaussians)) {
    Buffer<float> moved(gaussian_blocks(chunk.size()) * kBlockSize);
    Eigen::AlignedBox3d box;
    for (std::size_t i = 0; i < chunk.size(); ++i) {
      copy_moved(numbers, chunk[i], world_from_gaussians, i, &moved);
      box.extend(vector_at(moved, i, kPositionRow));
    }
    char name[64];
    std::snprintf(name, sizeof name, "chunks/chunk_%06zu.spz", files.size());
    index.push_back({{"uri", name},
                     {"n_points", chunk.size()},
                     {"bbox_min", {box.min().x(), box.min().y(), box.min().z()}},
                     {"bbox_max", {box.max().x(), box.max().y(), box.max().z()}}});
    kernels::Gaussians of_chunk;
    of_chunk.n = chunk.size();
    of_chunk.numbers = moved;
    files.emplace_back(name, gaussian_spz(of_chunk, input.sh_degree));
    hash = hash_of(files.back().second, hash);
  }
  const Json metadata = {{"uuid", uuid_of(hash)},
                         {"scene_id", input.scene_id},
                         {"version_string", "redrive/" + input.version}};
  const Json scene = {
      {"schema", "splatsim.scene/v3"},
      {"producer", {{"tool", "redrive"}, {"tool_version", input.version}}},
      {"world", {{"frame_convention", frame_convention()}, {"ecef_anchor", rows_of(anchor)}}},
      {"gaussians",
       {{"chunk_format", "spz/ngsp-v3"},
        {"chunks", index},
        {"n_gaussians", input.gaussians.n},
        {"sh_degree", input.sh_degree},
        {"frame", "world"}}},
      {"extras", Json::object()},
      {"render_defaults", {{"exposure", 1.0}, {"near_plane", 0.1}, {"far_plane", 1000.0}}}};
  SplatSimScene out;
  out.chunks = files.size();
  out.members = {{"default.usda", kStage},
                 {"metadata.yaml", metadata.dump(1) + "\n"},  // JSON is YAML, too
                 {"scene.json", scene.dump(1) + "\n"}};
  std::ranges::move(files, std::back_inserter(out.members));
  return out;
}

}  // namespace redrive

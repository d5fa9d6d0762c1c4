// SPDX-License-Identifier: Apache-2.0
// A scene of SplatSim, the renderer of Autoware's simulators (TIER IV): a USDZ with
//
//   default.usda   names scene.json
//   metadata.yaml  uuid, scene_id, version_string
//   scene.json     schema splatsim.scene/v3: frames, place on the Earth, chunks
//   chunks/chunk_NNNNNN.spz   Gaussians of a square of the plane (model/gaussian_spz.h)
//
// The layout follows 3dgs_io, TIER IV's reader and writer. Its own writer makes SPZ of version 4;
// these are of version 3, which the same library reads.
#pragma once

#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "redrive/kernels/gaussian/gaussian_stages.h"
#include "redrive/math/rigid3.h"

namespace redrive {

/// Side of a chunk's square, and its most Gaussians.
inline constexpr double kSplatSimChunk_m = 50;
inline constexpr std::size_t kSplatSimMost = 200'000;

struct SplatSimInput {
  std::string scene_id, version;  ///< redrive's version
  kernels::Gaussians gaussians;
  int sh_degree = 1;                           ///< 0 or 1
  std::optional<Rigid3d> ecef_from_gaussians;  ///< nothing: the place on the Earth is not known
};

struct SplatSimScene {
  std::vector<std::pair<std::string, std::string>> members;  ///< names and bytes, in their order
  std::size_t chunks = 0;
};

/// The scene's world has the Gaussians' origin, x to the east and y to the north. Without a place
/// on the Earth it has their axes, too, whose z must point up.
SplatSimScene make_splatsim_scene(const SplatSimInput& input);

}  // namespace redrive

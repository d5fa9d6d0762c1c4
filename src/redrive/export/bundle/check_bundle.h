// SPDX-License-Identifier: Apache-2.0
// Checks a scene bundle of any origin for the members and fields that the loaders of AlpaSim and
// CARLA read (AlpaSim's alpasim_utils/artifact.py and scenario.py, CARLA's
// examples/nvidia/nurec/scenario.py and nurec_integration.py, 2026-11).
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

namespace redrive {

struct BundleGap {
  std::string member, field;  ///< field: empty for the whole member
  std::string what;
};

struct BundleReport {
  struct Member {
    std::string name;
    std::uint64_t bytes = 0;
  };
  std::string scene_id;                   ///< from metadata.yaml or data_info.json; empty: none
  std::vector<Member> members;            ///< sorted by name
  std::vector<BundleGap> alpasim, carla;  ///< gaps that keep them from opening it
  std::vector<BundleGap> remarks;         ///< gaps that they accept
  bool has_run = false;                   ///< redrive's run is inside
  std::string run_damage;                 ///< why the run cannot be rendered; empty: it can
};

/// InputError if it is no zip, or damaged.
BundleReport check_bundle(const std::filesystem::path& file);

}  // namespace redrive

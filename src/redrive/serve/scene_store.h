// SPDX-License-Identifier: Apache-2.0
// Runs and scene bundles by their ids, opened when they are asked for.
#pragma once

#include <cstdint>
#include <filesystem>
#include <list>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "redrive/render/run_renderer.h"

namespace redrive::serve {

/// An opened run. Whoever renders holds the mutex.
struct OpenScene {
  std::shared_ptr<const Run> run;
  RunRenderer renderer;
  std::mutex rendering;
  std::uint64_t bytes = 0;  ///< an estimate of its memory

  OpenScene(std::shared_ptr<const Run> opened, const kernels::BackendChoice& backend)
      : run(std::move(opened)), renderer(run, backend) {}
};

/// Usable from several threads at once.
class SceneStore {
 public:
  /// `runs`: runs, scene bundles (export/bundle/scene_bundle.h), or folders of them. A scene's id
  /// is the name of its folder, in a bundle its sequence_id. What cannot be rendered is left out of
  /// a folder. UsageError where there is none, or where two have the same id; InputError for one
  /// that is named and cannot be rendered.
  SceneStore(const std::vector<std::filesystem::path>& runs, kernels::BackendChoice backend,
             std::uint64_t memory);

  std::vector<std::string> ids() const;
  /// Reasons why runs and bundles of a folder are left out.
  const std::vector<std::string>& left_out() const { return left_out_; }
  /// Ids of the scenes in memory, the last used first.
  std::vector<std::string> open_ids();
  /// Returns a scene, and closes those that were not used for longest where memory is short; they
  /// live on while somebody renders. RequestError: kNotFound, kResourceExhausted. Errors as
  /// open_to_render.
  std::shared_ptr<OpenScene> get(const std::string& id);

 private:
  struct Known {
    std::string id;
    std::filesystem::path root;
  };
  struct Open {
    std::string id;
    std::shared_ptr<OpenScene> scene;
  };
  std::shared_ptr<OpenScene> find(const std::string& id);

  std::vector<Known> known_;  ///< sorted by id
  std::vector<std::string> left_out_;
  kernels::BackendChoice backend_;
  std::uint64_t memory_;
  std::mutex opening_;  ///< one scene is opened at a time
  std::mutex mutex_;    ///< for open_
  std::list<Open> open_;
};

}  // namespace redrive::serve

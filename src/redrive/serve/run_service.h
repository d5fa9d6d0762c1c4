// SPDX-License-Identifier: Apache-2.0
// Answers a simulator's requests from runs.
#pragma once

#include "redrive/serve/scene_store.h"
#include "redrive/serve/sensor_service.h"

namespace redrive::serve {

class RunService : public SensorService {
 public:
  /// The store must outlive it.
  explicit RunService(SceneStore* store) : store_(*store) {}

  std::vector<std::string> scenes() const override { return store_.ids(); }
  std::vector<std::string> loaded_scenes() const override { return store_.open_ids(); }
  std::vector<SceneCamera> cameras(const std::string& scene) override;
  std::vector<TimedPose> trajectory(const std::string& scene) override;
  std::vector<ImageAnswer> images(std::span<const ImageQuery> queries,
                                  const Cancelled& cancelled) override;
  ScanAnswer scan(const ScanQuery& query, const Cancelled& cancelled) override;

 private:
  SceneStore& store_;
};

}  // namespace redrive::serve

// SPDX-License-Identifier: Apache-2.0
// A run opened once and asked for images of any camera at any pose and time, with any traffic.
#pragma once

#include <cstdint>
#include <list>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "redrive/edit/edit_actors.h"
#include "redrive/render/renderer.h"
#include "redrive/train/run.h"

namespace redrive {

/// An image of a run.
struct ImageRequest {
  RigCamera camera;  ///< one of the run, or any other: lens and readout
  /// In the world: one pose, or several at even times from the upper edge of the image to the lower
  /// one, for a rolling shutter.
  std::vector<Rigid3d> world_from_camera;
  /// Exposure of the middle row: moving objects stand where they are then.
  std::int64_t exposed_ns = 0;
  Exposure exposure;
  bool labelled = false;  ///< RenderedImage::labelled, by the actors; ids leave out their shadows
};

/// Gives pixels of a labelled image that show an object's shadow or light to the static world.
void leave_out_shadows(const RayTable& rays, const ShutterPoses& poses, const Scene& traffic,
                       RenderedImage* image);

/// Applies an edit to the moving objects of the scene of the field's run and keeps the objects that
/// `actors` names (select_actors). Returns remarks. Throws what check_added, edit_actors and
/// select_actors throw.
std::vector<std::string> change_traffic(const Field& field, const std::optional<TrafficEdit>& edit,
                                        std::string_view actors, Scene* scene,
                                        ActorBodies* bodies = nullptr);

/// To use by one thread at a time.
class RunRenderer {
 public:
  /// `run`: has a field. UsageError as make_backend.
  RunRenderer(std::shared_ptr<const Run> run, const kernels::BackendChoice& backend);

  const Run& run() const { return *run_; }
  kernels::Backend& backend() { return *backend_; }

  /// Returns the run's scene with changed traffic (change_traffic). A body's file is read once.
  Scene with_traffic(const std::optional<TrafficEdit>& edit, std::string_view actors,
                     std::vector<std::string>* remarks);

  /// `traffic`: the run's scene, or what with_traffic returned. UsageError as
  /// check_rendering_memory.
  RenderedImage image(const ImageRequest& request, const Scene& traffic);
  RenderedImage image(const ImageRequest& request) { return image(request, run_->scene); }

  /// Returns the rays of a camera's pixels, which are kept for its next images.
  std::shared_ptr<const RayTable> rays(const Camera& camera);

 private:
  std::shared_ptr<const Run> run_;
  std::unique_ptr<kernels::Backend> backend_;
  ActorBodies bodies_;
  std::list<std::shared_ptr<const RayTable>> tables_;  ///< last used first
};

}  // namespace redrive

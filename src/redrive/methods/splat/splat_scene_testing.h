// SPDX-License-Identifier: Apache-2.0
// For tests of method splat: a scene in memory.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "redrive/model/trainee.h"
#include "redrive/scene/lidar/lidar_testing.h"

namespace redrive {

/// Cameras and views are added, then finish() makes black images and the sampler.
struct SplatScene {
  Scene scene;
  std::vector<Image8> images;
  LidarReturns lidar;
  std::optional<PixelSampler> pixels;

  RigCamera& rig(int camera) { return scene.rig[camera]; }
  /// The camera looks along the body's z axis. Returns its index.
  int add_camera(const std::string& name, const std::string& model,
                 const std::vector<double>& parameters, int width, int height) {
    RigCamera camera;
    camera.name = name;
    camera.camera = make_camera({name, model, parameters, width, height, Rigid3d::Identity()});
    camera.recorded = camera.camera;
    camera.body_from_sensor = Rigid3d::Identity();
    scene.rig.push_back(camera);
    return static_cast<int>(scene.rig.size()) - 1;
  }
  /// Each view has a frame of its own, 0.1 s after the one before.
  void add_view(int camera, const Rigid3d& world_from_body, bool held_out = false) {
    const auto n = static_cast<int>(scene.frames.size());
    scene.add_frame({n, 100'000'000ll * n, world_from_body});
    View view;
    view.camera = camera;
    view.frame = n;
    view.held_out = held_out;
    scene.views.push_back(view);
  }
  void finish() {
    for (const View& view : scene.views) {
      const Camera& camera = scene.rig[view.camera].camera;
      Image8 image;
      if (!view.held_out) {
        image.width = camera.width;
        image.height = camera.height;
        image.rgb.assign(3 * static_cast<std::size_t>(camera.width) * camera.height, 0);
      }
      images.push_back(image);
    }
    pixels.emplace(scene, images, 1);
  }
  TrainingSet data() const { return {scene, images, lidar, *pixels}; }
};

}  // namespace redrive

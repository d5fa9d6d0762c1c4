// SPDX-License-Identifier: Apache-2.0
// Interface of a field: what renders images, traces rays and exports. A trained model is one
// (trainee.h), and so is a drive in blocks (render/divided_field.h).
#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <vector>

#include "redrive/kernels/backend.h"
#include "redrive/model/field_gaussians.h"
#include "redrive/model/rendered_image.h"
#include "redrive/rays/ray_table.h"
#include "redrive/scene/scene.h"

namespace redrive {

struct ExportOptions {
  int sh_degree = 1;  ///< degree of the colours' spherical harmonics, at most: 0 or 1
  /// Object whose Gaussians are written instead of the world's, in the axes of its box
  /// (edit/actor_body.h); one that the field draws. Null: none.
  const MovingObject* actor = nullptr;
};

/// A file format of other programs to which a field can be written.
struct ExportFormat {
  std::string name;                                         ///< value of --to
  std::string help;                                         ///< one line
  std::function<std::string(const ExportOptions&)> encode;  ///< returns the bytes of the file
  std::string zip_member;  ///< where the file is a zip (USDZ), the member with these bytes
};

/// Threads with a backend each may share a const field, unless its class says otherwise.
class Field {
 public:
  virtual ~Field() = default;

  virtual const char* method() const = 0;    ///< Method::name
  virtual std::string describe() const = 0;  ///< human-readable sizes and samples
  /// Promises that the field will not change any more: a device may keep a copy of it.
  virtual void freeze() {}
  /// Whether Scene::actors are drawn; otherwise moving objects are masked.
  virtual bool draws_actors() const { return false; }

  /// Renders the image of `rays.camera`: colour, depth in metres along the ray and opacity.
  /// Resizes `image` and writes every pixel; reuses its memory.
  virtual void render_to(kernels::Backend& backend, const RayTable& rays,
                         const ShutterPoses& world_from_camera, const Exposure& exposure,
                         RenderedImage* image) const = 0;
  RenderedImage render(kernels::Backend& backend, const RayTable& rays,
                       const ShutterPoses& world_from_camera, const Exposure& exposure) const {
    RenderedImage image;
    render_to(backend, rays, world_from_camera, exposure, &image);
    return image;
  }
  /// Renders single rays in world metres, each with its own origin, such as a LiDAR's beams. Moving
  /// objects stand where they are at the rays' times, which must be given if there are any. Fields
  /// without moving objects ignore them.
  virtual RenderedRays trace(kernels::Backend& backend, const kernels::Rays& rays,
                             const std::vector<MovingObject>& actors = {}) const = 0;

  /// Returns the field as the Gaussians that it consists of; null: it consists of something else.
  virtual const FieldGaussians* as_gaussians() const { return nullptr; }
  /// Returns the formats that this field can be exported to: files of Gaussians, where it has any.
  /// They refer to the field.
  virtual std::vector<ExportFormat> export_formats() const;
};

}  // namespace redrive

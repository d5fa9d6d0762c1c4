// SPDX-License-Identifier: Apache-2.0
// Labels of rendered images in COCO's JSON: 2D boxes, masks, occlusion, truncation; and optical
// flow.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "redrive/kernels/backend.h"
#include "redrive/model/rendered_image.h"
#include "redrive/rays/ray_table.h"
#include "redrive/scene/scene.h"

namespace redrive {

/// A rectangle of pixels, edges in pixel units: pixel (x, y) covers [x, x + 1] x [y, y + 1].
struct PixelBox {
  double left = 0, top = 0, right = 0, bottom = 0;

  double area() const { return std::max(right - left, 0.0) * std::max(bottom - top, 0.0); }
};
/// Intersection over union, 0..1.
double overlap(const PixelBox& a, const PixelBox& b);

/// Returns the lengths of runs of pixels that do not have `number` and that do, in turn, down the
/// columns: COCO's uncompressed RLE. within: columns outside it have no such pixel.
std::vector<std::uint32_t> run_lengths(const std::vector<std::uint16_t>& ids, int width, int height,
                                       int number, const PixelBox& within);

/// Returns the box around the projected corners of a moving object's box, which may reach beyond
/// the image; nothing where the lens does not see all of them.
std::optional<PixelBox> projected_box(const Camera& camera, bool by_column,
                                      const ShutterPoses::Actor& actor,
                                      const Eigen::Vector3d& size_m);

/// Returns COCO's annotations of a labelled image, one for each moving object with a visible pixel:
/// "track_id" (MovingObject::id), "category" (its type), "bbox" [x, y, width, height] of
/// what is visible, "whole_bbox" likewise as if nothing were before it, beyond the image where the
/// object is, "area" in pixels, "segmentation" (run_lengths), "occlusion" (share of its pixels in
/// the image that others hide) and "truncation" (share of whole_bbox outside the image), 0..1. What
/// whole_bbox has within the image is rendered; what is beyond follows from the object's 3D box.
nlohmann::json annotations_of(const RenderedImage& image, const Camera& camera,
                              const ShutterPoses& poses, const Scene& scene);

/// Merges images, {"file_name", "width", "height", "annotations", ...} each, into COCO's document.
nlohmann::json coco_document(const std::vector<nlohmann::json>& images);

/// Horizontal and vertical motion of a pixel that is not known (Middlebury's .flo).
constexpr float kUnknownFlow = 1e10f;

/// Returns where each pixel's surface is in a later image of the camera, minus the pixel: [height,
/// width, 2] pixels, from depth, ids and the motions of camera and objects. Unknown outside the
/// lens, at objects that are no more, and where the surface leaves what the lens can see. What is
/// transparent is infinitely far.
std::vector<float> optical_flow(const RenderedImage& image, const RayTable& rays,
                                const ShutterPoses& now, const ShutterPoses& later,
                                kernels::Backend& backend);
/// Returns the bytes of a .flo file (Baker et al. 2011).
std::string make_flo(const std::vector<float>& flow, int width, int height);

}  // namespace redrive

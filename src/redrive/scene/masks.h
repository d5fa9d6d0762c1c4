// SPDX-License-Identifier: Apache-2.0
// Which pixels of the pictures show the static world. What is left out is of two kinds: what is the
// same in all pictures of a camera (the vehicle that carries it, broken rows, the black around a
// fisheye's image circle), kept as one editable PNG a camera, and annotated objects that move,
// which each picture has elsewhere.
#pragma once

#include <cstdint>
#include <filesystem>
#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/image/image.h"
#include "redrive/scene/moving_objects.h"
#include "redrive/scene/scene.h"

namespace redrive {

/// [height, width]: 1 used, 0 left out.
struct Mask {
  int width = 0, height = 0;
  std::vector<std::uint8_t> used;

  std::size_t left_out() const;
};

Mask full_mask(int width, int height);  ///< all used

/// The mask of `camera` at the size it is trained on, from an 8-bit PNG of the size it was recorded
/// at, so that one file serves runs of any --downscale: white (128 and more) used, black left out;
/// a pixel is used if all that it is the average of are. With --undistort it belongs to the
/// undistorted pictures, which have the same size. InputError for another size.
Mask read_mask(const std::filesystem::path& file, const RigCamera& camera, int downscale);
void write_mask(const std::filesystem::path& file, const Mask& mask, const RigCamera& camera,
                int downscale);

/// What is the same in all pictures of one camera of the rig, from those of its views that are not
/// held out, at the size they are trained on. images[i] belongs to scene.views[i]. See
/// ego_outline.h; with too few views or too little driving only the image circle and broken rows
/// are looked for. `on_car`: the body is that of a car that drives on its x-y plane; what is no car
/// (a hand-held camera, an object on a table) has neither vehicle nor broken rows.
Mask find_static_mask(const Scene& scene, int camera, const std::vector<Image8>& images,
                      bool on_car);

/// FOLDER/<CAM>.png.
std::filesystem::path mask_file(const std::filesystem::path& folder, const RigCamera& camera);

/// By camera of the rig: FOLDER/<CAM>.png where that exists, else found. `folder` may be empty.
/// InputError as read_mask.
std::vector<Mask> static_masks(const Scene& scene, const std::vector<Image8>& images,
                               const std::filesystem::path& folder, ThreadPool& pool, bool on_car);

/// Masks by camera of the rig: the mask_file of each that leaves something out. It must exist; a
/// camera without a file has a full mask.
void write_masks(const std::filesystem::path& folder, const std::vector<Mask>& masks,
                 const Scene& scene);
/// InputError as read_mask.
std::vector<Mask> read_masks(const std::filesystem::path& folder, const Scene& scene);

/// A camera's mask without the pixels whose rays meet an annotated moving object when the picture
/// of `view` was exposed.
Mask view_mask(const Scene& scene, const View& view, const Mask& of_camera,
               const MovingObjects& moving);

/// Adds what the mask leaves out to what the picture's own mask does (Image8::used): it is neither
/// trained on nor scored.
void apply_mask(const Mask& mask, Image8* image);
/// The same for the pictures of all views that are not held out, each with its view_mask; images[i]
/// belongs to scene.views[i].
void apply_masks(const Scene& scene, const std::vector<Mask>& camera_masks,
                 const MovingObjects& moving, ThreadPool& pool, std::vector<Image8>* images);

/// The picture with what is left out tinted red, to look at.
Image8 overlay(const Image8& image, const Mask& mask);

}  // namespace redrive

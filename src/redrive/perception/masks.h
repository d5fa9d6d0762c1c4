// SPDX-License-Identifier: Apache-2.0
// Masks of the pixels that show the static world. Two kinds of pixels are masked: constant pixels
// of a camera (the ego vehicle, broken rows, the black around a fisheye's image circle), stored as
// one editable PNG per camera, and annotated moving objects, per image.
#pragma once

#include <cstdint>
#include <filesystem>
#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/image/image.h"
#include "redrive/scene/load_views.h"
#include "redrive/scene/moving_objects.h"
#include "redrive/scene/scene.h"

namespace redrive {

/// [height, width]: 1 used, 0 masked.
struct Mask {
  int width = 0, height = 0;
  std::vector<std::uint8_t> used;

  std::size_t left_out() const;
};

Mask full_mask(int width, int height);  ///< nothing masked

/// Reads the mask of `camera` at the size of training from an 8-bit PNG of the recorded size, so
/// that one file serves runs of any --downscale: white (128 and more) used, black masked; a
/// downscaled pixel is used if all pixels it averages are. With --undistort it belongs to the
/// undistorted images, which have the same size. InputError for another size.
Mask read_mask(const std::filesystem::path& file, const RigCamera& camera, int downscale);
void write_mask(const std::filesystem::path& file, const Mask& mask, const RigCamera& camera,
                int downscale);

/// Finds the static mask of a camera of the rig in its training images, at the size of training.
/// images[i] belongs to scene.views[i]. See ego_outline.h; with too few views or too little driving
/// it has only the image circle and broken rows. `on_car`: the body is a car that drives on its x-y
/// plane; otherwise (hand-held cameras, an object on a table) neither vehicle nor broken rows are
/// searched.
Mask find_static_mask(const Scene& scene, int camera, const std::vector<Image8>& images,
                      bool on_car);

/// FOLDER/<CAM>.png.
std::filesystem::path mask_file(const std::filesystem::path& folder, const RigCamera& camera);

/// Returns the static mask of each camera of the rig: FOLDER/<CAM>.png where that exists, else
/// find_static_mask. `folder` may be empty. InputError as read_mask.
std::vector<Mask> static_masks(const Scene& scene, const std::vector<Image8>& images,
                               const std::filesystem::path& folder, ThreadPool& pool, bool on_car);

/// The same for images that are not in memory; loads the images that a camera's mask is found in.
std::vector<Mask> static_masks(const Scene& scene, const ViewLoader& load,
                               const std::filesystem::path& folder, ThreadPool& pool, bool on_car);
/// Maximum number of a camera's training views in which its mask is searched; more add little.
constexpr std::size_t kMostMaskViews = 50;

/// Writes the mask_file of each camera whose mask masks a pixel. The folder must exist. read_masks
/// gives cameras without a file a full mask.
void write_masks(const std::filesystem::path& folder, const std::vector<Mask>& masks,
                 const Scene& scene);
/// InputError as read_mask.
std::vector<Mask> read_masks(const std::filesystem::path& folder, const Scene& scene);

/// Returns the camera's mask and masks the pixels whose rays intersect an annotated moving object
/// when `view` was exposed.
Mask view_mask(const Scene& scene, const View& view, const Mask& of_camera,
               const MovingObjects& moving);

/// Returns which moving object the ray of each pixel meets when `view` was exposed, the one with
/// the nearest centre if there are several: its index in moving.objects() plus 1, 0 for none;
/// [height, width].
std::vector<std::uint32_t> object_map(const Scene& scene, const View& view,
                                      const MovingObjects& moving);

/// Marks pixels of training images that may show one of the objects as kMovingPixel, unless they
/// are masked.
void mark_objects(const Scene& scene, const MovingObjects& objects, ThreadPool& pool,
                  std::vector<Image8>* images);

/// Adds the mask to the image's own (Image8::used): masked pixels are neither trained on nor
/// scored.
void apply_mask(const Mask& mask, Image8* image);
/// Applies its view_mask to each training view. images[i] belongs to scene.views[i].
void apply_masks(const Scene& scene, const std::vector<Mask>& camera_masks,
                 const MovingObjects& moving, ThreadPool& pool, std::vector<Image8>* images);

/// Applies masks and marks objects in the image of one view at a time, from any thread.
class ViewMasker {
 public:
  /// `of_cameras`: masks of the rig's cameras, none: no pixel is masked; `masked`: objects whose
  /// pixels are masked; `marked`: as mark_objects. The scene must outlive it.
  ViewMasker(const Scene& scene, std::vector<Mask> of_cameras, MovingObjects masked,
             MovingObjects marked, ThreadPool& pool);
  void apply(const View& view, Image8* image) const;

 private:
  const Scene& scene_;
  std::vector<Mask> of_cameras_;
  MovingObjects masked_, marked_;
  /// directions of the pixels, one list per camera
  std::vector<std::vector<Eigen::Vector3f>> directions_;
};

/// Returns the image with masked pixels tinted red.
Image8 overlay(const Image8& image, const Mask& mask);

}  // namespace redrive

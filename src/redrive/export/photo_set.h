// SPDX-License-Identifier: Apache-2.0
// A recording as posed photographs, as COLMAP and nerfstudio have them: an image has one pose and a
// camera. Lists what does not fit.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "redrive/image/image.h"
#include "redrive/recording/core/recording.h"
#include "redrive/scene/resample.h"
#include "redrive/scene/scene.h"

namespace redrive {

struct PhotoCamera {
  CameraCalibration calibration;  ///< name and intrinsics of the images that are written
  Camera camera;                  ///< camera of the written images
  Camera recorded;                ///< camera of the recorded images
  bool resampled = false;         ///< whether they differ
  /// Rotation between the axes of both.
  Eigen::Matrix3d recorded_from_written = Eigen::Matrix3d::Identity();
};

struct Photo {
  std::filesystem::path name;    ///< relative, in the folder of the images
  std::filesystem::path source;  ///< the recorded image
  int camera = 0;                ///< index into PhotoSet::cameras
  /// pose at the exposure of the middle row; x right, y down, z forward
  Rigid3d world_from_camera;
  MaskFile mask;
  bool held_out = false;
};

struct PhotoSet {
  std::vector<PhotoCamera> cameras;
  std::vector<Photo> photos;          ///< ordered by camera, then frame
  Rigid3d world_from_scene;           ///< Scene's world in the set's
  std::string world;                  ///< description of the axes of the set's world
  std::vector<std::string> left_out;  ///< what the set cannot express, or expresses in another form
};

/// Returns the camera of the written images: the recorded one where `has_model` allows it, else one
/// that COLMAP and nerfstudio have, at the same place with the same size, to which images are
/// resampled.
PhotoCamera photo_camera(const CameraCalibration& recorded,
                         const std::function<bool(const CameraCalibration&)>& has_model);

/// Returns the camera of images by a pinhole without distortion: the recorded one, or one at the
/// same place with the same size whose every pixel the recorded lens sees, of 100 degrees across
/// where that one is no perspective lens. `body_from_written`: axes of the written images;
/// nothing: the camera is not turned.
PhotoCamera pinhole_photo_camera(const CameraCalibration& recorded,
                                 const std::optional<Eigen::Matrix3d>& body_from_written = {});

/// Returns the views of a scene as photographs at the size they were recorded with. The world of a
/// drive is the scene's; other recordings keep their own. `has_model` says whether the format has
/// exactly this camera: images of others are to be resampled to a pinhole without distortion, or,
/// where the lens is no perspective one, to an equidistant opencv_fisheye with the same centre and
/// resolution there.
PhotoSet make_photo_set(const Recording& recording, const Scene& scene,
                        const std::function<bool(const CameraCalibration&)>& has_model);

/// The map of a resampled camera and the pixels that it sees.
struct Resampling {
  ResampleMap map;
  std::vector<std::uint8_t> seen;  ///< [height, width], 255 or 0
  bool sees_all = true;
};

Resampling make_resampling(const PhotoCamera& camera);

/// Returns a recorded image as the written camera sees it. InputError if it cannot be read or has
/// another size than the calibration.
Image8 resampled_image(const std::filesystem::path& recorded, const PhotoCamera& camera,
                       const Resampling& resampling);

struct WrittenMask {
  int width = 0, height = 0;
  std::vector<std::uint8_t> used;  ///< [height, width], 255; 0: masked
};

/// Returns which pixels of a written image the recorded mask and the resampling leave; nothing
/// where all are. `resampling`: null where images are written as recorded. InputError if the mask
/// cannot be read.
std::optional<WrittenMask> written_mask(const MaskFile& mask, const Resampling* resampling);

}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
// Writes folders of posed photographs for COLMAP, nerfstudio and programs that read their formats.
#pragma once

#include <atomic>

#include "redrive/base/parallel.h"
#include "redrive/export/photo_set.h"
#include "redrive/scene/point_cloud.h"

namespace redrive {

/// Maximum number of points that are written, thinned evenly.
constexpr std::size_t kMaxExportedPoints = 1'000'000;
/// Returns n >= 1; every n-th point is written.
std::size_t exported_every(const PointCloud& points);

/// Whether COLMAP, or nerfstudio's transforms.json, has exactly this camera.
bool is_colmap_camera(const CameraCalibration& calibration);
bool is_transforms_camera(const CameraCalibration& calibration);

/// Whether a set of transforms cameras has pinholes and fisheyes, which nerfstudio cannot read as
/// one set.
bool has_two_kinds_of_lenses(const PhotoSet& set);

/// Writes the photos by their names below `images`: copies of the recorded files where neither lens
/// nor extension differ. Writes masks (<name>.png, black is masked) below `masks`, none if that is
/// empty. Throws as write_colmap.
void write_images(const std::filesystem::path& images, const std::filesystem::path& masks,
                  const PhotoSet& set, ThreadPool& pool, const std::atomic<bool>& stop);
/// Creates a folder and its parents. IoError.
void make_folders(const std::filesystem::path& folder);

/// Writes images/, masks/ (COLMAP's names, <image>.png, black is masked) and sparse/0 with cameras,
/// images and points3D as .bin and .txt. `points`: in the scene's world. InputError for an image
/// that cannot be read, IoError, Interrupted once `stop` is set.
void write_colmap(const std::filesystem::path& folder, const PhotoSet& set,
                  const PointCloud& points, ThreadPool& pool, const std::atomic<bool>& stop);
/// Writes images/, masks/ (for all images or for none), transforms.json and points.ply, if there
/// are points. Throws as write_colmap.
void write_transforms(const std::filesystem::path& folder, const PhotoSet& set,
                      const PointCloud& points, ThreadPool& pool, const std::atomic<bool>& stop);

/// Returns the points as a PLY, thinned, with colours and normals (export/cloud_normals.h).
std::string point_cloud_ply(const PointCloud& points, const Rigid3d& world_from_scene,
                            ThreadPool& pool);

}  // namespace redrive

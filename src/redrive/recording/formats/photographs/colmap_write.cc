// SPDX-License-Identifier: Apache-2.0
// The writers of recording/formats/photographs/colmap_files.h.
#include <cstdio>

#include <Eigen/Geometry>

#include "redrive/base/error.h"
#include "redrive/recording/formats/photographs/colmap_files.h"
#include "redrive/recording/parse/little_endian.h"

namespace redrive::colmap {
namespace {

/// The numbers of a pose in the order of the files.
std::array<double, 7> numbers_of(const Rigid3d& camera_from_world) {
  const Eigen::Quaterniond q(camera_from_world.linear());
  const Eigen::Vector3d& t = camera_from_world.translation();
  return {q.w(), q.x(), q.y(), q.z(), t.x(), t.y(), t.z()};
}

void add_number(double value, std::string* text) {
  char word[40];
  std::snprintf(word, sizeof word, " %.17g", value);
  *text += word;
}

const CameraModel& model_of(const CameraRecord& camera) {
  const CameraModel* model = find_camera_model(camera.model_id);
  REDRIVE_CHECK(model && model->parameters.size() == camera.params.size());
  return *model;
}

constexpr double kUnknownError = -1;

}  // namespace

ModelFiles make_text(const std::vector<CameraRecord>& cameras,
                     const std::vector<ImageRecord>& images,
                     const std::vector<PointRecord>& points) {
  ModelFiles files;
  files.cameras = "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n";
  for (const CameraRecord& camera : cameras) {
    files.cameras += std::to_string(camera.id) + " " + std::string(model_of(camera).name) + " " +
                     std::to_string(camera.width) + " " + std::to_string(camera.height);
    for (const double value : camera.params) add_number(value, &files.cameras);
    files.cameras += "\n";
  }
  files.images =
      "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n# POINTS2D[] as (X, Y, "
      "POINT3D_ID)\n";
  for (const ImageRecord& image : images) {
    files.images += std::to_string(image.id);
    for (const double value : numbers_of(image.camera_from_world)) add_number(value, &files.images);
    files.images += " " + std::to_string(image.camera_id) + " " + image.name + "\n\n";
  }
  files.points = "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n";
  for (std::size_t i = 0; i < points.size(); ++i) {
    files.points += std::to_string(i + 1);
    for (int k = 0; k < 3; ++k) add_number(points[i].in_world[k], &files.points);
    for (const int value : points[i].rgb) files.points += " " + std::to_string(value);
    add_number(kUnknownError, &files.points);
    for (const std::int64_t image : points[i].images)
      files.points += " " + std::to_string(image) + " 0";
    files.points += "\n";
  }
  return files;
}

ModelFiles make_binary(const std::vector<CameraRecord>& cameras,
                       const std::vector<ImageRecord>& images,
                       const std::vector<PointRecord>& points) {
  ModelFiles files;
  add_bytes<std::uint64_t>(cameras.size(), &files.cameras);
  for (const CameraRecord& camera : cameras) {
    add_bytes(static_cast<std::uint32_t>(camera.id), &files.cameras);
    add_bytes<std::int32_t>(model_of(camera).id, &files.cameras);
    add_bytes(static_cast<std::uint64_t>(camera.width), &files.cameras);
    add_bytes(static_cast<std::uint64_t>(camera.height), &files.cameras);
    for (const double value : camera.params) add_bytes(value, &files.cameras);
  }
  add_bytes<std::uint64_t>(images.size(), &files.images);
  for (const ImageRecord& image : images) {
    add_bytes(static_cast<std::uint32_t>(image.id), &files.images);
    for (const double value : numbers_of(image.camera_from_world)) add_bytes(value, &files.images);
    add_bytes(static_cast<std::uint32_t>(image.camera_id), &files.images);
    files.images.append(image.name.c_str(), image.name.size() + 1);
    add_bytes<std::uint64_t>(0, &files.images);
  }
  add_bytes<std::uint64_t>(points.size(), &files.points);
  for (std::size_t i = 0; i < points.size(); ++i) {
    add_bytes<std::uint64_t>(i + 1, &files.points);
    for (int k = 0; k < 3; ++k) add_bytes(points[i].in_world[k], &files.points);
    for (const std::uint8_t value : points[i].rgb) add_bytes(value, &files.points);
    add_bytes(kUnknownError, &files.points);
    add_bytes<std::uint64_t>(points[i].images.size(), &files.points);
    for (const std::int64_t image : points[i].images) {
      add_bytes(static_cast<std::uint32_t>(image), &files.points);
      add_bytes<std::uint32_t>(0, &files.points);
    }
  }
  return files;
}

}  // namespace redrive::colmap

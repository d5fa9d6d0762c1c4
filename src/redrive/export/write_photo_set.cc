// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/write_photo_set.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/progress.h"
#include "redrive/export/cloud_normals.h"
#include "redrive/image/image_io.h"
#include "redrive/recording/formats/photographs/colmap_files.h"
#include "redrive/recording/formats/photographs/photographs.h"
#include "redrive/recording/lidar/ply.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

fs::path mask_name(const Photo& photo) {
  return fs::path("masks") / (photo.name.string() + ".png");
}

/// Writes a mask whose black pixels are masked.
void write_mask(const fs::path& file, int width, int height,
                const std::vector<std::uint8_t>& used) {
  Image8 mask{width, height, {}, {}, {}};
  for (const std::uint8_t value : used) mask.rgb.insert(mask.rgb.end(), 3, value);
  make_folders(file.parent_path());
  write_image(file, mask);
}

/// Writes the photo's mask if it has one.
void write_photo_mask(const fs::path& masks, const Photo& photo, const Resampling* resampling) {
  if (const auto mask = written_mask(photo.mask, resampling))
    write_mask(masks / (photo.name.string() + ".png"), mask->width, mask->height, mask->used);
}

/// nerfstudio wants a mask for every photo or for none: where some have one, gives the others a
/// white one.
void add_missing_masks(const fs::path& folder, const PhotoSet& set, ThreadPool& pool) {
  if (!fs::exists(folder / "masks")) return;
  pool.run(static_cast<int>(set.photos.size()), [&](int i) {
    const fs::path file = folder / mask_name(set.photos[i]);
    if (fs::exists(file)) return;
    const CameraCalibration& camera = set.cameras[set.photos[i].camera].calibration;
    const auto pixels = static_cast<std::size_t>(camera.width) * camera.height;
    write_mask(file, camera.width, camera.height, std::vector<std::uint8_t>(pixels, 255));
  });
}

/// Calls `use` with the index of each point that is written.
template <class Use>
void for_each_exported(const PointCloud& points, const Use& use) {
  for (std::size_t i = 0; i < points.n; i += exported_every(points)) use(i);
}

/// Returns the i-th vector of one of the cloud's arrays.
Eigen::Vector3d vector_of(const PointCloud& points, const std::vector<float>& all, std::size_t i) {
  return {all[i], all[points.n + i], all[2 * points.n + i]};
}

std::array<std::uint8_t, 3> colour_of(const PointCloud& points, std::size_t i) {
  std::array<std::uint8_t, 3> rgb;
  for (std::size_t k = 0; k < 3; ++k)
    rgb[k] = static_cast<std::uint8_t>(std::lround(255 * points.rgb[k * points.n + i]));
  return rgb;
}

/// Parameters of nerfstudio's camera models that are ours by name.
json intrinsics(const CameraCalibration& camera) {
  json out = {{"camera_model", camera.model == "opencv_fisheye" ? "OPENCV_FISHEYE" : "OPENCV"},
              {"fl_x", camera.fx()},
              {"fl_y", camera.fy()},
              {"cx", camera.cx() + 0.5},
              {"cy", camera.cy() + 0.5},
              {"w", camera.width},
              {"h", camera.height}};
  const CameraModelInfo& model = *find_camera_model(camera.model);
  for (std::size_t i = 0; i < model.distortion.size(); ++i)
    out[std::string(model.distortion[i].name)] = camera.parameters[4 + i];
  return out;
}

json matrix_json(const Rigid3d& world_from_camera) {
  const Eigen::Matrix4d matrix = photographs::with_opengl_axes(world_from_camera).matrix();
  json rows = json::array();
  for (int r = 0; r < 4; ++r)
    rows.push_back({matrix(r, 0), matrix(r, 1), matrix(r, 2), matrix(r, 3)});
  return rows;
}

}  // namespace

void make_folders(const fs::path& folder) {
  std::error_code error;
  fs::create_directories(folder, error);
  if (error) throw IoError(folder, error.message());
}

void write_images(const fs::path& images, const fs::path& masks, const PhotoSet& set,
                  ThreadPool& pool, const std::atomic<bool>& stop) {
  std::vector<std::optional<Resampling>> resampling(set.cameras.size());
  pool.run(static_cast<int>(set.cameras.size()), [&](int c) {
    if (set.cameras[c].resampled) resampling[c] = make_resampling(set.cameras[c]);
  });
  for (const Photo& photo : set.photos) make_folders((images / photo.name).parent_path());
  Progress progress("writing images", std::ssize(set.photos));
  pool.run(static_cast<int>(set.photos.size()), [&](int i) {
    if (stop) throw Interrupted();
    const Photo& photo = set.photos[i];
    const Resampling* how = resampling[photo.camera] ? &*resampling[photo.camera] : nullptr;
    const fs::path out = images / photo.name;
    if (how) {
      write_image(out, resampled_image(photo.source, set.cameras[photo.camera], *how));
    } else if (out.extension() == photo.source.extension()) {
      write_file(out, read_file(photo.source, kMaxImageBytes));
    } else {
      write_image(out, read_image(photo.source));
    }
    if (!masks.empty()) write_photo_mask(masks, photo, how);
    progress.count();
  });
}

std::size_t exported_every(const PointCloud& points) {
  return std::max<std::size_t>(1, (points.n + kMaxExportedPoints - 1) / kMaxExportedPoints);
}

bool is_colmap_camera(const CameraCalibration& calibration) {
  return colmap::to_record(calibration).has_value();
}

bool is_transforms_camera(const CameraCalibration& calibration) {
  return calibration.model == "opencv_pinhole" || calibration.model == "opencv_fisheye";
}

bool has_two_kinds_of_lenses(const PhotoSet& set) {
  return std::ranges::any_of(set.cameras, [&](const PhotoCamera& camera) {
    return camera.calibration.model != set.cameras[0].calibration.model;
  });
}

void write_colmap(const fs::path& folder, const PhotoSet& set, const PointCloud& points,
                  ThreadPool& pool, const std::atomic<bool>& stop) {
  write_images(folder / "images", folder / "masks", set, pool, stop);
  std::vector<colmap::CameraRecord> cameras;
  for (const PhotoCamera& camera : set.cameras) {
    cameras.push_back(*colmap::to_record(camera.calibration));
    cameras.back().id = static_cast<std::int64_t>(cameras.size());
  }
  std::vector<colmap::ImageRecord> images;
  for (const Photo& photo : set.photos)
    images.push_back({static_cast<std::int64_t>(images.size()) + 1,
                      photo.world_from_camera.inverse(Eigen::Isometry), photo.camera + 1,
                      photo.name.generic_string()});
  std::vector<colmap::PointRecord> records;
  for_each_exported(points, [&](std::size_t i) {
    records.push_back(
        {set.world_from_scene * vector_of(points, points.position, i), colour_of(points, i), {}});
  });
  const fs::path sparse = folder / "sparse/0";
  make_folders(sparse);
  for (const bool binary : {true, false}) {
    const colmap::ModelFiles files = binary ? colmap::make_binary(cameras, images, records)
                                            : colmap::make_text(cameras, images, records);
    const std::string extension = binary ? ".bin" : ".txt";
    write_file(sparse / ("cameras" + extension), files.cameras);
    write_file(sparse / ("images" + extension), files.images);
    write_file(sparse / ("points3D" + extension), files.points);
  }
}

void write_transforms(const fs::path& folder, const PhotoSet& set, const PointCloud& points,
                      ThreadPool& pool, const std::atomic<bool>& stop) {
  write_images(folder / "images", folder / "masks", set, pool, stop);
  add_missing_masks(folder, set, pool);
  json document = json::object();
  if (set.cameras.size() == 1)
    document = intrinsics(set.cameras[0].calibration);
  else if (!has_two_kinds_of_lenses(set))  // nerfstudio takes the camera model of the whole file
    document["camera_model"] = intrinsics(set.cameras[0].calibration).at("camera_model");
  document["frames"] = json::array();
  json train = json::array(), test = json::array();
  for (const Photo& photo : set.photos) {
    json frame = set.cameras.size() == 1 ? json::object()
                                         : intrinsics(set.cameras[photo.camera].calibration);
    const std::string file = (fs::path("images") / photo.name).generic_string();
    frame["file_path"] = file;
    frame["transform_matrix"] = matrix_json(photo.world_from_camera);
    if (fs::exists(folder / mask_name(photo)))
      frame["mask_path"] = mask_name(photo).generic_string();
    document["frames"].push_back(frame);
    (photo.held_out ? test : train).push_back(file);
  }
  if (!test.empty()) {
    document["train_filenames"] = train;
    document["val_filenames"] = test;  // nerfstudio wants all three
    document["test_filenames"] = test;
  }
  if (points.n > 0) {
    document["ply_file_path"] = "points.ply";
    write_file(folder / "points.ply", point_cloud_ply(points, set.world_from_scene, pool));
  }
  write_file(folder / "transforms.json", document.dump(1) + "\n");
}

std::string point_cloud_ply(const PointCloud& points, const Rigid3d& world_from_scene,
                            ThreadPool& pool) {
  constexpr double kFloatsReach = 1e4;  // in metres they resolve a millimetre there
  Rigid3d near_from_scene = world_from_scene;
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();  // where the near axes begin in the world
  if (world_from_scene.translation().norm() > kFloatsReach)
    origin = near_from_scene.translation(), near_from_scene.translation().setZero();
  std::vector<PlyPoint> out;
  std::vector<Eigen::Vector3f> seen_from;
  for_each_exported(points, [&](std::size_t i) {
    const Eigen::Vector3d position = near_from_scene * vector_of(points, points.position, i),
                          camera = near_from_scene * vector_of(points, points.seen_from, i);
    out.push_back({position.cast<float>(), Eigen::Vector3f::Zero(), colour_of(points, i)});
    seen_from.push_back(camera.cast<float>());
  });
  estimate_normals(seen_from, pool, out);
  return make_ply(out, /*normals=*/true, {}, origin);
}

}  // namespace redrive

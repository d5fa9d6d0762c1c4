// SPDX-License-Identifier: Apache-2.0
// redrive export: writes a run or a recording in a format of other programs.
#include <array>
#include <cstdio>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "redrive/base/cpu_features.h"
#include "redrive/base/did_you_mean.h"
#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/files/output_folder.h"
#include "redrive/base/memory_limit.h"
#include "redrive/cli/backend_options.h"
#include "redrive/cli/command.h"
#include "redrive/cli/export_scenes.h"
#include "redrive/cli/frames_option.h"
#include "redrive/cli/help.h"
#include "redrive/cli/notes.h"
#include "redrive/cli/output_file.h"
#include "redrive/cli/train/training.h"
#include "redrive/edit/edit_actors.h"
#include "redrive/export/bundle/scene_bundle.h"
#include "redrive/export/drive.h"
#include "redrive/export/field_file.h"
#include "redrive/export/field_points.h"
#include "redrive/export/mesh/field_mesh.h"
#include "redrive/export/mesh/surface_mesh.h"
#include "redrive/export/write_photo_set.h"
#include "redrive/model/method.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/damaged_records.h"
#include "redrive/recording/lidar/las.h"
#include "redrive/render/open_to_render.h"
#include "redrive/scene/lidar/lidar_points.h"
#include "redrive/scene/lidar/lidar_returns.h"
#include "redrive/scene/load_views.h"
#include "redrive/scene/moving_objects.h"
#include "redrive/train/run.h"
#include "redrive/view/scene_page.h"

namespace redrive {
namespace {

/// A run or a recording to export.
struct Source {
  bool is_run = false;
  Run run;
};

Source open_source(const ExportCommandOptions& options) {
  constexpr int kDownscale = 2;  // downscaling of the images that give points their colours
  if (!is_run_folder(options.from)) {
    Source source{
        false, open_without_model({.folder = options.from,
                                   .downscale = kDownscale,
                                   .frames = options.frames,
                                   .poses = options.poses,
                                   .outside_files = options.outside_files,
                                   .max_damaged = options.max_damaged.value_or(kMostDamagedPercent),
                                   .whole = DamageCheck::kAll})};
    print_notes(source.run.recording);
    return source;
  }
  refuse_part_of_run(options);
  return {true, open_to_render(options.from, options.max_damaged)};
}

const char* poses_of(const ExportCommandOptions& options, const Source& source) {
  return source.is_run ? "of the run" : options.poses.empty() ? "as recorded" : "of --poses";
}

/// Returns the static LiDAR returns, without annotated objects, and in a run without found ones.
LidarReturns static_returns(const Source& source, ThreadPool& pool) {
  const Run& run = source.run;
  return load_lidar_returns(
      run.recording, run.scene,
      source.is_run ? run.moving : read_moving_objects(run.recording, run.scene), pool);
}

/// Returns the recording's points of the static world with colours from its images.
PointCloud recorded_points(const Source& source, ThreadPool& pool) {
  const Run& run = source.run;
  const LidarReturns returns = static_returns(source, pool);
  if (returns.n == 0) return {};
  const ViewLoader load(run.scene, pool);
  std::uint64_t largest = 0;
  for (const RigCamera& rig : run.scene.rig)
    largest = std::max<std::uint64_t>(largest, 5ull * rig.camera.width * rig.camera.height);
  // LiDAR returns take their colours from images near their time, so few are needed at once. Points
  // of photographs take any image, which is decoded again where there are more.
  constexpr std::uint64_t kImages = 256;
  ImageCache cache(static_cast<int>(run.scene.views.size()),
                   [&](int view) { return load(run.scene.views[static_cast<std::size_t>(view)]); },
                   {.bytes = kImages * largest, .image_bytes = largest, .decoders = 0});
  return lidar_points(run.scene, ViewImages(cache), returns, pool);
}

void print_points(const PointCloud& points) {
  const std::size_t every = exported_every(points);
  if (points.n == 0)
    std::printf("no points: the recording has neither LiDAR nor a point cloud\n");
  else if (every > 1)
    std::printf("%zu points, every %zu. of %zu\n", (points.n + every - 1) / every, every, points.n);
  else
    std::printf("%zu points\n", points.n);
}

// ---- Formats

/// Folders of photographs.
template <class Write>
int export_photos(const ExportCommandOptions& options, bool (*has_camera)(const CameraCalibration&),
                  const Write& write) {
  check_output_folder("OUT", options.out, options.force);
  const Source source = open_source(options);
  const PhotoSet set = make_photo_set(source.run.recording, source.run.scene, has_camera);
  ThreadPool pool(options.backend.threads > 0 ? options.backend.threads : hardware_threads());
  const PointCloud points = recorded_points(source, pool);
  const std::atomic<bool>& stop = stop_on_signal();
  write_output_folder("OUT", options.out, options.force, [&](const std::filesystem::path& folder) {
    write(folder, set, points, pool, stop);
  });
  std::printf("%s: %s of %s, poses %s\nworld: %s\n", options.out.c_str(),
              counted(set.photos.size(), "image").c_str(),
              counted(set.cameras.size(), "camera").c_str(), poses_of(options, source),
              set.world.c_str());
  print_points(points);
  for (const std::string& what : set.left_out) std::printf("not exported: %s\n", what.c_str());
  if (write == write_transforms && has_two_kinds_of_lenses(set))
    std::printf("not exported: lenses of two kinds, of which nerfstudio takes one\n");
  if (source.is_run) std::printf("not exported: the field, exposures and masks of the run\n");
  return kExitOk;
}

int export_colmap(const ExportCommandOptions& options) {
  return export_photos(options, is_colmap_camera, write_colmap);
}

int export_transforms(const ExportCommandOptions& options) {
  return export_photos(options, is_transforms_camera, write_transforms);
}

/// Folders of drives.
int export_drive(const ExportCommandOptions& options) {
  const auto format = std::ranges::find(drive_formats(), options.format, &DriveFormat::name);
  check_output_folder("OUT", options.out, options.force);
  const Source source = open_source(options);
  const Recording drive = drive_of_scene(source.run.recording, source.run.scene);
  ThreadPool pool(options.backend.threads > 0 ? options.backend.threads : hardware_threads());
  const std::atomic<bool>& stop = stop_on_signal();
  DriveNotes notes;
  write_output_folder("OUT", options.out, options.force, [&](const std::filesystem::path& folder) {
    notes = format->write(folder, drive, pool, stop);
  });
  std::printf("%s: %s, poses %s\n", options.out.c_str(),
              counted(drive.frames.size(), "frame").c_str(), poses_of(options, source));
  if (source.is_run) notes.left_out.emplace_back("the field, exposures and masks of the run");
  if (drive.points_file.empty() && !source.run.recording.points_file.empty())
    notes.left_out.emplace_back("the static point cloud, in the axes of a frame that is left out");
  for (const std::string& what : notes.changed) std::printf("changed: %s\n", what.c_str());
  for (const std::string& what : notes.left_out) std::printf("not exported: %s\n", what.c_str());
  return kExitOk;
}

int export_ply(const ExportCommandOptions& options) {
  check_output_file("OUT", options.out, options.force);
  const Source source = open_source(options);
  std::string bytes;
  if (source.is_run) {
    const auto backend = make_backend(options.backend, source.run.options.method);
    const std::vector<PlyPoint> points = field_points(source.run, *backend, kMaxExportedPoints);
    if (points.empty())
      throw InputError(options.from, "", "", "the field has no opaque surface in its images");
    bytes = make_ply(points, /*normals=*/true);
    std::printf("%zu points of rendered depth with normals\n", points.size());
  } else {
    ThreadPool pool(options.backend.threads > 0 ? options.backend.threads : hardware_threads());
    const PointCloud points = recorded_points(source, pool);
    if (points.n == 0)
      throw InputError(options.from, "", "", "the recording has neither LiDAR nor a point cloud");
    bytes = point_cloud_ply(points, Rigid3d::Identity(), pool);
    print_points(points);
  }
  write_file(options.out, bytes);
  std::printf("%s: %.1f MB\n", options.out.c_str(), 1e-6 * static_cast<double>(bytes.size()));
  return kExitOk;
}

/// Returns the writer of a mesh file with this name. Throws UsageError for another ending.
std::string (*mesh_writer(const std::string& file))(const TriangleMesh&) {
  if (has_extension(file, {".obj"})) return make_obj;
  if (has_extension(file, {".glb"})) return make_glb;
  if (!has_extension(file, {".ply"}))
    throw UsageError("OUT", file, "a mesh must end in .ply, .obj or .glb");
  return [](const TriangleMesh& mesh) {
    return make_ply(mesh.vertices, /*normals=*/true, mesh.triangles);
  };
}

int export_mesh(const ExportCommandOptions& options) {
  check_output_file("OUT", options.out, options.force);
  refuse_part_of_run(options);
  const auto write = mesh_writer(options.out);
  if (const auto obstacle = mesh_obstacle()) throw UsageError("--to", "mesh", *obstacle);
  const Run run = open_to_render(options.from, options.max_damaged);
  const auto backend = make_backend(options.backend, run.options.method);
  const FieldMesh field =
      field_mesh(run, *backend, {options.voxel_m, allowed_memory(run.options, memory_bytes())});
  if (field.mesh.triangles.empty())
    throw InputError(options.from, "", "", "the field has no opaque surface in its images");
  const std::string bytes = write(field.mesh);
  write_file(options.out, bytes);
  const char* const metres = run.scene.metric ? " m" : "";
  std::printf("%zu triangles, %zu vertices of %s, up to %.3g%s from the camera, voxels of %.3g%s\n",
              field.mesh.triangles.size(), field.mesh.vertices.size(),
              counted(static_cast<std::size_t>(field.images), "image").c_str(), field.range_m,
              metres, field.voxel_m, metres);
  if (field.filled_m2 > 0) std::printf("gaps of the ground filled: %.1f m^2\n", field.filled_m2);
  std::printf("%s: %.1f MB\n", options.out.c_str(), 1e-6 * static_cast<double>(bytes.size()));
  return kExitOk;
}

int export_las(const ExportCommandOptions& options) {
  check_output_file("OUT", options.out, options.force);
  const Source source = open_source(options);
  const Run& run = source.run;
  if (run.recording.lidar_files.empty() || run.recording.lidars.empty())
    throw InputError(options.from, "", "", "the recording has no LiDAR revolutions");
  ThreadPool pool(options.backend.threads > 0 ? options.backend.threads : hardware_threads());
  const LidarReturns returns = static_returns(source, pool);
  LidarPoses poses(run.scene, returns);
  const std::vector<float> full = returns.full_intensities();
  std::vector<LidarRecord> points(returns.n);
  for (std::size_t i = 0; i < returns.n; ++i) {
    points[i].position_m = poses.in_world(i);
    points[i].t_ns = returns.t_ns[i];
    points[i].intensity = returns.intensity[i] / full[returns.sensor_of(i)];
  }
  const std::string bytes = make_las(points);
  write_file(options.out, bytes);
  std::printf(
      "%s: %zu LiDAR returns of the static world, %.1f MB, poses %s\nworld: body axes at the first "
      "pose, metres; gps_time: nanoseconds of the recording's clock\n",
      options.out.c_str(), points.size(), 1e-6 * static_cast<double>(bytes.size()),
      poses_of(options, source));
  return kExitOk;
}

int export_html(const ExportCommandOptions& options) {
  check_output_file("OUT", options.out, options.force);
  refuse_part_of_run(options);
  const std::string bytes =
      view::scene_page(open_to_render(options.from, options.max_damaged), options.encode.sh_degree);
  write_file(options.out, bytes);
  std::printf("%s: %.1f MB\n", options.out.c_str(), 1e-6 * static_cast<double>(bytes.size()));
  return kExitOk;
}

int export_model(const ExportCommandOptions& options) {
  check_output_file("OUT", options.out, options.force);
  refuse_part_of_run(options);
  const Run run = open_to_render(options.from, options.max_damaged);
  ExportOptions encode = options.encode;
  if (options.actor) encode.actor = &find_actor(run.scene, "--actors", *options.actor);
  const std::uint64_t bytes = write_field_file(options.out, *run.field(), options.format, encode);
  if (const MovingObject* actor = encode.actor)
    std::printf(
        "%s of %.2f x %.2f x %.2f m (length, width, height); origin: the centre of its "
        "box, x forward, y left, z up\n",
        actor->type.c_str(), actor->size_m.x(), actor->size_m.y(), actor->size_m.z());
  std::printf("%s: %.1f MB\n", options.out.c_str(), 1e-6 * static_cast<double>(bytes));
  return kExitOk;
}

/// A format that every run has. Formats of a method's models come after these.
struct Format {
  const char* name;
  const char* help;
  int (*run)(const ExportCommandOptions& options);
};

constexpr Format kFormats[] = {
    {"colmap",
     "a folder with images, their poses and cameras as COLMAP has them, text and binary, "
     "and LiDAR points (runs and recordings)",
     export_colmap},
    {"transforms",
     "a folder with images and nerfstudio's transforms.json, and LiDAR points as PLY "
     "(runs and recordings)",
     export_transforms},
    {"kitti",
     "a folder with a raw drive of KITTI, DATE/DATE_drive_0000_sync: up to four rectified pinholes "
     "that look the same way, poses, LiDAR and boxes (runs and recordings of drives)",
     export_drive},
    {"kitti360",
     "a folder with a drive in KITTI-360's layout: two pinholes, two fisheyes, poses, LiDAR and "
     "boxes (runs and recordings of drives)",
     export_drive},
    {"aimotive",
     "a folder with a drive in aiMotive's layout: all cameras, poses, LiDAR and boxes (runs and "
     "recordings of drives)",
     export_drive},
    {"nuscenes",
     "a folder with a scene in nuScenes' layout: all cameras as pinholes, poses, LiDAR and boxes "
     "(runs and recordings of drives)",
     export_drive},
    {"argoverse2",
     "a folder with a log in Argoverse 2's layout: all cameras as pinholes, poses, LiDAR and boxes "
     "(runs and recordings of drives)",
     export_drive},
    {"ncore",
     "a folder with a sequence of NVIDIA's NCore, version 4, for NuRec, 3dgrut and gsplat: all "
     "cameras and LiDARs, poses and boxes (runs and recordings of drives)",
     export_drive},
    {"ply",
     "a point cloud with colours and normals: of a run's rendered depth, or of a recording's "
     "LiDAR",
     export_ply},
    {"mesh", "triangles with colours, .ply, .obj or .glb, from a run's rendered depth (runs)",
     export_mesh},
    {"usdz-scene",
     "a scene bundle for AlpaSim and CARLA, .usdz, with the run inside, which serve takes (runs of "
     "drives)",
     export_scene_bundle},
    {"splatsim",
     "a scene of SplatSim, .usdz: the world's Gaussians in SPZ chunks (runs of drives, of --method "
     "splat)",
     export_splatsim},
    {"las",
     "the recorded LiDAR returns of the static world as LAS 1.2, motion compensated (runs and "
     "recordings)",
     export_las},
    {"html",
     "a page that shows the scene with the browser's GPU and needs nothing else (runs of --method "
     "splat)",
     export_html},
};

std::string formats_help() {
  std::string text = "format";
  for (const Format& format : kFormats)
    text += "; " + std::string(format.name) + ": " + format.help;
  for (const Method& method : methods())
    for (const ExportFormat& format : method.make()->export_formats())
      text += "; " + format.name + " (runs of --method " + method.name + "): " + format.help;
  return text;
}

/// Names of the formats that every run has, then of the methods' own formats.
std::vector<std::string> format_names() {
  std::vector<std::string> names;
  for (const Format& format : kFormats) names.emplace_back(format.name);
  for (const Method& method : methods())
    for (const ExportFormat& format : method.make()->export_formats()) names.push_back(format.name);
  return names;
}

int run_export(const ExportCommandOptions& options) {
  for (const Format& format : kFormats) {
    if (options.format != format.name) continue;
    if (options.actor)
      throw UsageError("--actors", std::to_string(*options.actor),
                       "is for Gaussians, splat-ply among them");
    return format.run(options);
  }
  if (const std::vector<std::string> names = format_names();
      std::ranges::find(names, options.format) == names.end())
    throw UsageError("--to", options.format,
                     unknown_name(options.format, names) + "; mesh writes .ply, .obj and .glb");
  return export_model(options);
}

}  // namespace

Action configure_export(CLI::App& command) {
  auto options = std::make_shared<ExportCommandOptions>();
  command.add_option("RUN", options->from, "run folder, as train makes it, or a recording")
      ->required();
  command.add_option("OUT,--out", options->out, "file or folder to write")->required();
  command.add_option("--to", options->format, formats_help())
      ->required()
      ->check(offering(format_names()));
  command
      .add_option("--sh-degree", options->encode.sh_degree,
                  "of Gaussians, the degree of the colours' spherical harmonics, 0 or 1: in "
                  "splat-ply a Gaussian takes 68 bytes with 0, 104 with 1")
      ->check(within("--sh-degree", 0, 1))
      ->capture_default_str();
  command.add_option(
      "--actors", options->actor,
      "id of one moving object whose Gaussians are written instead of the world's, in "
      "the axes of its box; render --edit takes the PLY");
  command
      .add_option("--voxel", options->voxel_m,
                  "of meshes, the side of a voxel in metres, 0.001..100 (default: " +
                      number_text(kMeshVoxel_m) + ", in usdz-scene " + number_text(kBundleVoxel_m) +
                      "; of photographs the median depth / " + number_text(kVoxelsPerMedianDepth) +
                      ")")
      ->check(within("--voxel", 0.001, 100.0));
  command.add_flag("--force", options->force,
                   "overwrites an existing file, or a folder of an earlier export");
  add_frames_option(command, &options->frames);
  add_outside_files_option(command, &options->outside_files);
  add_max_damaged_option(command, &options->max_damaged);
  command.add_option("--poses", options->poses,
                     "of a recording: folder with poses and calibration, as align writes it");
  add_backend_options(command, &options->backend);
  return [options] { return run_export(*options); };
}

}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/bundle/scene_bundle.h"

#include <algorithm>
#include <chrono>
#include <cstdio>

#include "redrive/base/error.h"
#include "redrive/base/files/file_container.h"
#include "redrive/base/files/files.h"
#include "redrive/export/bundle/content_id.h"
#include "redrive/export/bundle/ground_mesh.h"
#include "redrive/export/mesh/field_mesh.h"
#include "redrive/export/ncore/ncore_terms.h"
#include "redrive/math/local_level.h"
#include "redrive/recording/core/actor_kind.h"
#include "redrive/recording/formats/recording_json.h"
#include "redrive/recording/parse/rigid_json.h"
#include "redrive/render/open_to_render.h"
#include "redrive/render/run_camera.h"
#include "redrive/scene/lidar/lidar_returns.h"

namespace redrive {
namespace {

using Json = nlohmann::ordered_json;

constexpr std::int64_t kNsPerUs = 1000;

std::int64_t us(std::int64_t t_ns) { return t_ns / kNsPerUs; }

/// What the members share.
struct BundleScene {
  const Run& run;
  const SceneBundleOptions& options;
  std::int64_t first_ns = 0, last_ns = 0;  ///< times of the scene's first and last frame

  std::string camera_id(const std::string& name) const { return name + "@" + options.scene_id; }
  bool covers(std::int64_t t_ns) const { return t_ns >= first_ns && t_ns <= last_ns; }
};

/// JSON is YAML, too.
Json metadata(const BundleScene& scene, std::uint64_t recording_hash, std::uint64_t model_hash) {
  Json cameras = Json::array(), lidars = Json::array();
  for (const RigCamera& rig : scene.run.scene.rig) cameras.push_back(scene.camera_id(rig.name));
  for (const RecordedLidar& lidar : scene.run.recording.lidars)
    lidars.push_back(scene.camera_id(lidar.name));
  const auto made = std::chrono::floor<std::chrono::days>(std::chrono::system_clock::now());
  const std::chrono::year_month_day day(made);
  char date[32];
  std::snprintf(date, sizeof date, "%04d-%02u-%02u", int(day.year()), unsigned(day.month()),
                unsigned(day.day()));
  return {{"scene_id", scene.options.scene_id},
          {"version_string", "redrive " + scene.options.version},
          {"training_date", date},
          {"dataset_hash", hash_text(recording_hash)},
          {"uuid", uuid_of(model_hash)},
          {"is_resumable", false},
          {"sensors", {{"camera_ids", cameras}, {"lidar_ids", lidars}}},
          {"logger", Json::object()},
          {"time_range",
           {{"start", 1e-9 * static_cast<double>(scene.first_ns)},
            {"end", 1e-9 * static_cast<double>(scene.last_ns)}}}};
}

Json data_info(const BundleScene& scene) {
  return {{"sequence_id", scene.options.scene_id},
          {"pose-range",
           {{"start-timestamp_us", us(scene.first_ns)}, {"end-timestamp_us", us(scene.last_ns)}}}};
}

/// NCore's parameters. CARLA reads f-theta's of every camera, which are null for other lenses.
Json camera_model(const CameraCalibration& camera, const Camera& lens) {
  Json model = ncore::camera_model(camera, lens);
  for (const char* const key : {"reference_poly", "pixeldist_to_angle_poly",
                                "angle_to_pixeldist_poly", "max_angle", "linear_cde"})
    model["parameters"].emplace(key, nullptr);
  return model;
}

/// Start and end of each image's exposure, where the rig has poses.
Json exposures(const BundleScene& bundle, int camera) {
  const Scene& scene = bundle.run.scene;
  Json frames = Json::array();
  for (const View& view : scene.views) {
    if (view.camera != camera) continue;
    const std::int64_t middle_ns = scene.exposed_ns(view),
                       readout_ns = std::abs(scene.rig[camera].readout_ns),
                       start_ns = middle_ns - readout_ns / 2,
                       end_ns = std::max(start_ns + readout_ns, start_ns + kNsPerUs);
    if (bundle.covers(start_ns) && bundle.covers(end_ns))
      frames.push_back({us(start_ns), us(end_ns)});
  }
  return frames;
}

Json rig_trajectories(const BundleScene& bundle) {
  const Scene& scene = bundle.run.scene;
  Json cameras = Json::object(), frames = Json::object(), poses = Json::array(),
       times = Json::array();
  for (std::size_t c = 0; c < scene.rig.size(); ++c) {
    const RigCamera& rig = scene.rig[c];
    const std::string id = bundle.camera_id(rig.name);
    cameras[id] = {{"sequence_id", bundle.options.scene_id},
                   {"logical_sensor_name", rig.name},
                   {"unique_sensor_idx", c},
                   {"T_sensor_rig", rigid_to_json(rig.body_from_sensor)},
                   {"camera_model", camera_model(calibration_of(bundle.run, rig), rig.camera)}};
    frames[id] = exposures(bundle, static_cast<int>(c));
  }
  for (const FramePose& pose : scene.trajectory)
    if (bundle.covers(pose.t_ns) && (times.empty() || us(pose.t_ns) > times.back())) {
      poses.push_back(Json(rigid_to_json(scene.world_from_body(pose.t_ns))));
      times.push_back(us(pose.t_ns));
    }
  const bool on_earth = bundle.run.recording.global_frame == GlobalFrame::kEcef;
  return {{"world_to_nre", {{"matrix", rigid_to_json(Rigid3d::Identity())}}},
          {"T_world_base", rigid_to_json(on_earth ? scene.global_from_world : Rigid3d::Identity())},
          {"camera_calibrations", cameras},
          {"rig_trajectories",
           {{{"sequence_id", bundle.options.scene_id},
             {"T_rig_worlds", poses},
             {"T_rig_world_timestamps_us", times},
             {"cameras_frame_timestamps_us", frames},
             {"rig_bbox", nullptr}}}}};
}

/// Objects with poses at two times of the scene or more.
Json sequence_tracks(const BundleScene& bundle) {
  Json ids = Json::array(), labels = Json::array(), flags = Json::array(), times = Json::array(),
       poses = Json::array(), sizes = Json::array();
  for (const MovingObject& actor : bundle.run.scene.actors) {
    Json own_times = Json::array(), own_poses = Json::array();
    for (const MovingObject::Key& key : actor.keys) {
      const auto box = actor.world_from_box(key.t_ns);
      if (!box || !bundle.covers(key.t_ns)) continue;
      if (!own_times.empty() && us(key.t_ns) <= own_times.back()) continue;
      const Eigen::Vector3d at = box->translation();
      const Eigen::Quaterniond turn(box->linear());
      own_poses.push_back({at.x(), at.y(), at.z(), turn.x(), turn.y(), turn.z(), turn.w()});
      own_times.push_back(us(key.t_ns));
    }
    if (own_times.size() < 2) continue;
    ids.push_back(std::to_string(actor.id));
    labels.push_back(ncore::class_of(actor.type));
    flags.push_back({"DYNAMIC", "CONTROLLABLE"});
    times.push_back(own_times);
    poses.push_back(own_poses);
    sizes.push_back({actor.size_m.x(), actor.size_m.y(), actor.size_m.z()});
  }
  return {{kTracksKey,
           {{"tracks_data",
             {{"tracks_id", ids},
              {"tracks_label_class", labels},
              {"tracks_flags", flags},
              {"tracks_timestamps_us", times},
              {"tracks_poses", poses}}},
            {"cuboidtracks_data", {{"cuboids_dims", sizes}}}}}};
}

/// Adds the LiDAR returns of the static world where the recording has intensities.
void add_returns(const Run& run, const Rigid3d& map_from_world, ThreadPool& pool,
                 RoadMapInput* input) {
  if (run.recording.lidars.empty() || run.recording.lidar_files.empty()) return;
  const LidarReturns returns = load_lidar_returns(run.recording, run.scene, run.moving, pool);
  LidarPoses poses(run.scene, returns);
  const std::vector<float> full = returns.full_intensities();
  for (std::size_t i = 0; i < returns.n; ++i)
    input->returns.push_back(
        {map_from_world * poses.in_world(i),
         static_cast<double>(returns.intensity[i] / full[returns.sensor_of(i)])});
}

/// Adds moving vehicles where they are faster than 2 m/s.
void add_vehicles(const Run& run, const Rigid3d& map_from_world, RoadMapInput* input) {
  constexpr double kLeastSpeed_m_per_s = 2;
  for (const MovingObject& object : run.moving.objects()) {
    if (kind_of(object.type).core == 0) continue;  // people
    for (const MovingObject::Key& key : object.keys) {
      const Eigen::Vector3d at = map_from_world * key.world_from_box.translation(),
                            velocity = map_from_world.linear() * key.velocity_in_world_m_per_s;
      if (velocity.norm() >= kLeastSpeed_m_per_s)
        input->vehicles.push_back({object.id, at.head<2>(), velocity.head<2>()});
    }
  }
}

/// The map lies in the world, or, where that has a place on the Earth, in the plane that touches
/// the ellipsoid below the world's origin, x to the east.
RoadMap map_of(const BundleScene& bundle, const TriangleMesh& ground, ThreadPool& pool) {
  const Scene& scene = bundle.run.scene;
  RoadMapInput input{.name = bundle.options.scene_id,
                     .driven = {},
                     .ground = {},
                     .returns = {},
                     .vehicles = {},
                     .origin = {}};
  Rigid3d map_from_world = Rigid3d::Identity();
  if (bundle.run.recording.global_frame == GlobalFrame::kEcef) {
    const Eigen::Vector3d at = scene.global_from_world.translation();
    input.origin = geodetic_from_ecef(at.x(), at.y(), at.z());
    input.origin->height_m = 0;
    map_from_world =
        ecef_from_enu(*input.origin).inverse(Eigen::Isometry) * scene.global_from_world;
  }
  for (const FramePose& pose : scene.trajectory)
    if (bundle.covers(pose.t_ns))
      input.driven.push_back(map_from_world * scene.world_from_body(pose.t_ns));
  for (const PlyPoint& vertex : ground.vertices)
    input.ground.emplace_back(map_from_world * vertex.position.cast<double>());
  add_returns(bundle.run, map_from_world, pool, &input);
  add_vehicles(bundle.run, map_from_world, &input);
  return make_road_map(input);
}

std::string ply_of(const TriangleMesh& mesh) {
  return make_ply(mesh.vertices, /*normals=*/true, mesh.triangles);
}

}  // namespace

SceneBundle make_scene_bundle(const Run& run, kernels::Backend& backend,
                              const SceneBundleOptions& options) {
  const std::string& root = run.paths.root.string();
  if (!run.blocks.empty())
    throw UsageError("RUN", root, "is a drive in blocks; a scene bundle has one of its blocks");
  if (!run.scene.metric)
    throw InputError(root, "", "", "photographs have neither metres nor times, which a scene has");
  const FieldMesh field = field_mesh(run, backend, {options.voxel_m, options.most_bytes});
  if (field.mesh.triangles.empty())
    throw InputError(root, "", "", "the field has no opaque surface in its images");
  std::vector<Rigid3d> driven;
  for (const PosedFrame& frame : run.scene.posed_frames()) driven.push_back(frame.world_from_body);
  TriangleMesh ground = ground_of_mesh(field.mesh, driven);
  fill_under_body(driven, &ground);

  const BundleScene scene{run, options, run.scene.frames.front().t_ns,
                          run.scene.frames.back().t_ns};
  std::string recording = recording_to_json(run.recording),
              checkpoint = read_file(run.paths.checkpoint(), kMaxDataBytes);
  const Json rig = rig_trajectories(scene), tracks = sequence_tracks(scene);
  SceneBundle bundle;
  bundle.poses = rig["rig_trajectories"][0]["T_rig_worlds"].size();
  bundle.cameras = run.scene.rig.size();
  bundle.tracks = tracks[kTracksKey]["tracks_data"]["tracks_id"].size();
  bundle.triangles = field.mesh.triangles.size();
  bundle.ground_triangles = ground.triangles.size();
  const auto add = [&](const std::filesystem::path& name, std::string bytes) {
    bundle.members.emplace_back(name.string(), std::move(bytes));
  };
  add(kMetadata, metadata(scene, hash_of(recording), hash_of(checkpoint)).dump(1) + "\n");
  add(kDataInfo, data_info(scene).dump(1) + "\n");
  add(kRigTrajectories, rig.dump() + "\n");
  add(kSequenceTracks, tracks.dump() + "\n");
  add(kMesh, ply_of(field.mesh));
  add(kGroundMesh, ply_of(ground));
  bundle.map = map_of(scene, ground, backend.pool());
  if (bundle.map.roads > 0) add(kMap, std::move(bundle.map.xml));
  const RunPaths inside{kRunOfBundle};
  add(inside.config(), read_file(run.paths.config()));
  add(inside.recording(), std::move(recording));
  if (const auto moving = run.paths.masks() / "moving.json"; file_bytes(moving))
    add(inside.masks() / "moving.json", read_file(moving));
  add(inside.checkpoint(), std::move(checkpoint));
  return bundle;
}

}  // namespace redrive

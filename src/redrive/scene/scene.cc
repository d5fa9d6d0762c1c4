// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/scene.h"

#include <algorithm>
#include <cmath>
#include <set>

#include "redrive/base/error.h"
#include "redrive/camera/ray_share.h"
#include "redrive/recording/core/camera_choice.h"
#include "redrive/recording/core/frame_range.h"
#include "redrive/recording/core/trajectory.h"

namespace redrive {
namespace {

void check_ranges(const SceneOptions& options) {
  const auto require = [](bool good, const char* option, auto value, const char* rule) {
    if (!good) throw UsageError(option, std::to_string(value), rule);
  };
  require(options.frame_step >= 1, "--frames step", options.frame_step, "must be at least 1");
  require(options.downscale >= 1 && options.downscale <= 64, "--downscale", options.downscale,
          "must be in 1..64");
  require(options.holdout_every == 0 || options.holdout_every >= 2, "--holdout-every",
          options.holdout_every, "must be 0 (none) or at least 2");
  require(options.train_every == 0 || (options.train_every >= 2 && options.holdout_every == 0),
          "--train-every", options.train_every,
          "must be 0 (all) or at least 2, and excludes --holdout-every");
  require(options.near_m > 0 && std::isfinite(options.near_m), "--near", options.near_m,
          "must be a distance above 0 m");
  require(options.far_m > options.near_m && std::isfinite(options.far_m), "--far", options.far_m,
          "must lie beyond --near");
}

/// Whether the recording has its own split.
bool has_split(const Recording& recording) {
  return std::any_of(recording.cameras.begin(), recording.cameras.end(),
                     [](const RecordedCamera& camera) {
                       return std::any_of(camera.images.begin(), camera.images.end(),
                                          [](const ImageFile& image) { return image.held_out; });
                     });
}

/// Returns the selected cameras in the order of the option; all in the order of their names if it
/// is empty.
std::vector<const RecordedCamera*> choose_cameras(const Recording& recording,
                                                  const SceneOptions& options) {
  std::vector<const RecordedCamera*> chosen;
  for (const RecordedCamera& camera : recording.cameras)
    if (options.cameras.empty()) chosen.push_back(&camera);
  std::set<std::string> seen;
  for (const std::string& name : options.cameras) {
    const RecordedCamera* camera = &named_camera(recording, name);
    if (!seen.insert(name).second) throw UsageError("--cameras", name, "is named twice");
    chosen.push_back(camera);
  }
  return chosen;
}

/// Drops frames that no camera has an image of, unless all frames are. Returns their number.
std::size_t leave_out_unseen(const std::vector<const RecordedCamera*>& cameras,
                             std::vector<FramePose>* frames) {
  std::set<std::int64_t> shown;
  for (const RecordedCamera* camera : cameras)
    for (const ImageFile& image : camera->images) shown.insert(image.frame_id);
  const auto is_unseen = [&](const FramePose& frame) { return !shown.contains(frame.id); };
  return std::ranges::all_of(*frames, is_unseen) ? 0 : std::erase_if(*frames, is_unseen);
}

/// Adds the actors where a camera with these poses sees them.
ShutterPoses add_actors(ShutterPoses poses, const std::vector<MovingObject>& actors,
                        std::int64_t exposed_ns, std::int64_t readout_ns) {
  const std::size_t keys = poses.keys().size();
  std::vector<std::int64_t> t_ns;
  for (std::size_t key = 0; key < keys; ++key) {
    const double part =
        keys == 1 ? 0 : static_cast<double>(key) / static_cast<double>(keys - 1) - 0.5;
    t_ns.push_back(exposed_ns + std::llround(part * static_cast<double>(readout_ns)));
  }
  poses.set_actors(seen_actors(actors, poses.keys(), t_ns));
  return poses;
}

/// Returns the cube around all camera centres, grown by far_m on every side. 1e-6: room for
/// rounding to float.
UnitFromWorld enclosing_cube(const Scene& scene) {
  Eigen::AlignedBox3d box;
  for (const View& view : scene.views) box.extend(scene.world_from_camera(view).translation());
  const Eigen::Vector3d center = box.center();
  const double half_side_m = (box.sizes().maxCoeff() / 2 + scene.far_m) * (1 + 1e-6);
  UnitFromWorld unit;
  for (int d = 0; d < 3; ++d) unit.center[d] = static_cast<float>(center[d]);
  unit.scale = static_cast<float>(1 / half_side_m);
  return unit;
}

}  // namespace

RigCamera make_rig_camera(const CameraCalibration& calibration, const SceneOptions& options) {
  constexpr int kColumns = 40;  // photographs may have a camera each
  RigCamera camera{calibration.name,
                   {},
                   make_camera(calibration),
                   calibration.body_from_sensor,
                   calibration.time_offset_ns,
                   calibration.readout_ns,
                   calibration.readout_by_column};
  if (const double percent = percent_without_ray(camera.recorded, kColumns);
      percent > kMostWithoutRay)
    throw InputError("calibration", calibration.name, "",
                     without_ray_text(percent) + ": that is no calibration of a lens");
  if (options.undistort && calibration.readout_ns != 0)
    throw UsageError(
        "--undistort", calibration.name,
        "has a rolling shutter, whose lines have times of their own: resampling mixes them");
  if (options.undistort && !camera.recorded.info().perspective)
    throw UsageError("--undistort", calibration.name,
                     "is a fisheye (" + calibration.model +
                         "), which no pinhole image can hold; leave --undistort out, rays are "
                         "exact from the recorded image, or choose --cameras without it");
  camera.camera = (options.undistort ? camera.recorded.undistorted() : camera.recorded)
                      .downscaled(options.downscale);
  if (camera.camera.width < 1 || camera.camera.height < 1)
    throw UsageError("--downscale", std::to_string(options.downscale),
                     "leaves no pixel of " + calibration.name + ", which has " +
                         std::to_string(calibration.width) + " x " +
                         std::to_string(calibration.height));
  return camera;
}

int Scene::camera_index(const std::string& name) const {
  const auto found = std::find_if(rig.begin(), rig.end(),
                                  [&](const RigCamera& camera) { return camera.name == name; });
  return found == rig.end() ? -1 : static_cast<int>(found - rig.begin());
}

int Scene::frame_index(std::int64_t id) const {
  const auto found = std::lower_bound(frames.begin(), frames.end(), id,
                                      [](const Frame& f, std::int64_t i) { return f.id < i; });
  return found == frames.end() || found->id != id ? -1 : static_cast<int>(found - frames.begin());
}

Exposure Scene::exposure(int camera, std::int64_t t_ns) const {
  return {camera, static_cast<float>(1e-9 * static_cast<double>(t_ns - frames.front().t_ns))};
}

void Scene::add_frame(const PosedFrame& frame) {
  frames.push_back({frame.id, frame.t_ns});
  trajectory.push_back({frame.id, frame.t_ns, global_from_world * frame.world_from_body});
}

void Scene::correct(const PoseCorrections& by) {
  if (recorded_.empty())
    for (const RigCamera& camera : rig)
      recorded_.push_back({camera.body_from_sensor, camera.time_offset_ns});
  corrections = by;
  const bool none = by.values.empty();
  REDRIVE_CHECK(none || by.values.size() == by.size());
  REDRIVE_CHECK(none || frames.size() == static_cast<std::size_t>(by.frames));
  REDRIVE_CHECK(none || rig.size() == static_cast<std::size_t>(by.cameras));
  for (int c = 0; c < std::ssize(rig); ++c) {
    rig[c].body_from_sensor = recorded_[c].body_from_sensor;
    rig[c].time_offset_ns = recorded_[c].time_offset_ns;
    if (none) continue;
    rig[c].body_from_sensor =
        rig[c].body_from_sensor * rigid_from_vector(&by.values[by.camera_slot(c)]);
    rig[c].time_offset_ns += std::llround(1e9 * by.values[by.time_slot(c)]);
  }
  if (none) recorded_.clear();
}

Scene::Extrinsics Scene::extrinsics(int camera, Poses which) const {
  if (which == Poses::kRecorded && !recorded_.empty()) return recorded_[camera];
  return {rig[camera].body_from_sensor, rig[camera].time_offset_ns};
}

Rigid3d Scene::corrected(const FramePose& pose) const {
  const Between at = find_interval(frames.size(), pose.t_ns, [&](std::size_t i) {
                       return frames[i].t_ns;
                     }).clamped();
  const float* const first =
      &corrections.values[corrections.frame_slot(static_cast<int>(at.before))];
  const auto six = interpolate_vector6(first, first + 6, at.part);
  return pose.global_from_body * rigid_from_vector(six.data());
}

std::vector<FramePose> Scene::corrected_trajectory() const {
  std::vector<FramePose> poses = trajectory;
  if (!corrections.values.empty())
    for (FramePose& pose : poses) pose.global_from_body = corrected(pose);
  return poses;
}

std::vector<PosedFrame> Scene::posed_frames() const {
  std::vector<PosedFrame> posed;
  for (const Frame& frame : frames)
    posed.push_back({frame.id, frame.t_ns, world_from_body(frame.t_ns)});
  return posed;
}

Rigid3d Scene::world_from_body(std::int64_t t_ns, Poses which) const {
  const bool corrects = which == Poses::kCorrected && !corrections.values.empty();
  return global_from_world.inverse() * pose_at(trajectory, t_ns, [&](const FramePose& pose) {
           return corrects ? corrected(pose) : pose.global_from_body;
         });
}

std::int64_t Scene::exposed_ns(const View& view, Poses which) const {
  return frames[view.frame].t_ns + extrinsics(view.camera, which).time_offset_ns;
}

Rigid3d Scene::world_from_body(const View& view, Poses which) const {
  const Rigid3d pose = world_from_body(exposed_ns(view, which), which);
  return view.motion ? pose * *view.motion : pose;
}

std::vector<Rigid3d> Scene::body_during(const View& view, Poses which) const {
  constexpr int kKeys = ShutterPoses::kKeys;
  const std::int64_t readout_ns = rig[view.camera].readout_ns;
  if (readout_ns == 0) return {world_from_body(view, which)};
  std::vector<Rigid3d> keys;
  for (int key = 0; key < kKeys; ++key) {
    const double part = key / (kKeys - 1.0) - 0.5;
    keys.push_back(world_from_body(
        exposed_ns(view, which) + std::llround(part * static_cast<double>(readout_ns)), which));
    if (view.motion) keys.back() = keys.back() * *view.motion;
  }
  return keys;
}

std::vector<Rigid3d> Scene::camera_during(const View& view, Poses which) const {
  std::vector<Rigid3d> keys = body_during(view, which);
  for (Rigid3d& key : keys) key = key * extrinsics(view.camera, which).body_from_sensor;
  return keys;
}

Rigid3d Scene::world_from_camera(const View& view) const {
  return world_from_body(view) * rig[view.camera].body_from_sensor;
}

ShutterPoses Scene::shutter_poses(const View& view, const std::vector<MovingObject>& with) const {
  return add_actors(ShutterPoses(camera_during(view), rig[view.camera].readout_by_column), with,
                    exposed_ns(view), rig[view.camera].readout_ns);
}

ShutterPoses Scene::with_actors(ShutterPoses poses, const RigCamera& camera,
                                std::int64_t frame_ns) const {
  return add_actors(std::move(poses), actors, frame_ns + camera.time_offset_ns, camera.readout_ns);
}
std::array<float, 3> background_colour(Background background) {
  const float value = background == Background::kWhite ? 1.0f : 0.0f;
  return {value, value, value};
}

Scene make_scene(const Recording& recording, const SceneOptions& options) {
  check_ranges(options);
  if (recording.frames.empty())
    throw InputError(recording.root, "", "", "the recording has no frame with a pose");
  if (recording.cameras.empty())
    throw InputError(recording.root, "", "", "the recording has no camera with images");

  Scene scene;
  scene.near_m = options.near_m;
  scene.far_m = options.far_m;
  scene.downscale = options.downscale;
  scene.undistort = options.undistort;
  scene.background = options.background;
  scene.random_background = options.random_background;
  scene.metric = recording.metric;
  scene.global_from_world = recording.frames.front().global_from_body;
  if (recording.bounds) {
    scene.global_from_world = Eigen::Translation3d(recording.bounds->center);
    scene.half_side = recording.bounds->half_side;
  }
  const bool own_split = has_split(recording);
  const bool trains_some = options.train_every > 0;
  const int every = trains_some ? options.train_every : options.holdout_every;
  const char* const split_option = trains_some ? "--train-every" : "--holdout-every";
  if (own_split && every > 0)
    throw UsageError(split_option, std::to_string(every),
                     "this recording has its own split of held-out images; omit the option");
  scene.trajectory = recording.frames;
  const std::vector<const RecordedCamera*> cameras = choose_cameras(recording, options);
  std::vector<FramePose> frames =
      select_frames({options.first_frame, options.last_frame, 1}, recording.frames);
  if (options.shown_only) scene.unseen_frames = leave_out_unseen(cameras, &frames);
  for (const FramePose& frame : select_frames({.step = options.frame_step}, frames))
    scene.frames.push_back({frame.id, frame.t_ns});

  for (const RecordedCamera* recorded : cameras) {
    std::vector<View> views;
    for (const ImageFile& image : recorded->images) {
      const int frame = scene.frame_index(image.frame_id);
      if (frame < 0) continue;
      const bool held_out = image.held_out || (every > 0 && (frame % every == 0) != trains_some);
      views.push_back(
          {static_cast<int>(scene.rig.size()), frame, image.path, held_out, image.mask});
    }
    if (views.empty()) {
      if (options.cameras.empty()) continue;
      throw UsageError("--cameras", recorded->calibration.name,
                       "has no image in the chosen frames");
    }
    scene.rig.push_back(make_rig_camera(recorded->calibration, options));
    scene.views.insert(scene.views.end(), views.begin(), views.end());
  }
  if (scene.views.empty())
    throw UsageError("--frames", "", "no camera has an image in the chosen frames");
  if (std::all_of(scene.views.begin(), scene.views.end(),
                  [](const View& view) { return view.held_out; }))
    throw UsageError(own_split ? "--frames" : split_option, own_split ? "" : std::to_string(every),
                     "leaves no image for training: only " + std::to_string(scene.frames.size()) +
                         " frame(s) are chosen");
  scene.unit_from_world = enclosing_cube(scene);
  return scene;
}

}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
// The part of a recording that a run uses: the rig, its trajectory in the world of the first frame,
// the images for training and the held-out ones, and the map from the world into the unit cube.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "redrive/camera/camera.h"
#include "redrive/field/exposure.h"
#include "redrive/field/unit_from_world.h"
#include "redrive/recording/core/recording.h"
#include "redrive/scene/moving_object.h"
#include "redrive/scene/pose_corrections.h"
#include "redrive/scene/shutter_poses.h"

namespace redrive {

struct RigCamera {
  std::string name;
  Camera camera;    ///< at the training resolution, undistorted and downscaled by the options
  Camera recorded;  ///< as recorded; the image file must have its size
  Rigid3d body_from_sensor;
  std::int64_t time_offset_ns =
      0;                        ///< exposure of the middle row minus the time of the frame's pose
  std::int64_t readout_ns = 0;  ///< CameraCalibration::readout_ns
  bool readout_by_column = false;
};

struct Frame {
  std::int64_t id = 0;
  std::int64_t t_ns = 0;
};

/// A frame and the pose of the body then.
struct PosedFrame {
  std::int64_t id = 0;
  std::int64_t t_ns = 0;
  Rigid3d world_from_body;  ///< metres; see Scene::global_from_world
};

/// One image: a camera of the rig at a frame.
struct View {
  int camera = 0;  ///< index into Scene::rig
  int frame = 0;   ///< index into Scene::frames
  std::filesystem::path image;
  bool held_out = false;
  MaskFile mask;
  /// motion of the body for this image alone, in its own axes (eval/view_alignment.h)
  std::optional<Rigid3d> motion = std::nullopt;
};

/// The colour behind transparent pixels, in rendering and evaluation.
enum class Background {
  kNone,  ///< images have to be opaque
  kWhite,
  kBlack
};

/// Selects the part of a recording that a run uses. Defaults: all cameras and frames, full size,
/// nothing held out.
struct SceneOptions {
  std::vector<std::string> cameras;                ///< empty: all with images
  std::int64_t first_frame = -1, last_frame = -1;  ///< ids, inclusive; -1: open
  int frame_step = 1;                              ///< keeps every n-th frame, >= 1
  bool shown_only = false;  ///< drops frames that none of these cameras has an image of
  int downscale = 1;        ///< 1..64
  /// 0: none; n >= 2: every n-th frame (the first one included), all cameras; only for recordings
  /// without a split of their own
  int holdout_every = 0;
  /// Instead: 0: all; n >= 2: every n-th frame (the first one included) is trained on, others are
  /// held out.
  int train_every = 0;
  bool undistort = false;         ///< resamples pinhole images without distortion first
  double near_m = 1, far_m = 10;  ///< 0 < near < far
  Background background = Background::kNone;
  bool random_background =
      false;  ///< training: another colour for every ray of every step instead, rays/ray_table.h
};

/// Poses are evaluated when they are asked for, so that a change of the corrections costs what it
/// copies. Const functions may be called by several threads.
struct Scene {
  std::vector<RigCamera> rig;  ///< extrinsics and time offsets with the corrections
  std::vector<Frame> frames;   ///< times increase
  std::vector<View> views;     ///< ordered by camera, then frame
  /// Recorded poses of the body, more often or longer than at `frames` as the recording has them.
  std::vector<FramePose> trajectory;
  PoseCorrections corrections;  ///< see correct()
  /// The first pose of the recording (E_P,0): the world's axes are the body's there. A bounded
  /// recording keeps the axes of its poses, and the origin is its cube's center.
  Rigid3d global_from_world = Rigid3d::Identity();
  /// half the side of the cube around the world's origin that holds a bounded scene
  std::optional<double> half_side;
  UnitFromWorld unit_from_world;  ///< [-1, 1]^3 holds every point within far_m of a camera centre
  double near_m = 1, far_m = 10;
  int downscale = 1;       ///< applied by load_view to each image
  bool undistort = false;  ///< likewise
  Background background = Background::kNone;
  bool random_background = false;  ///< SceneOptions::random_background
  bool metric = true;              ///< Recording::metric: metres and seconds
  std::size_t unseen_frames = 0;   ///< left out by SceneOptions::shown_only
  /// Moving objects that the model draws; empty where it draws none.
  std::vector<MovingObject> actors;

  int camera_index(const std::string& name) const;  ///< -1 if there is none
  int frame_index(std::int64_t id) const;           ///< -1 if there is none

  /// Adds a frame to `frames` and its pose to `trajectory`; both must be earlier.
  void add_frame(const PosedFrame& frame);
  /// Applies corrections of the recorded poses instead of those applied before; empty ones: none.
  /// A pose at none of the scene's frames has the interpolated corrections of the frames around it.
  void correct(const PoseCorrections& corrections);
  /// Returns the trajectory with the corrections.
  std::vector<FramePose> corrected_trajectory() const;
  /// Returns the frames with their poses.
  std::vector<PosedFrame> posed_frames() const;

  /// Returns the pose of the body at a time, interpolated (recording/core/trajectory.h).
  Rigid3d world_from_body(std::int64_t t_ns, Poses which = Poses::kCorrected) const;
  /// Returns the pose of the body when the middle row of an image is exposed.
  Rigid3d world_from_body(const View& view, Poses which = Poses::kCorrected) const;
  /// Returns the poses of the body during the exposure of an image: one, or, for a rolling shutter,
  /// nine at even times from the upper edge to the lower one.
  std::vector<Rigid3d> body_during(const View& view, Poses which = Poses::kCorrected) const;
  /// Returns the time at which the middle row of an image is exposed.
  std::int64_t exposed_ns(const View& view, Poses which = Poses::kCorrected) const;
  /// Returns the poses of the camera then.
  std::vector<Rigid3d> camera_during(const View& view, Poses which = Poses::kCorrected) const;
  Rigid3d world_from_camera(
      const View& view) const;  ///< E_P,0^-1 E_P,n E_C of the report's equation (2)
  /// Returns world_from_camera of each row, with the actors.
  ShutterPoses shutter_poses(const View& view) const { return shutter_poses(view, actors); }
  /// Returns world_from_camera of each row, with these actors.
  ShutterPoses shutter_poses(const View& view, const std::vector<MovingObject>& with) const;
  /// Returns the poses with the actors where `camera` sees them at its exposure of a frame at this
  /// time.
  ShutterPoses with_actors(ShutterPoses poses, const RigCamera& camera,
                           std::int64_t frame_ns) const;
  Exposure exposure(int camera, std::int64_t t_ns) const;
  Exposure exposure(const View& view) const {
    return exposure(view.camera, frames[view.frame].t_ns);
  }

 private:
  /// What `corrections` corrects of a camera.
  struct Extrinsics {
    Rigid3d body_from_sensor;
    std::int64_t time_offset_ns = 0;
  };
  Extrinsics extrinsics(int camera, Poses which) const;
  Rigid3d corrected(const FramePose& pose) const;

  std::vector<Extrinsics> recorded_;  ///< one per camera; empty without corrections
};

/// Returns the colour that images are rendered and scored over, rgb in [0, 1].
std::array<float, 3> background_colour(Background background);

/// Returns a camera after SceneOptions::undistort and downscale. InputError if more
/// than 90 % of its pixels have no direction; UsageError for options that do not fit the camera.
RigCamera make_rig_camera(const CameraCalibration& calibration, const SceneOptions& options);

/// InputError/UsageError for an unknown camera (the known ones are listed), no frames left,
/// --undistort of a fisheye.
Scene make_scene(const Recording& recording, const SceneOptions& options);

}  // namespace redrive

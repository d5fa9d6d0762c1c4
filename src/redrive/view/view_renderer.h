// SPDX-License-Identifier: Apache-2.0
// Makes the viewer's output for a run: images, recorded images, scores, points.
#pragma once

#include <list>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include "redrive/eval/coverage.h"
#include "redrive/eval/novel_ground_truth.h"
#include "redrive/render/camera_path.h"
#include "redrive/render/renderer.h"
#include "redrive/train/run.h"
#include "redrive/train/training_data.h"
#include "redrive/view/server/messages.h"

namespace redrive::view {

/// A camera at a pose, with its context.
struct Placement {
  std::string camera_name;
  std::int64_t frame = 0;
  Camera camera;  ///< at full size
  Rigid3d world_from_camera, world_from_body;
  Exposure exposure;
  std::int64_t t_ns = 0;                         ///< time at which the camera sees moving objects
  std::vector<ShutterPoses::Actor> actors = {};  ///< at that time

  /// Returns the camera's pose with the actors.
  ShutterPoses poses() const {
    ShutterPoses poses = world_from_camera;
    poses.set_actors(actors);
    return poses;
  }
};

/// An image that is rendered strip by strip, so that the viewer can abandon it for a newer one.
class RenderJob {
 public:
  /// Renders the next strip. Returns whether the image is complete.
  bool step();
  const RenderedImage& image() const { return image_; }
  const Placement& placement() const { return placement_; }
  int factor() const { return factor_; }
  double seconds() const { return seconds_; }  ///< spent in step()

 private:
  friend class ViewRenderer;
  const Field* field_ = nullptr;  ///< null: there is none, the image is empty
  kernels::Backend* backend_ = nullptr;
  Placement placement_;
  int factor_ = 1;
  std::shared_ptr<const RayTable> table_;  ///< table of the whole image
  std::vector<std::shared_ptr<const RayTable>> strips_;
  std::size_t next_ = 0;
  std::shared_ptr<const Image8> recorded_;  ///< shown where there is no field
  RenderedImage image_;
  double seconds_ = 0;
};

/// Not thread-safe: images are made one at a time.
class ViewRenderer {
 public:
  /// Run and backend must outlive it. A run without a field shows only the recording: its images at
  /// the poses where they were taken, nothing elsewhere. InputError where a poses.json of a novel
  /// set is malformed.
  ViewRenderer(const Run& run, kernels::Backend& backend);

  /// Returns {"cameras", "frames", "held_out", "novel", "start": null or {"camera", "frame"}, ...}:
  /// what a page needs to know.
  nlohmann::json describe() const;

  /// `traffic`: has the moving objects. Throws InputError where the run has no such camera, frame
  /// or novel view.
  Placement place(const ViewRequest& request, const Scene& traffic);
  Placement place(const ViewRequest& request) { return place(request, run_.scene); }
  /// Places the request's camera at a key of a path, at whose time moving objects are shown; the
  /// request's frame gives the exposure.
  Placement place_at(const ViewRequest& request, const PathKey& key, const Scene& traffic);

  /// `strip_s`: time to spend in one step, for methods that march rays; rasterisers have one step.
  /// `expected_s`: time for the whole image.
  RenderJob begin(const ViewRequest& request, const Placement& placement, int factor,
                  double expected_s, double strip_s);

  /// Keeps the image memory of a finished job for the next begin().
  void reuse(RenderJob&& job);

  /// Returns the colours of a layer.
  Image8 colours(const RenderJob& job, Layer layer, const Scene& traffic);
  bool has_field() const { return run_.field() != nullptr; }

  /// Returns the recorded image, or the ground truth of a novel view, at the size of training;
  /// nothing where there is none. InputError where the file cannot be read.
  std::shared_ptr<const Image8> reference(const ViewRequest& request);

  /// Returns which pixels of the recorded image training and scores use; nothing where the run has
  /// no such image. InputError where a mask or a box file cannot be read.
  std::optional<Mask> mask(const ViewRequest& request);

  /// Returns the PSNR in dB like `redrive eval`, but with the pose of `placement`; nothing without
  /// a reference.
  std::optional<double> psnr_db(const ViewRequest& request, const RenderJob& job);

  /// Prepares seen_share() for some time. Returns whether it can be called; never where it is
  /// unknown: without a field, for a drive in blocks, and for methods whose views take seconds
  /// until the coverage layer was shown. InputError as Coverage.
  enum class Preparation { kMore, kReady, kNever };
  Preparation prepare_coverage(double seconds);
  /// Returns the share of the image's pixels whose surface some training image saw, 0 to 1.
  double seen_share(const RenderJob& job) const;

  /// Returns {"pixel", "opacity", "surface", "depth_m", "world_m", "body_m", "ecef_m", "wgs84"} of
  /// the surface at (u, v), 0..1 over the image, and "object", null or the id of the moving object
  /// there that no surface hides.
  nlohmann::json pick(const RenderJob& job, double u, double v, const Scene& traffic) const;

  /// Forgets what was computed from the field before it changed.
  void forget_field();

  /// Searches the training images that saw a point. InputError as read_exclusions.
  PointSearch begin_search(const Eigen::Vector3d& point_in_world);
  bool step(PointSearch* search);  ///< returns whether there is more to do
  /// Returns {"seen", "of", "nearest": [{"camera", "frame", "distance_m"}, ..]}: numbers of images
  /// that saw the point and of all training images, and the nearest images that saw it.
  nlohmann::json found(const PointSearch& search) const;

  const Run& run() const { return run_; }

 private:
  std::shared_ptr<const GroundTruthView> ground_truth(const NovelView& novel);
  std::shared_ptr<const RayTable> table(const Camera& camera, const std::string& name, int factor);
  const View* find_view(const std::string& camera, std::int64_t frame) const;
  RigCamera requested_camera(const ViewRequest& request) const;
  Exposure exposure_of(const ViewRequest& request, const std::string& camera) const;
  void add_traffic(const Scene& traffic, const RigCamera& camera,
                   std::optional<std::int64_t> frame_ns, Placement* placement) const;
  nlohmann::json depth_scale() const;
  double farthest_shown_m() const;  ///< far end of the layer of depth
  std::optional<std::int64_t> time_of(std::int64_t frame) const;

  const Run& run_;
  kernels::Backend& backend_;
  bool marches_rays_;
  std::vector<NovelGroundTruth> novel_;
  // The last used ones, latest first:
  std::list<std::pair<NovelView, std::shared_ptr<const GroundTruthView>>> ground_truths_;
  std::list<std::pair<std::pair<std::string, int>, std::shared_ptr<const RayTable>>> tables_;
  std::list<std::pair<std::pair<std::string, std::int64_t>, std::shared_ptr<const Image8>>>
      references_;
  RenderedImage spare_;                        ///< memory of an earlier job
  std::optional<Exclusions> exclusions_;       ///< read for the first mask or score
  std::unique_ptr<Coverage> coverage_;         ///< made for the first coverage
  bool has_coverage_ = false;                  ///< has the coverage of all its views
  std::unique_ptr<PointObservers> observers_;  ///< made for the first search
};

}  // namespace redrive::view

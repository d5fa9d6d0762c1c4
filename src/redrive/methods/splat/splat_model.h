// SPDX-License-Identifier: Apache-2.0
// --method splat: 3D Gaussians, rasterised (Kerbl et al. 2023), through the exact camera of every
// image (field/gaussian.h). A step takes one image, or a window of a large one. Each moving object,
// annotated or found (Scene::actors), has Gaussians in the axes of its box. Hyperparameters:
// splat_model_config.cc; first Gaussians: initial_gaussians.h, actor_gaussians.h; their number:
// densify_gaussians.h.
#pragma once

#include <algorithm>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "redrive/edit/actor_body.h"
#include "redrive/kernels/gaussian/gaussian_stages.h"
#include "redrive/methods/splat/actors/actor_motion.h"
#include "redrive/methods/splat/actors/drawn_gaussians.h"
#include "redrive/methods/splat/densify_gaussians.h"
#include "redrive/methods/splat/image_gains.h"
#include "redrive/methods/splat/initial_gaussians.h"
#include "redrive/methods/splat/lidar/scan_loss.h"
#include "redrive/model/method.h"

namespace redrive {

constexpr float kBeyondBox_m = 0.2f;  ///< an actor's Gaussians may be this far outside its box

class SurfacePlanes;
struct ScanBuffers;

struct SplatModel final : Trainee, FieldGaussians {
  InitialGaussianOptions initial;
  int max_gaussians = 400000;
  int pixel_limit = 20'000'000;  ///< upper limit from the number of pixels to train on
  int window_pixels = 260000;    ///< pixels of a step; larger images are cut into windows
  float coarse_progress = 0.6f;  ///< part of the run at half size, for images that are cut
  double initial_rate = 0.1, last_rate = 0.2;
  /// Learning rates as multiples of the opacity's.
  float position_rate = 0.008f, scale_rate = 0.4f, rotation_rate = 0.16f, colour_rate = 0.3f,
        harmonics_rate = 0.01f, intensity_rate = 0.2f, return_rate = 0.5f;
  float l1_weight = 0.8f, ssim_weight = 0.2f;
  float range_weight = 0.1f;  ///< weight of LiDAR returns in images
  int scan_every = 8;         ///< steps after which a part of a LiDAR scan is rendered; 0: never
  ScanWeights scan_weights;
  int scans_first = 320;         ///< parts of LiDAR scans that train before the first image
  float surface_rate = 0.5f;     ///< part of the way to a LiDAR plane in a call
  float opacity_weight = 0.02f;  ///< weight of transmittance, unless a background is given
  int lidar_rays = 1;            ///< 0: LiDAR is not used
  int actors = 1;                ///< 0: moving objects are not drawn
  /// learning rate of tracks' corrections, m; a tenth of it, rad, for rotations
  float motion_rate = 0.1f;
  /// least scale of the two larger axes, largest scale of any, as parts of the distance
  float min_scale = 2e-4f, max_scale = 1;
  float min_opacity = 0.01f;                       ///< least opacity of Gaussians that are kept
  int densify_every = 100;                         ///< steps
  float replaced = 0.04f;                          ///< DensifyOptions
  float grown_by = 0.6f, densified_until = 0.85f;  ///< progress
  /// Steps between two states in the mean with which training ends, from densified_until on; 0: it
  /// ends with the last state.
  int averaged_every = 5;
  int warm_up_steps = 50;
  float beta2 = 0.99f, epsilon = 1e-15f;  ///< Adam's
  ImageGains gains;
  // State:
  int gaussians = 0;         ///< number of Gaussians of the world
  int first_gaussians = 0;   ///< number at the start, with the actors'
  int unseen_gaussians = 0;  ///< number at the start that no image sees
  /// One per actor, or part of an articulated one (actors/articulated.h), parts in a row:
  /// MovingObject::id, and the end of its blocks (GaussianLayout).
  std::vector<std::int64_t> actor_ids, actor_ends;
  /// likewise: the end of its track's keys (actor_motion.h)
  std::vector<std::int64_t> actor_keys;
  int filled = 0;  ///< 1: finish_training() was called since the last step
  float background[3] = {0.5f, 0.5f, 0.5f};  ///< where no Gaussian is: the images' mean colour

  const char* method() const override { return "splat"; }
  void freeze() override;
  int most_gaussians() const { return std::min(max_gaussians, pixel_limit) + unseen_gaussians; }
  std::string describe() const override;
  void visit_hyperparameters(HyperparameterVisitor& visit) override;
  void visit_state(HyperparameterVisitor& visit) override;
  void check(const HyperparameterFailure& fail) const override;
  void configure(const Scene& scene) override;
  std::size_t size() const override { return blocks_size() + gains.size() + actors_size(); }
  std::size_t max_size() const override;
  std::vector<ModelTensor> tensors() const override;
  void initialize(std::uint64_t seed) override;
  void initialize_from(const TrainingSet& data, std::uint64_t seed, ThreadPool& pool) override;
  bool uses_lidar() const override { return lidar_rays > 0; }
  bool streams_images() const override { return true; }
  bool keeps_half_images(const Scene& scene) const override;
  bool draws_actors() const override { return actors > 0; }
  void check_actors(const std::filesystem::path& recording, const std::filesystem::path& found,
                    const std::vector<MovingObject>& objects) const override;
  void correct_actors(std::vector<MovingObject>* objects) const override;
  std::string describe_batch() const override { return "1 image"; }
  std::int64_t steps_per_epoch(const TrainingSet& data, int world_size) const override;
  /// Fits planes to the LiDAR returns (surface_planes.h).
  void prepare(const TrainingSet& data, ThreadPool& pool, StepBuffers* buffers) const override;
  /// Trains on parts of the LiDAR scans.
  bool train_first(kernels::Backend& backend, const TrainingSet& data, std::uint64_t seed,
                   AdamState* adam, const std::function<bool()>& go_on) override;
  StepOutput step(kernels::Backend& backend, const TrainingSet& data, const StepRequest& request,
                  std::span<float> gradients, StepBuffers* buffers) const override;
  /// Pixels of one image are alike, and images differ: some ten thousand count as 32.
  std::int64_t independent_pixels(std::int64_t pixels) const override { return pixels / 8192; }
  std::vector<LossTerm> loss_terms(const StepSums& sums) const override;
  std::span<const float> sentinels(std::span<const float> gradients) const override {
    return others_of(gradients);
  }
  std::size_t updated_in_step() const override { return blocks_size(); }
  std::size_t numbers_per_error() const override { return kGaussianRows; }
  std::optional<std::size_t> bad_moment(std::span<const std::uint32_t> packed) const override;
  double learning_rate(const Schedule& at) const override;
  std::string describe_schedule(std::int64_t total_steps) const override;
  void update(kernels::Backend& backend, double learning_rate, std::int64_t step,
              std::span<float> gradients, AdamState* adam) override;
  void finish_step(kernels::Backend& backend, const StepRequest& request, const StepOutput& output,
                   std::int64_t step, const StepBuffers& buffers, AdamState* adam) override;
  void fetch(kernels::Backend& backend) const override;
  int average_every(double progress) const override {
    return progress < double(densified_until) ? 0 : averaged_every;
  }
  void replace_parameters(Buffer<float> by) override;
  /// Fills places that objects hide in all images (fill_hidden.h).
  void finish_training(kernels::Backend& backend, const TrainingSet& data,
                       AdamState* adam) override;
  void render_to(kernels::Backend& backend, const RayTable& rays,
                 const ShutterPoses& world_from_camera, const Exposure& exposure,
                 RenderedImage* image) const override;
  RenderedRays trace(kernels::Backend& backend, const kernels::Rays& rays,
                     const std::vector<MovingObject>& actors = {}) const override;
  const FieldGaussians* as_gaussians() const override { return this; }
  WorldGaussians world() const override {
    return {world_gaussians(), {}, {background[0], background[1], background[2]}};
  }
  bool has_body(std::int64_t id) const override { return !blocks_of(id, nullptr).empty(); }
  ActorBody body(const MovingObject& actor) const override;
  std::uint64_t step_bytes() const override;
  std::uint64_t device_bytes(kernels::Backend& backend) const override;
  std::uint64_t lidar_bytes(const Scene& scene, std::uint64_t returns) const override;

  /// Replaces the Gaussians by the world's and each actor's; divides articulated ones.
  void set_gaussians(std::vector<GaussianList> lists, std::span<const MovingObject> actors);
  GaussianLayout layout() const { return {static_cast<std::size_t>(gaussians), actor_ends}; }

 private:
  static std::uint64_t new_version();
  std::uint64_t version_ = new_version();  ///< kernels::Gaussians::version
  /// To be called after changes of the Gaussians other than a step's updates.
  void renew_version() { version_ = new_version(); }

  kernels::Gaussians world_gaussians() const {
    const auto n = static_cast<std::size_t>(gaussians);
    return {n, parameters.span().first(gaussian_blocks(n) * kBlockSize), version_};
  }
  /// All Gaussians, with the unused lanes between the world's and the actors'.
  kernels::Gaussians all() const {
    return {actor_ends.empty() ? static_cast<std::size_t>(gaussians)
                               : layout().blocks() * kGaussianBlock,
            parameters.span().first(blocks_size()), version_};
  }
  /// Returns all Gaussians, with a part for each of actor_ids where objects look as trained.
  DrawnGaussians drawn(std::vector<ShutterPoses::Actor> actors) const;
  /// How far ahead of an actor's box its Gaussians may be: farther in the dark.
  float ahead_m() const;
  /// Sets the background to the mean colour of the images.
  void set_background(const TrainingSet& data);
  /// Maximum number of Gaussians that finish_training() adds; training leaves room for them.
  int most_fills() const { return actor_ids.empty() ? 0 : most_gaussians() / 100; }
  /// Changes the number of Gaussians (densify_gaussians.h).
  void change_number(const DensifyOptions& options, std::uint64_t key, AdamState* adam,
                     ThreadPool& pool);
  struct WindowStep;
  /// Returns the planes that prepare() found; null: none.
  static const SurfacePlanes* surfaces_of(const StepBuffers& buffers);
  AdamStep adam_step_of(double learning_rate, std::int64_t step) const;
  kernels::GaussianUpdate gaussian_update(const StepUpdate& at, SeenBy rows) const;
  /// Sets the planes of ranges of a window; returns their number.
  int set_ranges(const TrainingSet& data, const WindowStep& step, ThreadPool& pool,
                 MethodBuffers* buffers) const;
  /// Adds a window's losses, times `weight`, and gradients, or updates the Gaussians.
  void step_window(kernels::Backend& backend, const TrainingSet& data, const StepRequest& request,
                   const WindowStep& step, std::span<float> gradients, MethodBuffers* buffers,
                   double weight, StepSums* sums, StepOutput* out) const;
  enum LossSlot { kL1Loss, kSsimLoss, kOpacityLoss, kRangeLoss, kScanLoss };
  /// Returns the rows of Gaussians that a step, from 0, changes.
  SeenBy rows_of_step(std::int64_t step) const {
    const bool scan = uses_lidar() && scan_every > 0 && step % scan_every == 0;
    return scan ? SeenBy::kBoth : SeenBy::kCamera;
  }
  /// Whether a step renders a part of a LiDAR scan, too.
  bool has_scan(const TrainingSet& data, const StepRequest& request) const;
  /// Adds the loss of part `draw` of the scans in the order of `key`, times `weight`, and
  /// gradients, or updates the Gaussians.
  void step_scan(kernels::Backend& backend, const TrainingSet& data, const StepRequest& request,
                 std::uint64_t key, std::uint64_t draw, std::span<float> gradients,
                 ScanBuffers* buffers, StepSums* sums) const;
  /// Returns the gradients with respect to the parameters behind the Gaussians.
  template <class T>
  std::span<T> others_of(std::span<T> gradients) const {
    const std::size_t n = size() - blocks_size();
    return gradients.subspan(gradients.size() == n ? 0 : blocks_size(), n);
  }
  std::size_t blocks_size() const { return layout().blocks() * kBlockSize; }
  std::span<const float> gain_parameters() const {
    return parameters.span().subspan(blocks_size(), gains.size());
  }
  std::size_t bounds_size() const { return 3 * actor_ids.size(); }
  /// Bounds, then corrections of the tracks.
  std::size_t actors_size() const {
    return bounds_size() +
           (actor_keys.empty() ? 0 : kMotionSize * static_cast<std::size_t>(actor_keys.back()));
  }
  /// Indices [first, end) in actor_ids of an object; nothing where it has none.
  struct ActorParts {
    std::size_t first = 0, end = 0;
    std::size_t size() const { return end - first; }
  };
  std::optional<ActorParts> actor_parts(std::int64_t id) const;
  /// Returns the point about which part `a` of actor_ids turns, in the axes of its box.
  Eigen::Vector3d pivot(std::size_t a, const ActorParts& parts) const;
  /// Returns the index of the middle part, with which the object moves.
  std::size_t track_part(const ActorParts& parts) const;
  /// Returns poses of a camera in the axes of part `a`, from those in the axes of the corrected
  /// box.
  std::vector<PlainPose> part_from_camera(std::size_t a, const ActorParts& parts,
                                          const ShutterPoses::Actor& seen) const;
  /// Returns the blocks that an object shows: `imported`, or the blocks of the actor with this id;
  /// empty where there are none.
  std::span<const float> blocks_of(std::int64_t id, const ActorBody* imported) const;
  std::span<const float> blocks_of_part(std::size_t a) const;
  /// Offset, behind the blocks of Gaussians in `parameters`, and size of an actor's corrections.
  std::pair<std::size_t, std::size_t> motions_of(std::size_t actor) const;
  std::span<const float> motion_parameters(std::size_t actor) const {
    const auto [first, n] = motions_of(actor);
    return parameters.span().subspan(blocks_size() + first, n);
  }
  /// Corrects where the camera sees the actors at t_ns; tracks of the scene that are corrected
  /// already stay.
  ShutterPoses shutter_poses(const Scene& scene, const View& view) const;
  /// Returns the number of tracks whose gradient is not finite: it is left out.
  int add_motion_gradients(const Scene& scene, std::int64_t t_ns, const DrawnGaussians& drawn,
                           std::span<const GaussianPoseGradient<NumberMath<double>>> d_poses,
                           std::span<float> gradients) const;
};

Method splat_method();
bench::MethodBenchmarks splat_benchmarks();  ///< splat_benchmark.cc

}  // namespace redrive

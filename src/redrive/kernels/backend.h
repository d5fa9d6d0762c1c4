// SPDX-License-Identifier: Apache-2.0
// THE SEAM between what is computed and how. `what` is the scalar functions of field/, volume/
// and optim/; `how` is a Backend: batched stages over 10^4..10^6 samples, the same
// signature on every backend. Spans and sizes only. Sizes are checked (REDRIVE_CHECK); non-finite
// results are the caller's to look for. A stage leaves its loss in `loss`, a number of the
// caller's: where that is kept, nobody waits for it before it is fetched. The fused stages at the
// end are optional extras: their default is the composition of the plain ones.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <type_traits>
#include <vector>

#include "redrive/base/buffer.h"
#include "redrive/base/cpu_features.h"
#include "redrive/field/nerf_field.h"
#include "redrive/field/unit_from_world.h"
#include "redrive/kernels/gather/gather_pixels.h"
#include "redrive/kernels/gather/gather_returns.h"
#include "redrive/kernels/grid_stages.h"
#include "redrive/optim/adam.h"

namespace redrive::kernels {

/// Rays in world metres, structure of arrays: origin [3, n], direction [3, n] (unit length).
struct Rays {
  int n = 0;
  std::span<const float> origin, direction;
};

/// Samples along rays: t [n_rays, per_ray] ascending, metres from the origin; dt [n_rays, per_ray]
/// >= 0, the last of a ray may be +infinity (volume/composite.h).
struct Samples {
  int per_ray = 0;
  std::span<const float> t, dt;
};

/// A field with its parameters (field/nerf_field.h) in the world of the scene.
struct NerfField {
  NerfConfig config;
  UnitFromWorld unit_from_world;
  std::span<const float> parameters;
};

/// Per ray: rgb [3, n_rays], depth [n_rays] (metres, sum of w t), opacity [n_rays]; per sample:
/// weights [n_rays, per_ray], may be empty (not wanted).
struct CompositeOut {
  std::span<float> rgb, depth, opacity, weights;
};

/// What the colours of a batch are worth to the loss: d_rgb [3, n_rays], and d_weights [n_rays,
/// per_ray] of losses on the weights themselves; may be empty.
struct CompositeAdjoint {
  std::span<const float> d_rgb, d_weights;
};

/// What the loss changes with each ray's place and direction by way of its samples' places:
/// d_origin, d_direction [3, n_rays], added to; both empty: not wanted. Distances of samples and
/// what colours change with the direction are taken as they are.
struct RayGradients {
  std::span<float> d_origin, d_direction;
  bool wanted() const { return !d_origin.empty(); }
};

/// How samples are drawn: per_ray bins of equal length in [near_m, far_m], one sample in each (NeRF
/// eq. 2), uniform random by random_unit(key, ray * per_ray + i), or the middle of the bin when
/// `jitter` is off (rendering). dt_i = t_{i+1} - t_i, the last +infinity.
struct StratifiedSampling {
  int per_ray = 0;
  float near_m = 0, far_m = 0;
  bool jitter = true;
  std::uint64_t key = 0;
};

/// A picture and the truth of it: rgb [height, width, 3] in [0, 1], truth likewise, 8 bits a
/// channel; mask [height, width], 0 where a pixel does not count, or empty: all do.
struct ImagePair {
  int width = 0, height = 0;
  std::span<const float> rgb;
  std::span<const std::uint8_t> truth, mask;
};

/// How alike they are; NaN where nothing counts. What does not count is black in both pictures
/// where a filter or a window reaches it.
struct ImageScore {
  double psnr_db = 0;  ///< 10 log10(1 / MSE) over all three channels; +infinity for equal pictures
  double ssim = 0;  ///< optim/ssim.h, mean over channels and the pixels at least 5 from the border
  double flip = 0;  ///< optim/flip.h, mean over the pixels; in [0, 1], 0 for equal pictures
};

/// The most that a device does, measured: its roofline.
struct Ceilings {
  double gflops = 0;       ///< a multiply-add is two
  std::string arithmetic;  ///< of which instruction
  double copy_gb_per_s =
      0;  ///< 1e9 bytes, read and written, from its memory to another place there
};

/// What a counting backend was asked for (Backend::counting).
struct MemoryCount {
  std::uint64_t now = 0, most = 0;
  bool all_active = false;  ///< what GridStages::live_rays finds: all of them, or all but one
};

class Backend {
 public:
  virtual ~Backend() = default;

  virtual std::string name() const = 0;        ///< "ref", "cpu", "cuda"
  virtual std::optional<Isa> isa() const = 0;  ///< cpu only
  virtual int threads() const = 0;

  // ---- where numbers are. A backend with memory of its own copies what a stage is given there and
  // back, but for numbers that it keeps.
  /// Takes numbers there as they are now. As long as the handle lives, stages read and change them
  /// there, and the host has of them what it fetches and says what it puts; null: they are where
  /// they are. keep() below keeps a buffer.
  virtual std::shared_ptr<void> keep(std::span<const float> /*numbers*/) { return nullptr; }
  virtual void fetch(std::span<const float> /*part*/) {
  }  ///< of what is kept: the host's copy becomes what it is there
  virtual void put(std::span<const float> /*part*/) {
  }  ///< the other way: after the host has changed it
  virtual bool keeps(std::span<const float> /*numbers*/) const {
    return false;
  }  ///< stages find them there
  virtual void wait() {
  }  ///< until all that stages were asked for is done: for clocks, the rest need not know
  // Of a device with memory of its own; the others have the host's and say nothing.
  virtual std::optional<std::string> device() const {
    return std::nullopt;
  }  ///< which one, in words
  virtual std::optional<std::uint64_t> free_memory() { return std::nullopt; }  ///< bytes
  virtual std::optional<Ceilings> ceilings() {
    return std::nullopt;
  }  ///< takes some tenths of a second
  /// The same stages, which compute nothing and count the memory that they would take: what comes
  /// to the host is 0. `bytes` must outlive it and what it keeps.
  virtual std::unique_ptr<Backend> counting(MemoryCount* /*bytes*/) const { return nullptr; }
  // What a caller would do itself if all numbers were its own; the default does it on the host.
  virtual void fill(std::span<float> numbers, float value);
  /// Summed in double, in a fixed order; of at least one.
  virtual void mean(std::span<const float> numbers, double* mean);
  /// 0 if all of them are numbers and none infinite, else more.
  virtual void not_finite(std::span<const float> numbers, double* count);

  // ---- rays/
  /// The rays of `draw` (PixelSampler::draw) from their pictures: `out` as resize_batch says;
  /// errors of the cells, empty if none is drawn by them. A backend with memory of its own keeps
  /// the source there from the first time on, poses anew when they have changed.
  virtual void gather(const PixelSource& from, const PixelDraw& draw, std::span<const float> errors,
                      const GatheredRays& out);
  /// The same of a LiDAR's returns: `draw` is LidarSampler's.
  virtual void gather_lidar(const LidarSource& from, const LidarDraw& draw,
                            const GatheredReturns& out);
  /// kernels/gather/error_map.h: the squared errors of rays drawn in cells [n], one after the
  /// other, into the errors of the cells.
  virtual void update_error_map(std::span<const std::uint32_t> cells,
                                std::span<const float> squares, std::span<float> errors);

  // ---- volume/
  virtual void sample_stratified(int n_rays, const StratifiedSampling& how, std::span<float> t,
                                 std::span<float> dt) = 0;
  /// Hierarchical sampling (NeRF section 5.2): `extra` further samples per ray from the
  /// piecewise-constant density that `weights` of `coarse` describe
  /// (volume/hierarchical_sampling.h), merged with the coarse ones, ascending. jitter/key as above
  /// (key index ray * extra + i). t, dt: [n_rays, coarse.per_ray + extra].
  virtual void sample_hierarchical(const Samples& coarse, std::span<const float> weights, int extra,
                                   bool jitter, std::uint64_t key, std::span<float> t,
                                   std::span<float> dt) = 0;

  // ---- field/
  /// raw [4, n_rays * per_ray]: r, g, b before the sigmoid, density before the ReLU.
  virtual void nerf_forward(const NerfField& field, const Rays& rays, const Samples& samples,
                            std::span<float> raw) = 0;
  /// Adds d loss / d parameters to `gradients` [n_parameters], and to of_rays where they are
  /// wanted, given d_raw (same shape as raw). Recomputes the forward pass.
  virtual void nerf_backward(const NerfField& field, const Rays& rays, const Samples& samples,
                             std::span<const float> d_raw, std::span<float> gradients,
                             const RayGradients& of_rays) = 0;

  // ---- volume/
  /// background [3, n_rays], or empty: black.
  virtual void composite_forward(int n_rays, const Samples& samples, std::span<const float> raw,
                                 std::span<const float> background, const CompositeOut& out) = 0;
  virtual void composite_backward(int n_rays, const Samples& samples, std::span<const float> raw,
                                  std::span<const float> background,
                                  const CompositeAdjoint& adjoint, std::span<float> d_raw) = 0;

  // ---- optim/
  /// Mean squared error over n_rays x 3 (optim/photometric_loss.h); d_rgb [3, n_rays]. Summed in
  /// double, in a fixed order.
  virtual void photometric_loss(std::span<const float> rgb, std::span<const float> target,
                                std::span<float> d_rgb, double* loss) = 0;

  // ---- optim/
  /// One Adam step (optim/adam.h) over all parameters. Leaves gradients 0, for the next step to add
  /// to.
  virtual void adam(const AdamStep& step, std::span<float> gradients, std::span<float> parameters,
                    std::span<float> first_moment, std::span<float> second_moment) = 0;

  // ---- the stages of --method grid
  virtual GridStages& grid() = 0;

  // ---- of whole pictures
  /// The default does it on the host, in one thread. The number of threads changes no bit.
  virtual ImageScore score(const ImagePair& pictures);

  // ---- fused extras
  /// Forward, compositing, loss and backward of a batch: adds to `gradients` and of_rays as
  /// nerf_backward does, fills `out` (weights only if wanted). target [3, n_rays].
  virtual void train_rays(const NerfField& field, const Rays& rays, const Samples& samples,
                          std::span<const float> target, const CompositeOut& out,
                          std::span<float> gradients, const RayGradients& of_rays, double* loss);
  /// Forward and compositing, without keeping anything for a backward pass. May leave out what
  /// stands behind a transmittance below 1e-4, which changes colour, opacity and the sum of the
  /// weights by less than that.
  virtual void render_rays(const NerfField& field, const Rays& rays, const Samples& samples,
                           const CompositeOut& out);

 private:
  /// Room for n numbers that go from stage to stage of the fused extras' default, kept where the
  /// stages compute.
  std::span<float> scratch_between_stages(int which, std::size_t n);
  Buffer<float> scratch_between_stages_[3];
};

/// Numbers of any type as keep, fetch and put take them.
template <class T>
std::span<const float> as_floats(std::span<const T> numbers) {
  static_assert(std::is_trivially_copyable_v<T> && sizeof(T) % sizeof(float) == 0);
  return {reinterpret_cast<const float*>(numbers.data()),
          numbers.size() * (sizeof(T) / sizeof(float))};
}

/// Keeps a buffer where the backend computes for as long as it lives, if that is elsewhere. One
/// buffer, one backend.
template <class T>
void keep(Backend& backend, const Buffer<T>& numbers) {
  if (!numbers.elsewhere) numbers.elsewhere = backend.keep(as_floats(numbers.span()));
}
template <class T>
void fetch(Backend& backend, const std::vector<T>& numbers) {
  backend.fetch(as_floats(std::span<const T>(numbers)));
}

/// --backend and --isa. `name` "auto": with `isa` "auto", too, cuda where there is a GPU that
/// passes its self-test (self_test.h); else cpu where the processor has AVX2, else ref. UsageError
/// says why a choice is impossible.
struct BackendChoice {
  std::string name = "auto";  ///< auto, ref, cpu, cuda
  std::string isa = "auto";   ///< auto, avx2, avx512, avx512-bf16, amx-bf16
  int threads = 0;            ///< 0: all that the process may use
};
std::unique_ptr<Backend> make_backend(const BackendChoice& choice);

std::unique_ptr<Backend> make_ref_backend();
std::unique_ptr<Backend> make_cpu_backend(Isa isa, int threads);

/// "backend=cpu isa=amx-bf16 threads=2": printed at start-up.
std::string describe(const Backend& backend);

}  // namespace redrive::kernels

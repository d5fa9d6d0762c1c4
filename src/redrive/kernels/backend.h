// SPDX-License-Identifier: Apache-2.0
// The backend interface: batched stages over 10^4..10^6 rays or samples, with the same signature on
// every backend. The formulas are scalar functions (field/, volume/, optim/); a backend decides
// where and in which arithmetic a batch goes through them.
//
// Backend has the stages that every method uses. A method's own stages form a set beside it
// (nerf_stages.h, grid_stages.h) with one accessor here.
//
// Conventions. Stages take spans and sizes only, and check the sizes (REDRIVE_CHECK). They let
// non-finite values through: the caller looks for them (not_finite). A stage writes its loss to
// `*loss`; if that number is resident on a device, the host waits for it only when it downloads it.
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
#include "redrive/kernels/gather/gather_pixels.h"
#include "redrive/kernels/gather/gather_returns.h"
#include "redrive/kernels/rays.h"
#include "redrive/optim/adam.h"

namespace redrive::kernels {

class NerfStages;
class GridStages;
class GaussianStages;

/// Results of compositing. Per ray: rgb [3, n_rays], depth [n_rays] (metres, sum of w t), opacity
/// [n_rays]; per sample: weights [n_rays, per_ray], empty if not wanted.
struct CompositeOut {
  std::span<float> rgb, depth, opacity, weights;
};

/// Derivatives of the loss with respect to compositing's results: d_rgb [3, n_rays]; d_weights
/// [n_rays, per_ray] for losses on the weights themselves, or empty.
struct CompositeOutGradient {
  std::span<const float> d_rgb, d_weights;
};

/// An image and its ground truth: rgb [height, width, 3] in [0, 1]; ground_truth in the same
/// layout, 8 bits a channel; mask [height, width], 0 where a pixel does not count, or empty: all
/// count.
struct ImagePair {
  int width = 0, height = 0;
  std::span<const float> rgb;
  std::span<const std::uint8_t> ground_truth, mask;
};

/// Similarity of an image pair; NaN where no pixel counts. Masked pixels are black in both images
/// where a filter or a window reaches them.
struct ImageScore {
  double psnr_db = 0;  ///< 10 log10(1 / MSE) over all three channels; +infinity for equal images
  double ssim = 0;  ///< optim/ssim.h, mean over channels and the pixels at least 5 from the border
  double flip = 0;  ///< optim/flip.h, mean over the pixels; in [0, 1], 0 for equal images
};

class Backend {
 public:
  virtual ~Backend() = default;

  virtual std::string name() const = 0;        ///< "ref", "cpu"
  virtual std::optional<Isa> isa() const = 0;  ///< cpu only
  virtual int threads() const = 0;

  // ---- memory. A backend with memory of its own copies a stage's arguments there and its results
  // back, except for numbers that are resident. The other backends use the host's memory, and these
  // functions do nothing.
  /// Copies numbers to the backend's memory. While the returned handle lives, stages read and
  /// change that copy, and the host's is out of date until it is downloaded. Null where the backend
  /// uses the host's memory. make_resident() below takes a buffer.
  virtual std::shared_ptr<void> make_resident(std::span<const float> /*numbers*/) {
    return nullptr;
  }
  virtual bool is_resident(std::span<const float> /*numbers*/) const { return false; }
  /// Updates the host's copy of a part of what is resident.
  virtual void download(std::span<const float> /*part*/) {}
  /// Updates the resident copy of a part after the host has changed it.
  virtual void upload(std::span<const float> /*part*/) {}

  // ---- vectors; the defaults run on the host
  virtual void fill(std::span<float> numbers, float value);
  /// Mean of at least one number, summed in double in a fixed order.
  virtual void mean(std::span<const float> numbers, double* mean);
  /// Writes 0 if all numbers are finite, else more.
  virtual void not_finite(std::span<const float> numbers, double* count);

  // ---- gather/: training rays; the defaults run on the host
  /// Writes the rays of `draw` (PixelSampler::draw) to `out`, sized by resize_batch. `errors`: one
  /// per cell of the error map, or empty if no ray is drawn by it. A backend with memory of its own
  /// copies the source at the first call, and its poses again after they have changed.
  virtual void gather_pixels(const PixelSource& from, const PixelDraw& draw,
                             std::span<const float> errors, const GatheredRays& out);
  /// Writes the LiDAR rays of `draw` (LidarSampler::draw) to `out`.
  virtual void gather_returns(const LidarSource& from, const LidarDraw& draw,
                              const GatheredReturns& out);
  /// Updates `errors` by the squared errors of rays drawn in `cells` [n], in order
  /// (gather/error_map.h).
  virtual void update_error_map(std::span<const std::uint32_t> cells,
                                std::span<const float> squares, std::span<float> errors);

  // ---- volume/
  /// raw [4, n_rays * per_ray]: r, g, b before the sigmoid, density before the ReLU; background [3,
  /// n_rays], or empty: black.
  virtual void composite_forward(int n_rays, const Samples& samples, std::span<const float> raw,
                                 std::span<const float> background, const CompositeOut& out) = 0;
  virtual void composite_backward(int n_rays, const Samples& samples, std::span<const float> raw,
                                  std::span<const float> background,
                                  const CompositeOutGradient& d_out, std::span<float> d_raw) = 0;

  // ---- optim/
  /// Mean squared error over n_rays x 3 (optim/photometric_loss.h), summed in double in a fixed
  /// order; writes d_rgb [3, n_rays].
  virtual void photometric_loss(std::span<const float> rgb, std::span<const float> target,
                                std::span<float> d_rgb, double* loss) = 0;
  /// One Adam step (optim/adam.h) over all parameters. Sets the gradients to 0 for the next step.
  virtual void adam(const AdamStep& step, std::span<float> gradients, std::span<float> parameters,
                    std::span<float> first_moment, std::span<float> second_moment) = 0;

  // ---- whole images
  /// The default runs on the host in one thread. The number of threads changes no bit.
  virtual ImageScore score(const ImagePair& images);

  // ---- stages of one method
  virtual NerfStages& nerf() = 0;
  virtual GridStages& grid() = 0;
  virtual GaussianStages& gaussians() = 0;
};

/// Numbers of any type as the memory functions take them.
template <class T>
std::span<const float> as_floats(std::span<const T> numbers) {
  static_assert(std::is_trivially_copyable_v<T> && sizeof(T) % sizeof(float) == 0);
  return {reinterpret_cast<const float*>(numbers.data()),
          numbers.size() * (sizeof(T) / sizeof(float))};
}

/// Makes a buffer resident for as long as it lives. One buffer, one backend.
template <class T>
void make_resident(Backend& backend, const Buffer<T>& numbers) {
  if (!numbers.resident) numbers.resident = backend.make_resident(as_floats(numbers.span()));
}
template <class T>
void download(Backend& backend, const std::vector<T>& numbers) {
  backend.download(as_floats(std::span<const T>(numbers)));
}

/// --backend and --isa. `name` "auto": cpu where the processor has AVX2, else ref.
struct BackendChoice {
  std::string name = "auto";  ///< auto, ref, cpu
  std::string isa = "auto";   ///< auto, avx2, avx512, avx512-bf16, amx-bf16
  int threads = 0;            ///< 0: all that the process may use
};
/// UsageError: the choice is impossible, and why.
std::unique_ptr<Backend> make_backend(const BackendChoice& choice);

std::unique_ptr<Backend> make_ref_backend();
std::unique_ptr<Backend> make_cpu_backend(Isa isa, int threads);

/// "backend=cpu isa=amx-bf16 threads=2": printed at start-up.
std::string describe(const Backend& backend);

}  // namespace redrive::kernels

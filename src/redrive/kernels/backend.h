// SPDX-License-Identifier: Apache-2.0
// The backend interface: batched stages over 10^4..10^6 rays or samples, with the same signature on
// every backend. The formulas are scalar functions (field/, volume/, optim/); a backend decides
// where and in which arithmetic a batch goes through them.
//
// Backend has the stages that every method uses. A method's own stages form a set beside it
// (nerf_stages.h, grid_stages.h) with one accessor here.
//
// Conventions. Stages take spans and sizes only, and check the sizes (REDRIVE_CHECK). They let
// non-finite values through: the caller looks for them (base/numbers.h). A stage writes its loss to
// `*loss`.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "redrive/base/cpu_features.h"
#include "redrive/base/parallel.h"
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
  /// likewise of the mean of the channels, in which demosaicing leaves less than in red or blue
  double luma_psnr_db = 0;
  std::array<double, 3> channel_psnr_db{};  ///< likewise of red, green, blue
  double ssim = 0;  ///< optim/ssim.h, mean over channels and the pixels at least 5 from the border
  double flip = 0;  ///< optim/flip.h, mean over the pixels; in [0, 1], 0 for equal images
};

/// To use by one thread at a time, with everything that takes it: stages share working memory, and
/// all work its threads. Const objects that compute with a backend are no exception.
class Backend {
 public:
  explicit Backend(int threads) : pool_(threads) {}
  virtual ~Backend() = default;

  virtual std::string name() const = 0;              ///< "ref", "cpu", "vulkan"
  virtual std::optional<Isa> isa() const = 0;        ///< cpu only
  virtual std::string device() const { return ""; }  ///< vulkan only: its name
  virtual std::string driver() const { return ""; }  ///< vulkan only: name and version
  /// Bytes of the device's memory that this process may use; 0: the host's is used.
  virtual std::uint64_t device_memory() const { return 0; }
  /// Whether it computes methods that march rays; all compute Gaussians.
  virtual bool marches_rays() const { return true; }
  int threads() const { return pool_.threads(); }
  /// Milliseconds that a device has spent on each of its stages since the last call; empty unless
  /// they are timed, which begins with the first call.
  virtual std::map<std::string, double> take_stage_times() { return {}; }
  /// Lends its threads, between stages.
  ThreadPool& pool() { return pool_; }

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
  /// The number of threads changes no bit.
  virtual ImageScore score(const ImagePair& images) = 0;

  // ---- stages of one method
  virtual NerfStages& nerf() = 0;
  virtual GridStages& grid() = 0;
  virtual GaussianStages& gaussians() = 0;

  /// Why it was chosen instead of a GPU, for describe(); empty where there was none to choose.
  std::string note;

 private:
  ThreadPool pool_;
};

/// --backend, --isa and --device. `name` "auto": the first GPU that passes a self-test
/// (self_test.h), unless rays are marched or --isa is given; else cpu where the processor has AVX2,
/// else ref.
struct BackendChoice {
  std::string name = "auto";  ///< one of backend_names()
  std::string isa = "auto";   ///< auto, avx2, avx512, avx512-bf16
  int threads = 0;            ///< 0: all that the process may use
  std::string device;         ///< vulkan only: its number or a part of its name; empty: first GPU
  bool marches_rays = true;   ///< whether the method does, so that auto takes no GPU
};
std::vector<std::string> backend_names();
/// UsageError: the choice is impossible, and why.
std::unique_ptr<Backend> make_backend(const BackendChoice& choice);

std::unique_ptr<Backend> make_ref_backend();
std::unique_ptr<Backend> make_cpu_backend(Isa isa, int threads);
/// UsageError: there is no such device.
std::unique_ptr<Backend> make_vulkan_backend(const std::string& device, int threads);

/// "backend=cpu isa=avx512 threads=2", and its note: printed at start-up.
std::string describe(const Backend& backend);
/// "cpu avx512", "vulkan NAME, driver NAME VERSION": what decides about the bits of results.
std::string identity(const Backend& backend);

}  // namespace redrive::kernels

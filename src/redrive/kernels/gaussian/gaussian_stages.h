// SPDX-License-Identifier: Apache-2.0
// The stages of rasterising 3D Gaussians (Backend::gaussians): projection, depth order and blending
// of an image, its backward pass, the loss of an image, and the update of the Gaussians. Formulas:
// field/gaussian.h, volume/blend_gaussians.h, optim/ssim.h, optim/adam.h. Conventions as in
// backend.h. Sums have a fixed order: the number of threads changes no bit.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <memory>
#include <span>
#include <utility>
#include <vector>

#include "redrive/base/buffer.h"
#include "redrive/field/gaussian.h"
#include "redrive/kernels/gaussian/part_extent.h"
#include "redrive/math/plain_pose.h"
#include "redrive/optim/adam.h"

namespace redrive::kernels {

/// Gaussians in blocks of 16 (field/gaussian.h): numbers [gaussian_blocks(n), kGaussianRows, 16].
/// The caller clears lanes of the last block beyond n (clear_unused): they may be drawn.
struct Gaussians {
  std::size_t n = 0;
  std::span<const float> numbers;
  /// Not 0: no other numbers have this version, so that a device may keep its copy of them until
  /// fetch(). Updates of a training keep the version.
  std::uint64_t version = 0;
};

/// Gaussians that move as one, in their own axes.
struct GaussianPart {
  std::size_t first_block = 0;  ///< its blocks end where the next part's begin
  /// part_from_camera at the times of GaussianCamera::world_from_camera, as many; empty: the part
  /// is not drawn.
  std::span<const PlainPose> part_from_camera;
  bool continues = false;  ///< it belongs to the same object as the part before
};

/// Returns the number of objects that the parts make up.
inline std::size_t objects_of(std::span<const GaussianPart> parts) {
  return static_cast<std::size_t>(std::ranges::count(parts, false, &GaussianPart::continues));
}

/// Centres of pixels that are no grid, such as the beams of a LiDAR: planes (RasterSize), finite in
/// the padding, too. Any order gives the same image; it is drawn fastest where the pixels of a tile
/// are neighbours and tiles ascend by u along their rows and by v down their columns. Empty: the
/// centre of pixel (x, y) is u = x, v = y.
struct PixelCentres {
  std::span<const float> u, v;
};

/// The camera of an image, or of a window of it: `camera` then has the window's size and principal
/// point.
struct GaussianCamera {
  PlainCamera camera;
  /// world_from_camera at even times from the upper edge of the whole image to its lower one; at
  /// least one. A Gaussian is seen from the pose of the row on which its mean falls.
  std::span<const PlainPose> world_from_camera;
  float first_row = 0;   ///< first row of the window in the whole image
  float image_rows = 1;  ///< height of the whole image
  /// Parts that move, ascending by block. The blocks before the first one are in the world.
  std::span<const GaussianPart> parts;
  PixelCentres centres;
  /// Whether the poses follow the columns of the image instead, as a LiDAR turns: from the left
  /// edge to the right one. first_row and image_rows are then a column and the width.
  bool by_column = false;
};

/// Planes of an image: pixel (x, y) of plane k is planes[(k * rows + y) * stride + x]. The padding
/// has any finite values.
struct RasterSize {
  int width = 0, height = 0;  ///< pixels
  int stride = 0, rows = 0;   ///< width and height, padded to multiples of 16

  std::size_t plane() const { return static_cast<std::size_t>(stride) * rows; }
};
constexpr int kTileSide = 16;
inline RasterSize raster_size(int width, int height) {
  const auto padded = [](int n) { return (n + kTileSide - 1) / kTileSide * kTileSide; };
  return {width, height, padded(width), padded(height)};
}

/// The rectangle that holds all of a raster's pixels.
struct RasterBounds {
  float left, right, top, bottom;
};
inline RasterBounds raster_bounds(const GaussianCamera& camera) {
  if (camera.centres.u.empty())
    return {-0.5f, static_cast<float>(camera.camera.width) - 0.5f, -0.5f,
            static_cast<float>(camera.camera.height) - 0.5f};
  const auto [left, right] = std::ranges::minmax(camera.centres.u);
  const auto [top, bottom] = std::ranges::minmax(camera.centres.v);
  return {left, right, top, bottom};
}
/// Returns the u or v of the pose from which the search for a Gaussian's own pose starts; by column
/// the middle of the whole image, so that windows agree.
inline float first_line(const GaussianCamera& camera) {
  return camera.by_column ? 0.5f * camera.image_rows - camera.first_row - 0.5f
                          : 0.5f * static_cast<float>(camera.camera.height);
}

struct RasterImage {
  RasterSize size;
  Buffer<float> rgb;            ///< 3 planes, over the background
  Buffer<float> transmittance;  ///< visible share of the background, 0..1
  Buffer<float> depth;          ///< metres along the ray, median, 0: nothing hit; where requested
  /// sum of w min(|log(t / range)|, kMaxRangeError) + transmittance * kMaxRangeError
  Buffer<float> range_error;
  /// Plane, where requested: the object whose blending weights have the largest sum in a pixel, 1 +
  /// its index among the objects that GaussianCamera::parts make up; 0: the world, with the
  /// background that shines through.
  Buffer<std::uint16_t> parts;
  std::vector<PartExtent> extents;  ///< one per object, where requested
};

struct RasterOptions {
  float background[3] = {0, 0, 0};
  bool depth = false;
  bool parts = false;  ///< RasterImage::parts and extents
  /// Tiles of 16 x 16 pixels, row by row, that are wanted; empty: all. The others have the pixels
  /// of earlier images.
  std::span<const std::uint8_t> tiles;
  /// Plane of logarithms of measured ranges (log metres); kNoRange where there is none. Empty: no
  /// ranges.
  std::span<const float> log_range;
  /// Indices of the pixels that have a range, once each; empty: any may have one.
  std::span<const std::uint32_t> ranged;
};
constexpr float kNoRange = -1e3f;

/// Derivatives of the loss with respect to the pixels, and the error that is summed over them.
struct RasterGradient {
  std::span<const float> d_rgb;            ///< 3 planes
  std::span<const float> d_transmittance;  ///< plane
  std::span<const float> error;            ///< plane: blended into GaussianDerivatives::errors
  std::span<const float> d_range;          ///< plane: by range_error; empty without log_range
};

struct RasterCounts {
  std::size_t visible = 0;  ///< Gaussians drawn
  std::size_t pairs = 0;    ///< pairs of a Gaussian and a tile
};

/// A window of a ground-truth image, from (x, y) on: rgb [height, width, 3] with 8 bits a channel;
/// alpha [height, width], empty: opaque; used [height, width], 0: masked, empty: no pixel is.
struct TargetWindow {
  int width = 0, x = 0, y = 0;  ///< width: the whole image's
  std::span<const std::uint8_t> rgb, alpha, used;
  /// Colour over which transparent pixels are rendered, minus the colour with which they have been
  /// blended.
  float background_change[3] = {0, 0, 0};
  /// Not 0: a set of images, of which this is image `index`. No other images are in it, so that a
  /// device may keep its copy of them until it meets another set (GaussianStages::keep_targets).
  std::uint64_t set = 0;
  int index = 0;
};

/// Factors of an image's colours by pixel: exposure times shading (field/shading.h).
struct PixelGains {
  float colour[3] = {1, 1, 1};
  /// Shading's parameters [3, rows, columns] in cells of the target's whole image; empty: 1.
  int columns = 0, rows = 0;
  std::span<const float> log_shading;
};

/// A rendered image and its ground truth.
struct ImageLossInput {
  RasterSize size;
  std::span<const float> rgb;  ///< 3 planes
  TargetWindow target;
  PixelGains gains;  ///< factors of rgb
  float l1_weight = 0.8f, ssim_weight = 0.2f;
};
/// Sums over a patch's pixels that are neither masked nor, in the channel, saturated in the target.
struct PatchBrightness {
  float pixels[3] = {0, 0, 0}, target[3] = {0, 0, 0};
  float rendered[3] = {0, 0, 0};  ///< with the gains
};
/// Least value of a saturated target, 0..1.
constexpr float kSaturated = 0.97f;
constexpr int kPatchSide = 8;

/// Means over the pixels that are not masked, and their channels.
struct ImageLossOutput {
  double l1 = 0;     ///< weighted
  double dssim = 0;  ///< weighted (1 - SSIM) / 2; SSIM with zeros beyond the mask
  double mse = 0;
  double pixels = 0;  ///< number of unmasked pixels
  /// variance of the target about its mean, averaged over the channels
  double colour_variance = 0;
  std::vector<PatchBrightness> patches;  ///< patches of kPatchSide squared pixels, row by row
  // Raster::backward alone:
  double transmittance = 0;  ///< mean over the unmasked pixels
  double range = 0;          ///< weighted sum of range errors
};

/// Whether an update may follow.
inline bool is_finite(const ImageLossOutput& loss) {
  return std::isfinite(loss.l1 + loss.dssim + loss.mse + loss.transmittance + loss.range);
}

/// Weights of what Raster::backward adds to the loss of the colours.
struct PixelWeights {
  float transmittance = 0;  ///< weight of the mean over the unmasked pixels
  float range = 0;          ///< weight of the range error of each pixel that has a range
};

/// A step of Adam on some of the rows. Updates each Gaussian whose opacity derivative is not 0 and
/// whose derivatives are all finite; others keep values and moments.
struct GaussianUpdate {
  AdamStep step;  ///< learning_rate is not used
  /// Learning rates by row of a Gaussian; the rate of kPositionRow is multiplied by the Gaussian's
  /// distance.
  float rates[kGaussianRows] = {};
  /// Bounds of the log scales, plus the logarithm of the distance; the lower one holds only for the
  /// two larger axes.
  float min_log_scale = -20, max_log_scale = 20;
  std::uint64_t version = 0;         ///< Gaussians::version; 0: fetch() follows the update
  std::span<float> numbers;          ///< Gaussians::numbers
  std::span<std::uint32_t> moments;  ///< as numbers (optim/packed_moments.h)
  std::span<float> errors;           ///< one per Gaussian, in whole blocks; added to
  /// Blocks from here on keep their colours in [0, 1].
  std::size_t bounded_colours = SIZE_MAX;
  /// Rows that are updated (is_seen); in a backward pass the rows that its camera sees.
  SeenBy rows = SeenBy::kCamera;
};

/// Where derivatives with respect to the Gaussians go: gradients and errors, only errors, or an
/// update.
struct GaussianDerivatives {
  std::span<float> gradients;  ///< added to; laid out as the Gaussians
  /// RasterGradient::error times the blending weight, summed over pixels: one per Gaussian, in
  /// whole blocks; added to.
  std::span<float> errors;
  const GaussianUpdate* update =
      nullptr;  ///< applied block by block, so that no gradients are kept
};

/// A rasterised image with what its backward pass reads; a backend derives its own.
class RasterPass {
 public:
  virtual ~RasterPass() = default;
  // See Raster.
  virtual const RasterImage& image() = 0;
  virtual RasterCounts counts() = 0;
  virtual ImageLossOutput backward(const ImageLossInput& target, const PixelWeights& weights,
                                   const GaussianDerivatives& to,
                                   std::span<GaussianPoseGradient<NumberMath<double>>> d_poses) = 0;
  virtual void backward(const RasterGradient& gradient, const GaussianDerivatives& to,
                        std::span<GaussianPoseGradient<NumberMath<double>>> d_poses) = 0;
};

/// Keeps the memory of passes that have ended for those to come.
class RasterArena {
 public:
  /// Returns a pass of this type, whose members have any values.
  template <class Pass, class Make>
  std::unique_ptr<Pass> take(const Make& make) {
    if (ended_.empty()) return make();
    std::unique_ptr<RasterPass> pass = std::move(ended_.back());
    ended_.pop_back();
    return std::unique_ptr<Pass>(static_cast<Pass*>(pass.release()));
  }
  void give_back(std::unique_ptr<RasterPass> pass) { ended_.push_back(std::move(pass)); }
  void release() { ended_.clear(); }

 private:
  std::vector<std::unique_ptr<RasterPass>> ended_;
};

/// A rasterised image and its backward pass. Others may be made meanwhile. The stages must outlive
/// it, and until backward() the arguments of rasterise() stay as they were.
class Raster {
 public:
  Raster(std::unique_ptr<RasterPass> pass, RasterArena* arena)
      : pass_(std::move(pass)), arena_(arena) {}
  ~Raster() {
    if (pass_) arena_->give_back(std::move(pass_));
  }
  Raster(Raster&&) noexcept = default;
  Raster& operator=(Raster&&) = delete;

  /// One thread at a time may call it: a device copies its image to the host on the first call.
  const RasterImage& image() const { return pass_->image(); }
  RasterCounts counts() const { return pass_->counts(); }
  /// Compares the image with `target`, whose size and rgb are not used, and runs the loss' backward
  /// pass. Where the loss is not finite, an update changes nothing and d_poses are 0.
  ImageLossOutput backward(const ImageLossInput& target, const PixelWeights& weights,
                           const GaussianDerivatives& to,
                           std::span<GaussianPoseGradient<NumberMath<double>>> d_poses) {
    return pass_->backward(target, weights, to, d_poses);
  }
  /// The backward pass of any other loss. d_poses [1 + parts], overwritten, per metre and rad:
  /// derivatives by the camera's pose, in the world by the Gaussians before the parts, then in each
  /// part by its own; empty: not wanted.
  void backward(const RasterGradient& gradient, const GaussianDerivatives& to,
                std::span<GaussianPoseGradient<NumberMath<double>>> d_poses) {
    pass_->backward(gradient, to, d_poses);
  }

 private:
  std::unique_ptr<RasterPass> pass_;
  RasterArena* arena_;
};

/// To use by one thread at a time, with its rasters: they share memory and threads.
class GaussianStages {
 public:
  virtual ~GaussianStages() = default;

  /// Draws the Gaussians in the order of the distance of their means.
  virtual Raster rasterise(const GaussianCamera& camera, const Gaussians& gaussians,
                           const RasterOptions& options) = 0;
  /// Writes d_rgb, 3 planes, and the mean absolute error of the channels of each pixel, 1 plane.
  /// Both are 0 in the padding of the planes.
  virtual ImageLossOutput image_loss(const ImageLossInput& input, std::span<float> d_rgb,
                                     std::span<float> error) = 0;
  /// Applies gradients that were kept, such as gradients averaged over ranks.
  virtual void update_gaussians(const GaussianUpdate& update, std::size_t n,
                                std::span<const float> gradients,
                                std::span<const float> errors) = 0;
  /// Projects points [3, n], x, y, z in the axes of GaussianCamera::world_from_camera, to pixels
  /// [2, n], u and v, as the means of Gaussians; NaN where the camera does not see a point. The
  /// camera's parts and centres are not used.
  virtual void project_points(const GaussianCamera& camera, std::span<const float> points,
                              std::span<float> pixels) = 0;
  /// Writes what updates have changed on a device to the spans of GaussianUpdate, which until then
  /// have old values: to be called before anyone else reads, writes or frees them.
  virtual void fetch() {}
  /// Returns an estimate of the bytes of a device's memory that training takes with n Gaussians
  /// and images of so many pixels; 0: the host's memory is used.
  virtual std::uint64_t training_bytes(std::size_t /*n*/, std::size_t /*pixels*/) const {
    return 0;
  }
  /// Allows so many bytes of a device's memory, 0 at first, for images of a TargetWindow::set.
  /// Those that do not fit are copied to the device whenever they are a target.
  virtual void keep_targets(std::uint64_t /*bytes*/) {}
  /// Frees the memory of rasters that have ended; the next rasterise() allocates it again.
  virtual void release() = 0;
};

}  // namespace redrive::kernels

// SPDX-License-Identifier: Apache-2.0
// The blocks of a divided run (train/files/blocks.h) as one field: an image is rendered by the
// block that holds its camera, and around a border by both, blended (Tancik et al., Block-NeRF,
// CVPR 2022).
#pragma once

#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "redrive/render/block_cache.h"
#include "redrive/render/block_way.h"
#include "redrive/train/files/seam_exposure.h"

namespace redrive {

/// The drive that a DividedField renders.
struct DividedDrive {
  std::vector<std::string> cameras;  ///< names, in the order of Scene::rig
  std::vector<std::int64_t> t_ns;    ///< times of the frames
  BlockWay way;
  SeamExposure seams;

  /// Returns the time of an exposure; near a frame the frame's time, without rounding.
  std::int64_t time_of(const Exposure& exposure) const;
  /// Returns the block whose core has the first frame from at_ns on, or the last one.
  int block_at_time(std::int64_t at_ns) const;
};

/// Blocks are loaded where they are needed, and the next one in the direction of the camera's
/// motion in the background. For one thread at a time.
class DividedField final : public Field, public FieldGaussians {
 public:
  /// `like`: a field of the blocks' method, without parameters; `load` and `bytes`: as BlockCache.
  DividedField(std::unique_ptr<const Field> like, DividedDrive drive, BlockCache::Load load,
               std::uint64_t bytes);

  const DividedDrive& drive() const { return drive_; }
  BlockCache& cache() const { return cache_; }

  const char* method() const override { return like_->method(); }
  std::string describe() const override;
  bool draws_actors() const override { return like_->draws_actors(); }

  /// Draws an object that a block did not train on, such as one that an edit moved there, by the
  /// Gaussians of the block that gave it most. Blends colours and opacity by BlockWay::weights at
  /// the camera's middle row, depth also by opacity. An exposure at a time that a block did not
  /// train on is the exposure of the block that did, at the same brightness
  /// (train/files/seam_exposure.h). Throws what loading a block throws.
  void render_to(kernels::Backend& backend, const RayTable& rays,
                 const ShutterPoses& world_from_camera, const Exposure& exposure,
                 RenderedImage* image) const override;
  /// Renders each ray by the block that holds its origin.
  RenderedRays trace(kernels::Backend& backend, const kernels::Rays& rays,
                     const std::vector<MovingObject>& actors = {}) const override;

  const FieldGaussians* as_gaussians() const override {
    return like_->as_gaussians() ? this : nullptr;
  }
  /// Returns the Gaussians of all blocks: from each block those whose nearest place on the way is
  /// in the block's core, so that what several blocks hold comes once. Colours have the same
  /// brightness in all blocks. Loads one block after the other.
  WorldGaussians world() const override;
  bool has_body(std::int64_t id) const override { return body_of(id).gaussians != nullptr; }
  /// Returns the Gaussians of the block that has most of them, as bright as the world's.
  ActorBody body(const MovingObject& actor) const override;

 private:
  /// An exposure of the drive in a block, and the gains that its image is multiplied by.
  struct BlockExposure {
    Exposure exposure;
    LogGains log_factors{};
  };
  /// The rays that begin in a block.
  struct BlockRays {
    std::vector<std::size_t> chosen;  ///< indices
    std::vector<float> origin, direction;
    std::vector<std::int64_t> t_ns;  ///< empty: none are given

    kernels::Rays rays() const {
      return {static_cast<int>(chosen.size()), origin, direction, t_ns};
    }
    void put(const RenderedRays& some, RenderedRays* all) const {
      for (std::size_t i = 0; i < chosen.size(); ++i) all->put(chosen[i], some, i);
    }
  };
  /// The Gaussians of an object, from the block that has most of them.
  struct Body {
    std::shared_ptr<const ActorBody> gaussians;  ///< null: no block has any
    LogGains log_gains{};                        ///< log gains of that block
  };
  const Body& body_of(std::int64_t id) const;
  /// Returns the body to draw in a block, and multiplies `gain` by the factor that makes it equally
  /// bright; null if the block has its own, or no block has one.
  std::shared_ptr<const ActorBody> borrowed(int block, const Field& field, std::int64_t id,
                                            std::array<float, 3>* gain) const;
  std::vector<BlockRays> divided(const kernels::Rays& rays) const;
  BlockExposure exposure_in(int block, const LoadedBlock& loaded, const Exposure& exposure) const;
  void render_block(kernels::Backend& backend, int block, const RayTable& rays,
                    const ShutterPoses& world_from_camera, const Exposure& exposure,
                    RenderedImage* image) const;
  LogGains drive_log_gains(const Exposure& exposure) const;
  void load_ahead(const BlockWay::Place& place) const;
  /// Returns the mean over cameras of the block's log gains, which make the blocks' own colours
  /// equally bright.
  LogGains mean_log_gains(int block) const;

  const std::unique_ptr<const Field> like_;
  DividedDrive drive_;
  mutable BlockCache cache_;
  mutable std::map<std::int64_t, Body> bodies_;  ///< key: id of each one that a block borrowed
  mutable std::optional<double> last_along_m_;   ///< place of the camera rendered last
  /// the last exposure and its gains
  mutable std::optional<std::pair<Exposure, LogGains>> drive_gains_;
  mutable RenderedImage neighbour_;  ///< memory of a neighbouring block's image
};

}  // namespace redrive

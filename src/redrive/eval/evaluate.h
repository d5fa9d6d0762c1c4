// SPDX-License-Identifier: Apache-2.0
// Scores a run: compares renderings with held-out images (training images if none is held out) and
// with the ground truth of novel views where the recording has it.
#pragma once

#include <array>
#include <functional>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include "redrive/eval/lidar_score.h"
#include "redrive/eval/novel_ground_truth.h"
#include "redrive/eval/view_alignment.h"
#include "redrive/render/renderer.h"
#include "redrive/train/poses/pose_changes.h"
#include "redrive/train/run.h"

namespace redrive {

/// PSNR is clamped to this: equal images have an infinite one, which neither a mean nor JSON can
/// hold.
constexpr double kPsnrCapDb = 100;

/// Default number of training images to score per camera where no frame is held out.
constexpr int kTrainingImagesPerCamera = 8;

struct Score;

struct EvalOptions {
  int max_images = 0;  ///< per camera and per novel set, evenly spaced, and of LiDAR revolutions;
                       ///< 0: all held-out ones, or kTrainingImagesPerCamera
  bool all = false;    ///< scores every image, including training frames
  /// Called with each scored image of a camera, the view at the pose that it was rendered from; may
  /// be empty.
  std::function<void(const View& view, const Score& score)> scored;
};

/// Means over images. NaN where undefined: ssim of images smaller than its 11 x 11 window,
/// depth_error without ground-truth depth.
struct Score {
  double psnr_db = 0;
  double luma_psnr_db = 0;                  ///< PSNR of the mean of the channels
  std::array<double, 3> channel_psnr_db{};  ///< red, green, blue
  double ssim = 0;
  double flip = 0;  ///< optim/flip.h, 0..1, less is better
  double depth_error =
      0;  ///< median over an image's pixels of |depth - ground truth| / ground truth, along the ray
  int images = 0;
  /// masked pixels of these images within the camera model's valid region
  std::int64_t left_out = 0;
  std::int64_t pixels = 0, scored = 0;  ///< pixels of these images: all, and the compared ones

  /// Share of the pixels that were compared; 1 without pixels.
  double scored_share() const {
    return pixels > 0 ? static_cast<double>(scored) / static_cast<double>(pixels) : 1;
  }
};

/// Scores of moving objects (eval/moving_scores.h).
struct MovingEvaluation {
  struct Object {
    std::string type;  ///< MovingObject::type
    Score score;       ///< score of its pixels; without flip and depth_error
  };
  Score inside;                            ///< score of their pixels, in the images that show any
  Score outside;                           ///< score of all other pixels, in all images
  std::map<std::int64_t, Object> objects;  ///< key: MovingObject::id
};

/// Scores of a block of the drive (Run::blocks).
struct PartEvaluation {
  Score overall;
  std::map<std::string, Score> novel;  ///< as in Evaluation
};

struct Evaluation {
  bool held_out = true;  ///< false: no frame was held out, training frames were scored
  std::vector<Finding>
      damaged;  ///< about files that are not scored: images that cannot be decoded, ..
  Score overall;
  std::map<std::string, Score> cameras;
  std::optional<MovingEvaluation> moving;  ///< empty where no image shows a moving object
  std::map<std::string, Score> novel;      ///< key: novel/<name>; empty without ground truth
  std::map<std::string, PartEvaluation> parts;
  std::optional<LidarScore> lidar;                ///< score of held-out scans that did not train
  std::map<std::string, LidarScore> lidars;       ///< key: name; of each, where there are several
  std::map<std::string, LidarScore> novel_lidar;  ///< key: novel/<name>, of sets with scans
  std::optional<ViewAlignment>
      view_alignment;  ///< alignment of the held-out images, where training refined poses
  /// alignment of the run's trajectory with the ground truth, where the recording has it
  std::optional<TrajectoryRegistration> alignment;
  std::optional<PoseChanges>
      pose_changes;  ///< pose corrections by training, where it refined poses
};

/// Scores one image over the pixels in the camera model's valid region that the ground truth's mask
/// uses. `depth_m`: as in GroundTruthView.
Score score_image(kernels::Backend& backend, const RenderedImage& rendered,
                  const Image8& ground_truth, std::span<const float> depth_m = {});

/// Renders and scores the run. Throws InputError as load_view and load_lidar_returns.
Evaluation evaluate(const Run& run, kernels::Backend& backend, const EvalOptions& options = {});

/// Returns {"inside": SCORE, "outside": SCORE, "objects": {ID: {"type", "psnr_db", "luma_psnr_db",
/// "ssim", "images"}}}; SCORE as in evaluation_to_json.
nlohmann::json moving_to_json(const MovingEvaluation& moving);

/// Returns {"overall": SCORE, "cameras": {CAM: SCORE}, "novel": {NAME: SCORE}, "held_out": bool,
/// "moving": moving_to_json or null,
/// "lidar": LIDAR or null, "novel_lidar": {NAME: LIDAR},
/// "alignment": {"translation_m", "rotation_deg", "residual_m", "residual_deg", "frames"} or null,
/// "view_alignment": {"translation_m", "rotation_deg", "views"} or null, "pose_changes": {"frames":
/// {"translation_m", "rotation_deg", "at_bound"}, "cameras": {CAM: {"translation_m": [3],
/// "rotation_deg": [3], "time_offset_s", "at_bound"}}} or null}, with parts also "blocks": {NAME:
/// {"overall": SCORE, "novel": {NAME: SCORE}}}, SCORE =
/// {"psnr_db", "luma_psnr_db", "channel_psnr_db": [3], "ssim", "flip", "depth_error", "images",
/// "masked_pixels", "scored_share"}, LIDAR = {RANGES, "chamfer_m", "revolutions", "intensity_rmse"
/// or null, "lost": {"rays", "accuracy", "f1"} or null, "moving": {RANGES} or null}, RANGES =
/// "range_error_m", "mean_range_error_m", "hit_rate", "near_hit_rate", "returns"; null for NaN.
nlohmann::json evaluation_to_json(const Evaluation& evaluation);

}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
// What a run is worth: renders against images that were not trained on (held-out frames, else the training frames) and
// against the truth of novel views where the recording ships it.
#pragma once

#include <functional>
#include <map>
#include <string>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include "redrive/render/renderer.h"
#include "redrive/train/run.h"

namespace redrive {

/// A PSNR above this counts as this: equal images have an infinite one, which neither a mean nor JSON can hold.
constexpr double kPsnrCapDb = 100;

/// Training frames that are scored per camera where no frame was held out, unless the options say otherwise.
constexpr int kTrainingImagesPerCamera = 8;

struct EvalOptions {
  int max_images =
      0;             ///< per camera and per novel set, evenly spaced; 0: all held-out ones, or kTrainingImagesPerCamera
  bool all = false;  ///< every one, also of the training frames
  std::function<void(int done, int total)> progress;  ///< after each image; may be empty
};

struct Score {
  double psnr_db = 0, ssim = 0;  ///< means over images; ssim is NaN if the images are smaller than its 11 x 11 window
  int images = 0;
};

struct Evaluation {
  bool held_out = true;  ///< false: no frame was held out, training frames were scored
  Score overall;
  std::map<std::string, Score> cameras;
  std::map<std::string, Score> novel;  ///< by novel/<name>; empty where there is no truth
};

/// A picture to score: truth as a run trains on it (undistorted, downscaled) and where it was taken from.
struct TruthView {
  std::string name;  ///< camera, or file of a novel set
  Camera camera;
  Rigid3d world_from_camera;
  Image8 truth;
};

/// The views of a novel set (indices into its poses.json) whose truth stands beside that file, of cameras that
/// the run trained; and one of them, loaded. InputError: the truth has not the size that its calibration says.
std::vector<std::size_t> novel_views_with_truth(const Run& run, const NovelSet& set);
TruthView load_novel_view(const Run& run, const NovelSet& set, std::size_t view);

/// Score of one picture over the pixels that the camera model reaches.
Score score_image(const RenderedImage& rendered, const Image8& truth);

/// `limit` of `size` indices, evenly spaced over all of them; all where limit is 0 or at least size.
std::vector<std::size_t> evenly_spaced(std::size_t size, std::size_t limit);

Evaluation evaluate(const Run& run, kernels::Backend& backend, const EvalOptions& options = {});

/// {"overall": {"psnr_db", "ssim", "images"}, "cameras": {CAM: ...}, "novel": {NAME: ...}, "held_out": bool}.
nlohmann::json evaluation_to_json(const Evaluation& evaluation);

}  // namespace redrive

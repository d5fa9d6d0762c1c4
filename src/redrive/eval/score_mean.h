// SPDX-License-Identifier: Apache-2.0
// Means of scores, and scores as JSON.
#pragma once

#include <cmath>
#include <limits>

#include <nlohmann/json_fwd.hpp>

#include "redrive/eval/evaluate.h"

namespace redrive {

/// Means over images of each metric, without the images where it is undefined.
class ScoreMean {
 public:
  void add(const Score& score) {
    psnr_db_.add(score.psnr_db);
    luma_psnr_db_.add(score.luma_psnr_db);
    for (std::size_t c = 0; c < 3; ++c) channel_psnr_db_[c].add(score.channel_psnr_db[c]);
    ssim_.add(score.ssim);
    flip_.add(score.flip);
    depth_error_.add(score.depth_error);
    ++images_;
    left_out_ += score.left_out;
    pixels_ += score.pixels;
    scored_ += score.scored;
  }
  Score mean() const {
    if (images_ == 0) return {};
    const auto& [red, green, blue] = channel_psnr_db_;
    return {.psnr_db = psnr_db_.mean(),
            .luma_psnr_db = luma_psnr_db_.mean(),
            .channel_psnr_db = {red.mean(), green.mean(), blue.mean()},
            .ssim = ssim_.mean(),
            .flip = flip_.mean(),
            .depth_error = depth_error_.mean(),
            .images = images_,
            .left_out = left_out_,
            .pixels = pixels_,
            .scored = scored_};
  }

 private:
  struct Mean {
    double sum = 0;
    int count = 0;
    void add(double value) {
      if (!std::isnan(value)) sum += value, ++count;
    }
    double mean() const {
      return count > 0 ? sum / count : std::numeric_limits<double>::quiet_NaN();
    }
  };
  Mean psnr_db_, luma_psnr_db_, channel_psnr_db_[3], ssim_, flip_, depth_error_;
  int images_ = 0;
  std::int64_t left_out_ = 0, pixels_ = 0, scored_ = 0;
};

/// Returns SCORE of evaluation_to_json.
nlohmann::json score_to_json(const Score& score);
nlohmann::json view_alignment_to_json(const ViewAlignment& alignment);

}  // namespace redrive

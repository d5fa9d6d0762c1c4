// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/self_test.h"

#include <limits>
#include <memory>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/kernels/backend.h"

namespace redrive::kernels {
namespace {

using testing::MatchesRegex;
using PoseGradients = std::span<GaussianPoseGradient<NumberMath<double>>>;

enum class Wrong { kNothing, kCounts, kImage, kNan, kLoss, kGradient, kUpdate, kLost };

/// Stages of the reference with one of them made wrong.
class WrongPass final : public RasterPass {
 public:
  WrongPass(Raster raster, Wrong wrong) : raster_(std::move(raster)), wrong_(wrong) {}

  const RasterImage& image() override {
    const RasterImage& right = raster_.image();
    image_.size = right.size;
    for (const auto& [from, to] :
         {std::pair{&right.rgb, &image_.rgb}, {&right.transmittance, &image_.transmittance}}) {
      *to = Buffer<float>(from->size());
      std::ranges::copy(from->span(), to->data());
    }
    if (wrong_ == Wrong::kImage) image_.rgb.data()[7] += 0.01f;
    if (wrong_ == Wrong::kNan)
      image_.transmittance.data()[7] = std::numeric_limits<float>::quiet_NaN();
    return image_;
  }
  RasterCounts counts() override {
    RasterCounts counts = raster_.counts();
    counts.visible += wrong_ == Wrong::kCounts;
    return counts;
  }
  ImageLossOutput backward(const ImageLossInput& target, const PixelWeights& weights,
                           const GaussianDerivatives& to, PoseGradients d_poses) override {
    if (wrong_ == Wrong::kLost) throw DeviceError("GPU", "device lost");
    ImageLossOutput out = raster_.backward(target, weights, to, d_poses);
    if (wrong_ == Wrong::kLoss) out.dssim *= 2;
    if (wrong_ == Wrong::kGradient && !to.update) to.gradients[gaussian_slot(3, kColourRow)] += 1;
    if (wrong_ == Wrong::kUpdate && to.update) to.update->numbers[5] += 0.001f;
    return out;
  }
  void backward(const RasterGradient&, const GaussianDerivatives&, PoseGradients) override {}

 private:
  Raster raster_;
  RasterImage image_;
  Wrong wrong_;
};

class WrongStages final : public GaussianStages {
 public:
  explicit WrongStages(Wrong wrong) : wrong_(wrong) {}
  Raster rasterise(const GaussianCamera& camera, const Gaussians& gaussians,
                   const RasterOptions& options) override {
    return {std::make_unique<WrongPass>(right_->gaussians().rasterise(camera, gaussians, options),
                                        wrong_),
            &arena_};
  }
  ImageLossOutput image_loss(const ImageLossInput&, std::span<float>, std::span<float>) override {
    return {};
  }
  void update_gaussians(const GaussianUpdate&, std::size_t, std::span<const float>,
                        std::span<const float>) override {}
  void project_points(const GaussianCamera&, std::span<const float>, std::span<float>) override {}
  void release() override {}

 private:
  std::unique_ptr<Backend> right_ = make_ref_backend();
  RasterArena arena_;
  Wrong wrong_;
};

std::string tested(Wrong wrong) {
  WrongStages stages(wrong);
  return self_test(stages);
}

TEST(SelfTest, NamesTheStageThatIsWrong) {
  EXPECT_EQ(tested(Wrong::kNothing), "");
  EXPECT_EQ(tested(Wrong::kCounts), "projection: off by 1, 0 allowed");
  EXPECT_THAT(tested(Wrong::kImage), MatchesRegex("image: off by 0.01, 0.002 allowed"));
  EXPECT_THAT(tested(Wrong::kNan), MatchesRegex("image: off by -?nan, 0.0011 allowed"));
  EXPECT_THAT(tested(Wrong::kLoss), MatchesRegex("loss: off by .*, 0.001 allowed"));
  EXPECT_THAT(tested(Wrong::kGradient), MatchesRegex("backward: off by .*, 0.006 allowed"));
  EXPECT_EQ(tested(Wrong::kUpdate), "update: off by 0.001, 0.0002 allowed");
  EXPECT_EQ(tested(Wrong::kLost), "loss: GPU: device lost");
}

TEST(SelfTest, ProcessorsPass) {
  for (const Isa isa : all_isas()) {
    if (isa_obstacle(isa)) continue;
    EXPECT_EQ(self_test(make_cpu_backend(isa, 1)->gaussians()), "") << isa_name(isa);
  }
}

}  // namespace
}  // namespace redrive::kernels

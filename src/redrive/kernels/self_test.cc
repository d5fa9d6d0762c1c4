// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/self_test.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>
#include <random>
#include <span>
#include <vector>

#include "redrive/base/error.h"
#include "redrive/kernels/backend.h"
#include "redrive/kernels/self_test_scene.h"
#include "redrive/optim/packed_moments.h"

namespace redrive::kernels {
namespace {

using Check = std::string;  // empty: right

constexpr float kGain = 0.9f;

/// The state of a step.
struct Step : SelfTestScene {
  std::vector<float> errors = std::vector<float>(numbers.size() / kGaussianRows);
  std::vector<std::uint32_t> moments;
  std::vector<std::uint8_t> target;
  // Results:
  RasterCounts counts;
  std::vector<float> rgb, transmittance, gradients;
  double loss = 0;

  Step() {
    std::mt19937 random(6);
    for (std::size_t i = 0; i < numbers.size(); ++i)
      moments.push_back(pack_moments(next(&random), 0.75f + 0.25f * next(&random)));
  }

  Raster rasterise(GaussianStages& stages) {
    return stages.rasterise(view(), {kCount, numbers}, {});
  }
  /// Returns the planes without their padding.
  std::vector<float> pixels_of(const Buffer<float>& planes, std::size_t n) const {
    std::vector<float> out;
    for (std::size_t k = 0; k < n; ++k)
      for (int y = 0; y < camera.height; ++y) {
        const float* const row =
            planes.data() + k * size().plane() + static_cast<std::size_t>(y) * size().stride;
        out.insert(out.end(), row, row + camera.width);
      }
    return out;
  }
  /// Makes a target that is nowhere near the image, where the derivative of the error jumps.
  void make_target(const RasterImage& image) {
    for (int y = 0; y < camera.height; ++y)
      for (int x = 0; x < camera.width; ++x)
        for (std::size_t c = 0; c < 3; ++c) {
          const std::size_t i =
              c * size().plane() + static_cast<std::size_t>(y * size().stride + x);
          const float value = kGain * image.rgb[i];
          target.push_back(static_cast<std::uint8_t>(value > 0.5f ? std::min(70 * value, 99.0f)
                                                                  : 190 + 60 * value));
        }
  }
};

Check within(double off, double allowed) {
  if (off <= allowed) return "";
  char text[80];
  std::snprintf(text, sizeof text, "off by %.2g, %.2g allowed", off, allowed);
  return text;
}

/// Returns the larger one, or the one that is not a number.
double larger(double a, double b) { return b > a || std::isnan(b) ? b : a; }

/// Largest difference.
double difference(std::span<const float> a, std::span<const float> b) {
  double most = 0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    most = larger(most, std::fabs(static_cast<double>(a[i]) - static_cast<double>(b[i])));
  }
  return most;
}

Check check_gradients(const Step& found, const Step& expected) {
  constexpr double kAllowed = 6e-3;  // share of the largest in the row
  double worst = 0;
  for (int row = 0; row < kDistanceRow; ++row) {
    double most = 0, off = 0;
    for (std::size_t i = 0; i < Step::kCount; ++i) {
      const auto a = static_cast<double>(found.gradients[gaussian_slot(i, row)]),
                 b = static_cast<double>(expected.gradients[gaussian_slot(i, row)]);
      most = std::max(most, std::fabs(b));
      off = larger(off, std::fabs(a - b));
    }
    if (off != 0) worst = larger(worst, off / most);  // rows that cameras do not see have none
  }
  return within(worst, kAllowed);
}

constexpr const char* kStages[] = {"projection", "image", "loss", "backward", "update"};

/// Runs the step. Calls done() after each of kStages, until it returns false.
template <class Done>
void run(GaussianStages& stages, Step* step, const Done& done) {
  Raster raster = step->rasterise(stages);
  step->counts = raster.counts();
  if (!done()) return;
  const RasterImage& image = raster.image();
  step->rgb = step->pixels_of(image.rgb, 3);
  step->transmittance = step->pixels_of(image.transmittance, 1);
  if (!done()) return;
  if (step->target.empty()) step->make_target(image);
  ImageLossInput input;
  input.target = {.width = step->camera.width, .rgb = step->target};
  input.gains = {.colour = {kGain, kGain, kGain}};
  const PixelWeights weights{.transmittance = 0.02f};
  step->gradients.assign(step->numbers.size(), 0);
  std::vector<float> errors(step->errors.size());
  const ImageLossOutput loss =
      raster.backward(input, weights, {.gradients = step->gradients, .errors = errors}, {});
  step->loss = loss.l1 + loss.dssim + loss.transmittance;
  if (!done() || !done()) return;  // the loss, its backward pass
  GaussianUpdate update;
  update.step = adam_step(0, 3);
  update.step.epsilon = 1e-15f;
  for (float& rate : update.rates) rate = 0.01f;
  update.numbers = step->numbers;
  update.moments = step->moments;
  update.errors = step->errors;
  raster.backward(input, weights, {.update = &update}, {});
  stages.fetch();
  done();
}

Check check(int stage, const Step& found, const Step& expected) {
  switch (stage) {
    case 0:
      return within(std::fabs(static_cast<double>(found.counts.visible) -
                              static_cast<double>(expected.counts.visible)),
                    0);
    case 1: {
      const Check rgb = within(difference(found.rgb, expected.rgb), 2e-3);
      return rgb.empty() ? within(difference(found.transmittance, expected.transmittance), 1.1e-3)
                         : rgb;
    }
    case 2: return within(std::fabs(found.loss - expected.loss), 1e-3);
    case 3: return check_gradients(found, expected);
    default: return within(difference(found.numbers, expected.numbers), 2e-4);
  }
}

}  // namespace

std::string self_test(GaussianStages& stages) {
  Step expected, found;
  run(make_ref_backend()->gaussians(), &expected, [] { return true; });
  found.target = expected.target;
  int stage = 0;
  Check fault;
  try {
    run(stages, &found, [&] {
      fault = check(stage, found, expected);
      if (fault.empty()) ++stage;
      return fault.empty();
    });
  } catch (const DeviceError& error) {
    fault = error.what();
  }
  return fault.empty() ? "" : kStages[stage] + (": " + fault);
}

}  // namespace redrive::kernels

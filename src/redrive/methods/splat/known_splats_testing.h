// SPDX-License-Identifier: Apache-2.0
// For tests of method splat: a scene of known Gaussians and a training without a trainer.
#pragma once

#include <algorithm>
#include <cmath>
#include <memory>
#include <vector>

#include "redrive/base/rng.h"
#include "redrive/math/so3.h"
#include "redrive/methods/splat/densify_gaussians.h"
#include "redrive/methods/splat/splat_model.h"
#include "redrive/methods/splat/splat_scene_testing.h"

namespace redrive::known_splats {

inline float signed_random(std::uint64_t key, std::uint64_t i) {
  return 2 * random_unit(key, i) - 1;
}

inline std::unique_ptr<kernels::Backend> fast_backend(int threads = 2) {
  return best_isa() ? kernels::make_cpu_backend(*best_isa(), threads) : kernels::make_ref_backend();
}

/// Gaussians of 0.1 to 0.25 m within (+-2, +-1.3, 3..6) m.
inline GaussianList known_gaussians(int n) {
  GaussianList list;
  list.rows.resize(static_cast<std::size_t>(n) * kGaussianRows);
  for (int i = 0; i < n; ++i) {
    float* const rows = &list.rows[static_cast<std::size_t>(i) * kGaussianRows];
    const auto random = [&](int row) { return signed_random(11, 100 * i + row); };
    rows[kPositionRow] = 2 * random(0);
    rows[kPositionRow + 1] = 1.3f * random(1);
    rows[kPositionRow + 2] = 4.5f + 1.5f * random(2);
    for (int k = 0; k < 3; ++k) {
      rows[kLogScaleRow + k] = std::log(0.16f) + 0.45f * random(3 + k);
      rows[kColourRow + k] = 0.35f + 0.25f * random(6 + k);
    }
    for (int k = 0; k < 4; ++k) rows[kQuaternionRow + k] = random(9 + k);
    rows[kOpacityRow] = 1.5f + random(13);
    rows[kDistanceRow] = 4.5f;
  }
  return list;
}

/// The same less well known: moved by up to `off` metres, grey, half transparent.
inline GaussianList disturbed(GaussianList list, float off) {
  for (std::size_t i = 0; i < list.size(); ++i) {
    float* const rows = &list.rows[i * kGaussianRows];
    for (int k = 0; k < 3; ++k) {
      rows[kPositionRow + k] += off * signed_random(12, 3 * i + k);
      rows[kColourRow + k] = 0.4f;
      rows[kLogScaleRow + k] += 0.3f * signed_random(13, 3 * i + k);
    }
    rows[kOpacityRow] = 0;
  }
  return list;
}

inline void set_gaussians(const GaussianList& list, SplatModel* model) {
  model->gaussians = model->first_gaussians = static_cast<int>(list.size());
  model->parameters = Buffer<float>(model->size());
  write_blocks({&list, 1}, model->layout(), &model->parameters);
}

/// A model, its moments and what a trainer keeps.
struct Training {
  SplatModel model;
  AdamState adam;
  StepBuffers buffers;
  std::int64_t step = 0, steps = 100;

  void begin(const GaussianList& list) {
    set_gaussians(list, &model);
    model.max_gaussians = model.gaussians;
    adam = model.zero_moments();
  }
  StepRequest request() const {
    StepRequest request;
    request.seed = 5;
    request.step = step;
    request.progress = static_cast<double>(step) / static_cast<double>(steps);
    return request;
  }
  /// Computes a step's gradients; unless the request has an update, without applying them.
  StepOutput gradients(kernels::Backend& backend, const TrainingSet& data,
                       const StepRequest& request) {
    const std::size_t size = model.gradients_size(request.update != nullptr);
    if (buffers.gradients.size() != size) buffers.gradients = Buffer<float>(size);
    std::ranges::fill(buffers.gradients.span(), 0.0f);
    return model.step(backend, data, request, buffers.gradients, &buffers);
  }
  double loss() {
    double sum = 0;
    for (const LossTerm& term : model.loss_terms(buffers.workspace.sums())) sum += term.value;
    return sum;
  }
  void run(kernels::Backend& backend, const TrainingSet& data) {
    for (; step < steps; ++step) {
      StepRequest request = this->request();
      const double rate = model.learning_rate({step, steps, request.progress});
      const StepUpdate update{rate, step + 1, model.parameters, &adam};
      request.update = &update;
      const StepOutput out = gradients(backend, data, request);
      model.update(backend, rate, step + 1, buffers.gradients, &adam);
      model.finish_step(backend, request, out, step + 1, buffers, &adam);
    }
  }
};

inline Rigid3d pose(const Eigen::Vector3d& centre, const Eigen::Vector3d& turn) {
  Rigid3d pose = Rigid3d::Identity();
  pose.linear() = so3_exp(turn);
  pose.translation() = centre;
  return pose;
}

/// Images of known Gaussians by a pinhole, two fisheyes and a rolling shutter.
struct KnownScene : SplatScene {
  SplatModel truth;
  std::vector<Image8> held_out;  ///< one per view

  explicit KnownScene(int n = 120, double size = 1) {
    const int w = static_cast<int>(64 * size), h = static_cast<int>(48 * size);
    const double f = size;
    add_camera("PINHOLE", "opencv_pinhole",
               {50 * f, 50 * f, w / 2 - 0.5, h / 2 - 0.5, -0.1, 0.02, 0.001, 0, 0}, w, h);
    add_camera("MEI", "mei", {80 * f, 80 * f, w / 2 - 0.5, h / 2 - 0.5, 0.02, -0.03, 0, 0, 0, 1.02},
               w, h);
    add_camera("FISHEYE", "opencv_fisheye",
               {45 * f, 45 * f, w / 2 - 0.5, h / 2 - 0.5, 0.03, 0.005, 0, 0}, w, h);
    add_camera("ROLLING", "opencv_pinhole",
               {50 * f, 50 * f, w / 2 - 0.5, h / 2 - 0.5, 0, 0, 0, 0, 0}, w, h);
    constexpr std::int64_t kReadout_ns = 30'000'000;
    scene.rig.back().readout_ns = kReadout_ns;
    for (int i = 0; i < 12; ++i) {
      const double at = i / 11.0 - 0.5;
      const Rigid3d here =
          pose({1.6 * at, i % 3 * 0.3 - 0.3, 0.2 * (i % 2)}, {0, -0.3 * at, 0.05 * at});
      add_view(i % 4, here, i == 4 || i == 7);
      if (i % 4 == 3)
        for (const int side : {-1, 1})
          scene.trajectory.insert(scene.trajectory.end() - (side < 0 ? 1 : 0),
                                  {i, 100'000'000ll * i + side * kReadout_ns / 2,
                                   here * pose({0.03 * side, 0, 0}, {0, 0.02 * side, 0})});
    }
    scene.metric = false;  // no exposures
    finish();
    set_gaussians(known_gaussians(n), &truth);
    const auto backend = fast_backend();
    for (std::size_t v = 0; v < scene.views.size(); ++v) {
      const Image8 image = drawn(*backend, truth, v);
      if (scene.views[v].held_out)
        held_out.push_back(image);
      else
        images[v].rgb = image.rgb;
    }
  }
  RenderedImage render(kernels::Backend& backend, const SplatModel& model, std::size_t view) const {
    const View& of = scene.views[view];
    return model.render(backend, make_ray_table(scene.rig[of.camera].camera),
                        scene.shutter_poses(of), {});
  }
  Image8 drawn(kernels::Backend& backend, const SplatModel& model, std::size_t view) const {
    const RenderedImage rendered = render(backend, model, view);
    Image8 image;
    image.width = rendered.width;
    image.height = rendered.height;
    for (const float x : rendered.rgb)
      image.rgb.push_back(static_cast<std::uint8_t>(std::lround(255 * x)));
    return image;
  }
  /// PSNR of the held-out images.
  double psnr_db(kernels::Backend& backend, const SplatModel& model) const {
    double squares = 0, n = 0;
    std::size_t next = 0;
    for (std::size_t v = 0; v < scene.views.size(); ++v) {
      if (!scene.views[v].held_out) continue;
      const RenderedImage rendered = render(backend, model, v);
      const Image8& image = held_out[next++];
      for (std::size_t i = 0; i < image.rgb.size(); ++i) {
        const double off = static_cast<double>(rendered.rgb[i]) - image.rgb[i] / 255.0;
        squares += off * off;
        ++n;
      }
    }
    return -10 * std::log10(squares / n);
  }
};

}  // namespace redrive::known_splats

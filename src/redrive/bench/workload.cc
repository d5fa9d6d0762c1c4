// SPDX-License-Identifier: Apache-2.0
#include "redrive/bench/workload.h"

#include <algorithm>
#include <cmath>

#include "redrive/base/rng.h"
#include "redrive/methods/splat/initial_gaussians.h"
#include "redrive/train/run.h"
#include "redrive/volume/hierarchical_sampling.h"

namespace redrive::bench {

SyntheticDrive make_synthetic_drive() {
  constexpr int kWidth = 1280, kHeight = 704, kViews = 4;
  SyntheticDrive drive;
  Camera camera;
  camera.model = OpenCvPinhole{};
  camera.fx = camera.fy = 1000;
  camera.cx = (kWidth - 1) / 2.0;
  camera.cy = (kHeight - 1) / 2.0;
  camera.width = kWidth;
  camera.height = kHeight;
  // Body axes x forward, y left, z up; camera axes x right, y down, z forward.
  Rigid3d body_from_sensor = Rigid3d::Identity();
  body_from_sensor.linear() << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  drive.scene.rig.push_back({"SYNTHETIC", camera, camera, body_from_sensor});
  drive.scene.global_from_world = Rigid3d::Identity();
  drive.scene.unit_from_world = {{1, 0, 0}, 1.0f / 12};
  for (int i = 0; i < kViews; ++i) {
    drive.scene.add_frame({i, i * 100'000'000, Rigid3d(Eigen::Translation3d(0.5 * i, 0, 0))});
    drive.scene.views.push_back({0, i, "", false, {}});
    Image8 image{kWidth, kHeight, {}};
    image.rgb.reserve(3 * kWidth * kHeight);
    for (int y = 0; y < kHeight; ++y)
      for (int x = 0; x < kWidth; ++x)
        for (int k = 0; k < 3; ++k)
          image.rgb.push_back(
              static_cast<std::uint8_t>(127.5 + 127 * std::sin(0.02 * x + 0.03 * y * k + i)));
    drive.images.push_back(std::move(image));
  }
  return drive;
}

void add_actors(int n, SyntheticDrive* drive) {
  constexpr int kLanes = 4;
  constexpr double kSpeed_m_per_s = 5;
  for (int i = 0; i < n; ++i) {
    MovingObject car{
        .id = i + 1, .type = "CAR", .deforms = false, .size_m = {4, 2, 1.5}, .keys = {}};
    const double ahead_m = 3 * std::pow(100.0 / 3, (i / kLanes + 0.5) * kLanes / n);
    for (const Frame& frame : drive->scene.frames) {
      Rigid3d pose = Rigid3d::Identity();
      pose.translation() =
          Eigen::Vector3d(ahead_m + kSpeed_m_per_s * 1e-9 * static_cast<double>(frame.t_ns),
                          4 * (i % kLanes) - 6, -0.75);
      car.keys.push_back({frame.t_ns, pose, {kSpeed_m_per_s, 0, 0}});
    }
    drive->scene.actors.push_back(car);
  }
}

TrainOptions options_of(const std::string& method, int width, int samples) {
  TrainOptions options;
  options.method = method;
  options.set("width", width);
  options.set("samples", samples);
  apply_preset(&options, {});
  return options;
}

KernelBatch::KernelBatch(const SyntheticDrive& drive, const NerfConfig& config, int samples)
    : state(make_initial_state(options_of("nerf", config.width, samples), drive.scene)) {
  PixelSampler(drive.scene, drive.images, 1).gather(0, kBatchRays, &rays);
  const std::size_t n = static_cast<std::size_t>(rays.n) * samples;
  t = Buffer<float>(n);
  dt = Buffer<float>(n);
  for (int ray = 0; ray < rays.n; ++ray) {
    const auto how = sampling();
    const std::size_t first = static_cast<std::size_t>(ray) * samples;
    stratified_ray(samples, how.near_m, how.far_m, how.jitter, how.key, first, &t[first],
                   &dt[first]);
  }
  // Linear outputs of order 1, half of the densities active; gradients of a mean over the batch.
  const auto fill = [](Buffer<float>* values, std::size_t size, float scale) {
    *values = Buffer<float>(size);
    for (std::size_t i = 0; i < size; ++i)
      (*values)[i] = scale * (random_unit(random_key(1, kStreamTest), i) - 0.5f);
  };
  fill(&raw, 4 * n, 4);
  fill(&d_rgb, 3 * rays.n, 1.0f / rays.n);
  fill(&d_raw, 4 * n, 1.0f / n);
  fill(&gradients, state.model->parameters.size(), 1e-3f);
  rgb = Buffer<float>(3 * rays.n);
  depth = Buffer<float>(rays.n);
  opacity = Buffer<float>(rays.n);
}

kernels::StratifiedSampling KernelBatch::sampling() const {
  return {model().samples, model().near_m, model().far_m, true, random_key(1, kStreamSamples)};
}

GridBatch::GridBatch(kernels::Backend& backend, const SyntheticDrive& drive)
    : state(make_initial_state(options_of("grid", 32, per_ray), drive.scene)) {
  constexpr int kRays = 2048;
  PixelSampler(drive.scene, drive.images, 1).gather(0, kRays, &rays);
  const std::size_t n = static_cast<std::size_t>(rays.n) * per_ray;
  edges = Buffer<float>(n + rays.n);
  position = Buffer<float>(3 * n);
  footprint = Buffer<float>(n);
  features = Buffer<float>(n * model().field.grid.outputs());
  d_features = Buffer<float>(features.size());
  harmonics = Buffer<float>(static_cast<std::size_t>(rays.n) * kHarmonics);
  std::ranges::fill(harmonics.span(), 0.3f);
  raw = Buffer<float>(4 * n);
  std::ranges::fill(raw.span(), 1e-3f);
  d_table = Buffer<float>(grid().table.size());
  d_weights = Buffer<float>(network().weights.size());
  kernels::GridStages& stages = backend.grid();
  stages.sample_uniform(
      rays_of(rays),
      {per_ray, model().spacing, model().contraction, true, random_key(1, kStreamSamples)}, edges);
  stages.contract(model().contraction, rays_of(rays), rays.pixel_angle, {per_ray, edges}, 0,
                  position, footprint);
  points = {n, position, footprint};
  stages.encode(grid(), points, features);
}

TrainState make_splat_state(const SyntheticDrive& drive, int n) {
  TrainOptions options;
  options.method = "splat";
  TrainState state = make_initial_state(options, drive.scene);
  auto& model = static_cast<SplatModel&>(*state.model);
  const Rigid3d world_from_camera = drive.scene.world_from_camera(drive.scene.views[0]);
  const std::uint64_t key = random_key(1, kStreamTest);
  const int actors = static_cast<int>(drive.scene.actors.size()),
            of_actors = actors > 0 ? n / 4 : 0;
  std::vector<GaussianList> lists(1 + drive.scene.actors.size());
  const auto unit = [&](int i, int k) {
    return double(random_unit(key, 8 * std::uint64_t(i) + std::uint64_t(k)));
  };
  const auto put = [&](int i, const Eigen::Vector3d& at, double size, double distance,
                       GaussianList* list) {
    list->rows.resize(list->rows.size() + kGaussianRows);
    float* const rows = &*(list->rows.end() - kGaussianRows);
    for (int k = 0; k < 3; ++k) {
      rows[kPositionRow + k] = static_cast<float>(at[k]);
      rows[kLogScaleRow + k] = static_cast<float>(std::log(size * (0.3 + unit(i, 3 + k))));
      rows[kColourRow + k] = static_cast<float>(unit(i, 5 + k));
    }
    rows[kQuaternionRow] = 1;
    rows[kOpacityRow] = static_cast<float>(3 * unit(i, 6));
    rows[kDistanceRow] = static_cast<float>(distance);
  };
  for (int i = 0; i < n - of_actors; ++i) {
    // Distances as LiDAR and images have them: even in their logarithm, 3 to 100 m.
    const double z = 3 * std::pow(100.0 / 3, unit(i, 0)), side = 2 * unit(i, 1) - 1;
    const int surface = static_cast<int>(3 * unit(i, 2));  // road, left, right
    const Eigen::Vector3d at = surface == 0   ? Eigen::Vector3d(8 * side, 1.5, z)
                               : surface == 1 ? Eigen::Vector3d(-8, 1.5 - 10 * unit(i, 1), z)
                                              : Eigen::Vector3d(8, 1.5 - 10 * unit(i, 1), z);
    const double size = 0.5 * z * std::sqrt(3 * 16 * std::log(100.0 / 3) / (z * n));
    put(i, world_from_camera * at, size, at.norm(), lists.data());
  }
  for (int i = n - of_actors; i < n; ++i) {
    const auto actor = static_cast<std::size_t>(i % actors);
    const Eigen::Vector3d at =
        Eigen::Vector3d(unit(i, 0), unit(i, 1), unit(i, 2)) - Eigen::Vector3d::Constant(0.5);
    put(i, drive.scene.actors[actor].size_m.cwiseProduct(at), 0.05, 10, &lists[1 + actor]);
  }
  model.set_gaussians(lists, drive.scene.actors);
  state.adam = model.zero_moments();
  return state;
}

}  // namespace redrive::bench

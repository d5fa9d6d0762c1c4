// SPDX-License-Identifier: Apache-2.0
// Backends that rasterise Gaussians against the oracle, which blends every Gaussian in every pixel.
// Tolerances: colours of 1 with early ending below kMinTransmittance, and pixels where alpha is
// kMinAlpha but for rounding; sums of derivatives relative
// to the largest of their row.
#include <algorithm>
#include <cmath>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include <gtest/gtest.h>

#include "candidates.h"
#include "redrive/camera/camera.h"
#include "redrive/camera/plain_camera.h"
#include "redrive/kernels/gaussian/gaussian_stages.h"
#include "redrive/math/rigid3.h"
#include "redrive/math/so3.h"
#include "redrive/optim/adam.h"
#include "redrive/optim/packed_moments.h"

namespace redrive::kernels::conformance {
namespace {

class GaussianStagesTest : public BackendConformance {};
INSTANTIATE_TEST_SUITE_P(Backends, GaussianStagesTest, testing::ValuesIn(splat_candidates()),
                         name_of);

constexpr std::string_view kPinhole = "opencv_pinhole", kMei = "mei";

struct GaussianCase {
  std::size_t n = 203;  // no multiple of a block
  std::vector<float> numbers;
  PlainCamera camera;
  std::vector<PlainPose> poses;
  RasterSize size;
  std::vector<float> log_range, d_rgb, d_transmittance, error, d_range;
  std::vector<std::uint8_t> tiles;
  std::vector<std::vector<PlainPose>> poses_of_part;
  std::vector<GaussianPart> parts;
  std::vector<float> u, v;  ///< centres of the pixels; empty: they are a grid
  bool by_column = false;

  explicit GaussianCase(std::string_view model, bool rolling, bool ranges, bool masked = false) {
    const CameraModelInfo& info = *find_camera_model(model);
    const double f = info.perspective ? 60 : model == kMei ? 90 : 45;
    CameraCalibration calibration{"CAM", std::string(model), {f, 0.97 * f, 33, 20}, 70, 43};
    calibration.parameters.insert(calibration.parameters.end(), info.typical.begin(),
                                  info.typical.end());
    camera = make_plain_camera(make_camera(calibration));
    size = raster_size(camera.width, camera.height);
    for (int key = 0; key < (rolling ? 3 : 1); ++key) {
      Rigid3d pose = Rigid3d::Identity();
      pose.linear() = so3_exp(Eigen::Vector3d(0.02 * key, 0.1, -0.03 * key));
      pose.translation() = Eigen::Vector3d(0.1 * key, 0.05, 0.02 * key);
      poses.push_back(plain(pose));
    }
    numbers.resize(gaussian_blocks(n) * kBlockSize);
    const std::vector<float> random = random_floats(n * kGaussianRows, 31, -1, 1);
    for (std::size_t i = 0; i < n; ++i) {
      for (int row = 0; row < kGaussianRows; ++row)
        numbers[gaussian_slot(i, row)] = random[i * kGaussianRows + row];
      const float depth = 3 + 3 * random[i * kGaussianRows + 2];  // some behind the camera
      numbers[gaussian_slot(i, kPositionRow)] *= 0.9f * depth;
      numbers[gaussian_slot(i, kPositionRow + 1)] *= 0.6f * depth;
      numbers[gaussian_slot(i, kPositionRow + 2)] = depth;
      for (int k = 0; k < 3; ++k) {
        numbers[gaussian_slot(i, kLogScaleRow + k)] -= 2;
        numbers[gaussian_slot(i, kColourRow + k)] += 0.8f;
      }
      for (int row = kLidarRow; row < kDistanceRow; ++row) numbers[gaussian_slot(i, row)] += 0.4f;
      numbers[gaussian_slot(i, kOpacityRow)] *= 3;
    }
    d_rgb = random_floats(3 * size.plane(), 32, -1, 1);
    d_transmittance = random_floats(size.plane(), 39, 0, 1);
    error = random_floats(size.plane(), 33, 0, 1);
    if (ranges) {
      log_range = random_floats(size.plane(), 34, 0.5f, 1.8f);
      for (std::size_t i = 0; i < log_range.size(); i += 3) log_range[i] = kNoRange;
      d_range = random_floats(size.plane(), 35, 0, 1);
    }
    if (masked) {
      tiles.assign(size.plane() / 256, 1);
      tiles[1] = tiles[4] = 0;
    }
  }
  /// Replaces the Gaussians by many small, faint ones in four tiles, so that pixels have hundreds.
  /// No two are as far away but for 2^-16, where kernels may order them either way.
  void crowd() {
    n = 4001;
    numbers.assign(gaussian_blocks(n) * kBlockSize, 0);
    const std::vector<float> random = random_floats(n * kGaussianRows, 41, -1, 1);
    const Rigid3d world_from_camera = rigid(poses[0]);
    for (std::size_t i = 0; i < n; ++i) {
      const auto at = [&](int row) -> float& { return numbers[gaussian_slot(i, row)]; };
      for (int row = 0; row < kGaussianRows; ++row) at(row) = random[i * kGaussianRows + row];
      const double distance = 3 + 2 * double(i * 1000 % n) / double(n);
      const Eigen::Vector3d direction(0.15 * double(at(0)), 0.12 * double(at(1)), 1);
      const Eigen::Vector3d position = world_from_camera * (distance * direction.normalized());
      for (int k = 0; k < 3; ++k) {
        at(kPositionRow + k) = static_cast<float>(position[k]);
        at(kLogScaleRow + k) -= 3;
        at(kColourRow + k) += 0.8f;
      }
      for (int row = kLidarRow; row < kDistanceRow; ++row) at(row) += 0.4f;
      at(kOpacityRow) -= 3;
    }
  }
  /// Makes three parts of the last blocks: one that moves, one that is not drawn, one that turns.
  void cut_into_parts() {
    poses_of_part.resize(3);
    for (std::size_t key = 0; key < poses.size(); ++key) {
      const Rigid3d world_from_camera = rigid(poses[key]);
      Rigid3d moved = Rigid3d::Identity(), turned = Rigid3d::Identity();
      moved.translation() = Eigen::Vector3d(0.3 + 0.05 * double(key), -0.2, 0.1);
      turned.linear() = so3_exp(Eigen::Vector3d(0.05, -0.1 - 0.02 * double(key), 0.2));
      poses_of_part[0].push_back(plain(moved * world_from_camera));
      poses_of_part[2].push_back(plain(turned * world_from_camera));
    }
    const std::size_t blocks = gaussian_blocks(n);
    for (std::size_t part = 0; part < 3; ++part)
      parts.push_back({blocks - 8 + 3 * part, poses_of_part[part]});
  }
  /// Makes the image a part of a LiDAR's turn: beams at uneven elevations, each with an offset in
  /// azimuth, no two firings quite alike.
  void make_scan() {
    constexpr float kPerRadian = 45;
    camera = make_spherical_camera(double(kPerRadian), 1.2, camera.width, camera.height);
    by_column = true;
    const std::vector<float> jitter = random_floats(2 * size.plane(), 40, -0.2, 0.2);
    for (int y = 0; y < size.rows; ++y)
      for (int x = 0; x < size.stride; ++x) {
        const float beam = static_cast<float>(y - 21), offset = static_cast<float>(y * 7 % 5);
        u.push_back(0.8f * static_cast<float>(x - 35) + offset + jitter[2 * u.size()]);
        v.push_back(beam * (0.4f + 0.03f * std::fabs(beam)) + jitter[2 * u.size() - 1]);
      }
  }
  GaussianCamera view() const {
    const float width = static_cast<float>(camera.width);
    GaussianCamera out{camera, poses, 0, by_column ? width : float(camera.height), parts};
    out.centres = {u, v};
    out.by_column = by_column;
    if (!u.empty()) out.first_row = 0.5f * width;
    return out;
  }
  Gaussians gaussians() const { return {n, numbers}; }
  RasterOptions options() const {
    return {
        .background = {0.2f, 0.4f, 0.6f}, .depth = true, .tiles = tiles, .log_range = log_range};
  }
};

struct Result {
  RasterCounts counts;
  RasterImage image;
  std::vector<float> gradients, errors;
  /// poses of the world and of each part
  std::vector<GaussianPoseGradient<NumberMath<double>>> poses;
};

RasterImage copy_of(const RasterImage& image) {
  RasterImage copy;
  copy.size = image.size;
  const auto copy_plane = [](const Buffer<float>& from, Buffer<float>* to) {
    *to = Buffer<float>(from.size());
    std::ranges::copy(from.span(), to->data());
  };
  copy_plane(image.rgb, &copy.rgb);
  copy_plane(image.transmittance, &copy.transmittance);
  copy_plane(image.depth, &copy.depth);
  copy_plane(image.range_error, &copy.range_error);
  return copy;
}

/// between: called between the forward and the backward pass.
Result run(
    Backend& backend, const GaussianCase& c, const std::function<void()>& between = [] {}) {
  Result out;
  Raster raster = backend.gaussians().rasterise(c.view(), c.gaussians(), c.options());
  out.counts = raster.counts();
  out.image = copy_of(raster.image());
  between();
  out.gradients.assign(c.numbers.size(), 0);
  out.errors.assign(c.numbers.size() / kGaussianRows, 0);
  out.poses.resize(1 + c.parts.size());
  raster.backward({c.d_rgb, c.d_transmittance, c.error, c.d_range},
                  {.gradients = out.gradients, .errors = out.errors}, out.poses);
  return out;
}

void expect_same(const GaussianCase& c, const Result& a, const Result& b) {
  EXPECT_EQ(a.counts.visible, b.counts.visible);
  EXPECT_GT(b.counts.visible, c.n / 4);
  const std::size_t plane = c.size.plane();
  int other_depths = 0;
  for (int y = 0; y < c.camera.height; ++y)
    for (int x = 0; x < c.camera.width; ++x) {
      if (!c.tiles.empty() && !c.tiles[y / 16 * (c.size.stride / 16) + x / 16]) continue;
      const std::size_t i = static_cast<std::size_t>(y) * c.size.stride + x;
      for (int k = 0; k < 3; ++k)
        ASSERT_NEAR(a.image.rgb[k * plane + i], b.image.rgb[k * plane + i], 2e-3) << x << " " << y;
      ASSERT_NEAR(a.image.transmittance[i], b.image.transmittance[i], 1.1e-3);
      // Where the transmittance passes 1/2 within rounding, the median is one of two.
      other_depths += std::fabs(a.image.depth[i] - b.image.depth[i]) > 1e-3f;
      if (!c.log_range.empty()) {
        ASSERT_NEAR(a.image.range_error[i], b.image.range_error[i], 2e-3);
      }
    }
  EXPECT_LT(other_depths, 10);
  const float most_error = std::ranges::max(b.errors);
  EXPECT_GT(most_error, 0);
  for (std::size_t i = 0; i < b.errors.size(); ++i)
    ASSERT_NEAR(a.errors[i], b.errors[i], 6e-3 * double(most_error)) << i;
  for (int row = 0; row < kDistanceRow; ++row) {
    if (!is_seen(seen_by(c.camera), row)) continue;
    double most = 0;
    for (std::size_t i = 0; i < c.n; ++i)
      most = std::max(most, std::fabs(double(b.gradients[gaussian_slot(i, row)])));
    EXPECT_GT(most, 0) << "row " << row;
    for (std::size_t i = 0; i < c.n; ++i)
      ASSERT_NEAR(a.gradients[gaussian_slot(i, row)], b.gradients[gaussian_slot(i, row)],
                  6e-3 * most)
          << "row " << row << " of " << i;
  }
  for (std::size_t p = 0; p < b.poses.size(); ++p)
    for (int k = 0; k < 3; ++k) {
      const auto &found = a.poses[p], &expected = b.poses[p];
      EXPECT_NEAR(found.translation[k], expected.translation[k],
                  5e-3 * std::fabs(expected.translation[k]) + 0.3);
      EXPECT_NEAR(found.rotation[k], expected.rotation[k],
                  5e-3 * std::fabs(expected.rotation[k]) + 0.3);
    }
}

TEST_P(GaussianStagesTest, ImagesAndGradientsAgreeWithTheOracle) {
  const auto backend = make(), ref = make_ref_backend();
  for (const CameraModelInfo& model : camera_models())
    for (const bool rolling : {false, true}) {
      SCOPED_TRACE(model.name);
      SCOPED_TRACE(rolling ? "rolling" : "global");
      const bool masked = !model.perspective;
      const GaussianCase c(model.name, rolling, /*ranges=*/masked != rolling, masked);
      expect_same(c, run(*backend, c), run(*ref, c));
    }
}

TEST_P(GaussianStagesTest, ScansAndTheirGradientsAgreeWithTheOracle) {
  const auto backend = make(), ref = make_ref_backend();
  for (const bool rolling : {false, true}) {
    SCOPED_TRACE(rolling ? "rolling" : "global");
    GaussianCase c(kPinhole, rolling, /*ranges=*/true, /*masked=*/rolling);
    c.make_scan();
    c.cut_into_parts();
    expect_same(c, run(*backend, c), run(*ref, c));
  }
}

/// Near ties apart, by rounding and early ending.
TEST_P(GaussianStagesTest, TilesOfHundredsOfGaussiansAgreeWithTheOracle) {
  const auto backend = make(), ref = make_ref_backend();
  for (const bool scan : {false, true}) {
    SCOPED_TRACE(scan ? "scan" : "image");
    GaussianCase c(kPinhole, /*rolling=*/false, /*ranges=*/scan);
    c.crowd();
    if (scan) c.make_scan();
    const Result found = run(*backend, c);
    EXPECT_GT(found.counts.pairs, 3u * 256 * 4);
    expect_same(c, found, run(*ref, c));
  }
}

TEST_P(GaussianStagesTest, PartsAndTheirExtentsAgreeWithTheOracle) {
  const auto backend = make(), ref = make_ref_backend();
  for (const bool rolling : {false, true}) {
    SCOPED_TRACE(rolling ? "rolling" : "global");
    GaussianCase c(kPinhole, rolling, /*ranges=*/false, /*masked=*/rolling);
    c.cut_into_parts();
    // With one object of all parts, of which one is not drawn.
    c.parts[1].continues = c.parts[2].continues = rolling;
    for (std::size_t i = c.parts[0].first_block * kGaussianBlock; i < c.n; ++i) {
      c.numbers[gaussian_slot(i, kOpacityRow)] = 3;
      for (int k = 0; k < 3; ++k) c.numbers[gaussian_slot(i, kLogScaleRow + k)] += 0.7f;
    }
    RasterOptions options = c.options();
    options.parts = true;
    const Raster a = backend->gaussians().rasterise(c.view(), c.gaussians(), options),
                 b = ref->gaussians().rasterise(c.view(), c.gaussians(), options);
    int others = 0, moving = 0;
    for (int y = 0; y < c.camera.height; ++y)
      for (int x = 0; x < c.camera.width; ++x) {
        if (!c.tiles.empty() && !c.tiles[y / 16 * (c.size.stride / 16) + x / 16]) continue;
        const std::size_t i = static_cast<std::size_t>(y) * c.size.stride + x;
        others += a.image().parts[i] != b.image().parts[i];
        moving += b.image().parts[i] != 0;
      }
    EXPECT_GT(moving, 200);
    EXPECT_LT(others, 8);
    const std::size_t objects = rolling ? 1 : 3;
    ASSERT_EQ(a.image().extents.size(), objects);
    ASSERT_EQ(b.image().extents.size(), objects);
    for (std::size_t object = 0; object < objects; ++object) {
      const PartExtent &found = a.image().extents[object], &expected = b.image().extents[object];
      EXPECT_EQ(expected.whole > 20, rolling || object != 1) << object;
      EXPECT_LE(expected.visible, expected.whole + 8) << object;
      EXPECT_NEAR(found.visible, expected.visible, 8);
      EXPECT_NEAR(found.whole, expected.whole, 8);
      if (expected.whole == 0) continue;
      EXPECT_NEAR(found.left, expected.left, 2);
      EXPECT_NEAR(found.right, expected.right, 2);
      EXPECT_NEAR(found.top, expected.top, 2);
      EXPECT_NEAR(found.bottom, expected.bottom, 2);
    }
  }
}

/// The number of points is no multiple of a vector; every eighth is behind the camera.
TEST_P(GaussianStagesTest, ProjectedPointsAgreeWithTheOracle) {
  const auto backend = make(), oracle = make_ref_backend();
  for (const CameraModelInfo& model : camera_models())
    for (const bool rolling : {false, true})
      for (const bool by_column : {false, true}) {
        SCOPED_TRACE(std::string(model.name) + (rolling ? ", rolling" : ""));
        GaussianCase c(model.name, rolling, false);
        c.by_column = by_column;
        std::vector<float> points(3 * c.n), expected(2 * c.n), got(2 * c.n);
        for (std::size_t i = 0; i < c.n; ++i)
          for (int k = 0; k < 3; ++k)
            points[k * c.n + i] =
                (i % 8 == 0 && k == 2 ? -1 : 1) * c.numbers[gaussian_slot(i, kPositionRow + k)];
        oracle->gaussians().project_points(c.view(), points, expected);
        backend->gaussians().project_points(c.view(), points, got);
        int seen = 0, unseen = 0;
        for (std::size_t i = 0; i < 2 * c.n; ++i) {
          ASSERT_EQ(std::isnan(got[i]), std::isnan(expected[i])) << i;
          ++(std::isnan(got[i]) ? unseen : seen);
          if (!std::isnan(got[i])) {
            ASSERT_NEAR(got[i], expected[i], 2e-3) << i;
          }
        }
        EXPECT_GT(seen, 40);
        EXPECT_GT(unseen, 0);
      }
}

/// The camera turned by a quarter about its axis has columns in place of rows.
TEST_P(GaussianStagesTest, PosesByColumnAreThoseByRowOfATurnedCamera) {
  const auto backend = make();
  GaussianCase rows(kPinhole, true, false), columns = rows;
  columns.by_column = true;
  std::swap(columns.camera.width, columns.camera.height);
  std::swap(columns.camera.fx, columns.camera.fy);
  std::swap(columns.camera.cx, columns.camera.cy);
  columns.camera.cx = float(columns.camera.width - 1) - columns.camera.cx;  // u = -v of the rows
  Rigid3d turn = Rigid3d::Identity();
  turn.linear() << 0, 1, 0, -1, 0, 0, 0, 0, 1;
  for (PlainPose& pose : columns.poses) pose = plain(rigid(pose) * turn);
  std::ranges::reverse(columns.poses);
  // A pinhole: the typical lens is not symmetric.
  for (GaussianCase* c : {&rows, &columns}) std::ranges::fill(c->camera.numbers, 0.0f);
  const Raster a = backend->gaussians().rasterise(rows.view(), rows.gaussians(), rows.options()),
               b = backend->gaussians().rasterise(columns.view(), columns.gaussians(),
                                                  columns.options());
  for (int y = 0; y < rows.camera.height; ++y)
    for (int x = 0; x < rows.camera.width; ++x)
      ASSERT_NEAR(a.image().rgb[y * a.image().size.stride + x],
                  b.image().rgb[x * b.image().size.stride + columns.camera.width - 1 - y], 2e-3)
          << x << " " << y;
}

TEST_P(GaussianStagesTest, CentresOfTheGridAreTheGrid) {
  const auto backend = make();
  GaussianCase grid(kMei, true, true), centres = grid;
  for (int y = 0; y < grid.size.rows; ++y)
    for (int x = 0; x < grid.size.stride; ++x) {
      centres.u.push_back(static_cast<float>(x));
      centres.v.push_back(static_cast<float>(y));
    }
  GaussianCamera camera = centres.view();
  camera.first_row = 0;
  const Raster a = backend->gaussians().rasterise(grid.view(), grid.gaussians(), grid.options()),
               b = backend->gaussians().rasterise(camera, centres.gaussians(), centres.options());
  for (int y = 0; y < grid.camera.height; ++y)
    for (int x = 0; x < grid.camera.width; ++x) {
      const std::size_t i = static_cast<std::size_t>(y) * grid.size.stride + x;
      for (std::size_t k = 0; k < 3; ++k)
        ASSERT_NEAR(a.image().rgb[k * grid.size.plane() + i],
                    b.image().rgb[k * grid.size.plane() + i], 2e-3)
            << x << " " << y;
      ASSERT_NEAR(a.image().range_error[i], b.image().range_error[i], 2e-3) << x << " " << y;
    }
}

TEST_P(GaussianStagesTest, TheOrderOfCentresChangesNoRay) {
  const auto backend = make();
  GaussianCase c(kPinhole, true, false);
  c.make_scan();
  GaussianCase mixed = c;
  const std::size_t plane = c.size.plane(), step = 1777;  // a prime: every place once
  for (std::size_t i = 0; i < plane; ++i) {
    mixed.u[i] = c.u[i * step % plane];
    mixed.v[i] = c.v[i * step % plane];
  }
  const Raster a = backend->gaussians().rasterise(c.view(), c.gaussians(), c.options()),
               b = backend->gaussians().rasterise(mixed.view(), mixed.gaussians(), mixed.options());
  for (std::size_t i = 0; i < plane; ++i)
    ASSERT_NEAR(b.image().transmittance[i], a.image().transmittance[i * step % plane], 1.1e-3) << i;
}

TEST_P(GaussianStagesTest, PartsThatMoveAgreeWithTheOracle) {
  const auto backend = make(), ref = make_ref_backend();
  for (const bool rolling : {false, true}) {
    SCOPED_TRACE(rolling ? "rolling" : "global");
    GaussianCase c(kPinhole, rolling, /*ranges=*/true);
    const Result whole = run(*backend, c);
    c.cut_into_parts();
    const Result found = run(*backend, c), expected = run(*ref, c);
    expect_same(c, found, expected);
    EXPECT_LT(found.counts.visible, whole.counts.visible);  // one part is not drawn
    for (int k = 0; k < 3; ++k) {
      EXPECT_NE(expected.poses[1].translation[k], 0);
      EXPECT_EQ(found.poses[2].translation[k], 0);
      EXPECT_NE(expected.poses[3].rotation[k], 0);
    }
  }
}

/// A part is drawn as the same Gaussians moved in the world.
TEST_P(GaussianStagesTest, APartIsSeenWhereItsPoseIs) {
  const auto backend = make();
  GaussianCase moved(kMei, false, false);
  for (std::size_t i = 0; i < moved.n; ++i)
    for (int row = kHarmonicsRow; row < kLidarRow; ++row)
      moved.numbers[gaussian_slot(i, row)] = 0;  // they turn with the part
  GaussianCase parts = moved;
  parts.cut_into_parts();
  const std::size_t first = parts.parts[0].first_block * kGaussianBlock;
  Rigid3d world_from_part[3];
  for (const int part : {0, 2})
    world_from_part[part] = rigid(moved.poses[0]) * rigid(parts.poses_of_part[part][0]).inverse();
  for (std::size_t i = first; i < moved.n; ++i) {
    const std::size_t part = (i - first) / (3 * kGaussianBlock);
    if (part == 1) {
      moved.numbers[gaussian_slot(i, kOpacityRow)] = -20;  // not drawn
      continue;
    }
    Eigen::Vector3d position;
    double q[4];
    for (int k = 0; k < 3; ++k) position[k] = moved.numbers[gaussian_slot(i, kPositionRow + k)];
    for (int k = 0; k < 4; ++k) q[k] = moved.numbers[gaussian_slot(i, kQuaternionRow + k)];
    position = world_from_part[part] * position;
    const Eigen::Quaterniond turned = Eigen::Quaterniond(world_from_part[part].linear()) *
                                      Eigen::Quaterniond(q[0], q[1], q[2], q[3]);
    const double to[4] = {turned.w(), turned.x(), turned.y(), turned.z()};
    for (int k = 0; k < 3; ++k)
      moved.numbers[gaussian_slot(i, kPositionRow + k)] = static_cast<float>(position[k]);
    for (int k = 0; k < 4; ++k)
      moved.numbers[gaussian_slot(i, kQuaternionRow + k)] = static_cast<float>(to[k]);
  }
  const Result found = run(*backend, parts), expected = run(*backend, moved);
  EXPECT_EQ(found.counts.visible, expected.counts.visible);
  for (int y = 0; y < moved.camera.height; ++y)
    for (int x = 0; x < moved.camera.width; ++x) {
      const std::size_t i = static_cast<std::size_t>(y) * moved.size.stride + x;
      for (int k = 0; k < 3; ++k)
        ASSERT_NEAR(found.image.rgb[k * moved.size.plane() + i],
                    expected.image.rgb[k * moved.size.plane() + i], 2e-3)
            << x << " " << y;
    }
}

TEST_P(GaussianStagesTest, AnotherImageBetweenForwardAndBackwardChangesNothing) {
  const auto backend = make();
  const GaussianCase c(kMei, true, false), other(kPinhole, false, true);
  const Result expected = run(*backend, c);
  for (const bool released : {false, true}) {
    const Result found = run(*backend, c, [&] {
      if (released) backend->gaussians().release();
      run(*backend, other);
    });
    EXPECT_EQ(found.gradients, expected.gradients);
    EXPECT_EQ(found.errors, expected.errors);
    for (std::size_t part = 0; part < found.poses.size(); ++part)
      for (int k = 0; k < 3; ++k) {
        EXPECT_EQ(found.poses[part].translation[k], expected.poses[part].translation[k]);
        EXPECT_EQ(found.poses[part].rotation[k], expected.poses[part].rotation[k]);
      }
  }
}

TEST_P(GaussianStagesTest, AWindowIsAPartOfTheImage) {
  const auto backend = make();
  GaussianStages& stages = backend->gaussians();
  for (const bool by_column : {false, true}) {
    GaussianCase c(kMei, true, false);
    c.by_column = by_column;
    const Raster whole = stages.rasterise(c.view(), c.gaussians(), c.options());
    GaussianCamera window = c.view();
    window.camera.cx -= 32;
    window.camera.cy -= 16;
    window.camera.width = 33;
    window.camera.height = 20;
    window.first_row = by_column ? 32 : 16;
    const Raster part = stages.rasterise(window, c.gaussians(), c.options());
    for (int y = 0; y < 20; ++y)
      for (int x = 0; x < 33; ++x)
        ASSERT_NEAR(part.image().rgb[y * part.image().size.stride + x],
                    whole.image().rgb[(y + 16) * c.size.stride + x + 32], 1e-3)
            << x << " " << y;
  }
}

/// A window of a photograph with a masked disc and transparent pixels.
struct LossCase {
  RasterSize size = raster_size(37, 29);
  std::vector<float> rgb = random_floats(3 * size.plane(), 36, 0, 1);
  std::vector<float> log_shading = random_floats(3 * 7 * 5, 38, -0.2f, 0.2f);
  std::vector<std::uint8_t> target, alpha, used;

  LossCase() {
    const std::vector<float> random = random_floats(4 * 50 * 40, 37, 0, 255);
    target.assign(random.begin(), random.begin() + 3 * 50 * 40);
    alpha.assign(random.end() - 50 * 40, random.end());
    for (int y = 0; y < 40; ++y)
      for (int x = 0; x < 50; ++x) used.push_back((x - 30) * (x - 30) + (y - 15) * (y - 15) > 30);
  }
  ImageLossInput input(float l1_weight, float ssim_weight) const {
    return {size,
            rgb,
            {50, 10, 8, target, alpha, used, {0.2f, -0.1f, 0.3f}},
            {{1.1f, 0.9f, 1}, 7, 5, log_shading},
            l1_weight,
            ssim_weight};
  }
  /// The gain of channel k of a pixel by its definition (field/shading.h).
  double gain(int x, int y, int k) const {
    const auto place = [](int pixel, int pixels, int cells) {
      return std::clamp((pixel + 0.5) / pixels * cells - 0.5, 0.0, cells - 1.0);
    };
    const double u = place(x + 10, 50, 7), v = place(y + 8, 40, 5);
    double shading = 0;
    for (int row = 0; row < 5; ++row)
      for (int column = 0; column < 7; ++column)
        shading += std::max(0.0, 1 - std::fabs(u - column)) *
                   std::max(0.0, 1 - std::fabs(v - row)) *
                   std::exp(double(log_shading[(k * 5 + row) * 7 + column]));
    return shading * double(input(1, 0).gains.colour[k]);
  }
};

TEST_P(GaussianStagesTest, LossOfAnImageAgreesWithTheOracle) {
  const auto backend = make(), ref = make_ref_backend();
  const LossCase c;
  const std::size_t plane = c.size.plane();
  for (const float ssim_weight : {0.0f, 0.2f}) {
    std::vector<float> d_rgb(3 * plane), error(plane), d_expected(3 * plane), expected_error(plane);
    const ImageLossInput input = c.input(0.8f, ssim_weight);
    const ImageLossOutput found = backend->gaussians().image_loss(input, d_rgb, error),
                          expected = ref->gaussians().image_loss(input, d_expected, expected_error);
    EXPECT_NEAR(found.l1, expected.l1, 1e-5);
    EXPECT_NEAR(found.dssim, expected.dssim, 1e-5);
    EXPECT_NEAR(found.mse, expected.mse, 1e-5);
    EXPECT_EQ(found.pixels, expected.pixels);
    EXPECT_LT(found.pixels, 37 * 29);
    ASSERT_EQ(found.patches.size(), expected.patches.size());
    for (std::size_t t = 0; t < found.patches.size(); ++t)
      for (int k = 0; k < 3; ++k) {
        EXPECT_EQ(found.patches[t].pixels[k], expected.patches[t].pixels[k]);
        EXPECT_NEAR(found.patches[t].target[k], expected.patches[t].target[k], 1e-4);
        EXPECT_NEAR(found.patches[t].rendered[k], expected.patches[t].rendered[k], 1e-4);
      }
    for (int y = 0; y < c.size.height; ++y)
      for (int x = 0; x < c.size.width; ++x) {
        const std::size_t i = static_cast<std::size_t>(y) * c.size.stride + x;
        ASSERT_NEAR(error[i], expected_error[i], 1e-5);
        for (int k = 0; k < 3; ++k)
          ASSERT_NEAR(d_rgb[k * plane + i], d_expected[k * plane + i], 1e-7);
      }
  }
}

/// Loss of a raster with its transmittance and ranges, and its derivatives by the Gaussians.
TEST_P(GaussianStagesTest, LossOfARasterAgreesWithTheOracle) {
  const auto backend = make(), ref = make_ref_backend();
  const GaussianCase c(kMei, true, true);
  const std::vector<float> random = random_floats(4 * 70 * 43, 46, 0, 255),
                           log_shading = random_floats(3 * 24 * 16, 47, -0.2f, 0.2f);
  const std::vector<std::uint8_t> target(random.begin(), random.begin() + 3 * 70 * 43);
  std::vector<std::uint8_t> used(70 * 43, 1);
  std::fill(used.begin() + 500, used.begin() + 900, std::uint8_t{0});
  ImageLossInput input;
  input.target = {.width = 70, .rgb = target, .used = used};
  input.gains = {{1.1f, 0.9f, 1}, 24, 16, log_shading};
  const auto run_loss = [&](Backend& by, Result* out) {
    Raster raster = by.gaussians().rasterise(c.view(), c.gaussians(), c.options());
    out->gradients.assign(c.numbers.size(), 0);
    out->errors.assign(c.numbers.size() / kGaussianRows, 0);
    out->poses.resize(1);
    const ImageLossOutput loss =
        raster.backward(input, {.transmittance = 0.3f, .range = 1e-3f},
                        {.gradients = out->gradients, .errors = out->errors}, out->poses);
    out->counts = raster.counts();
    out->image = copy_of(raster.image());
    return loss;
  };
  Result found, expected;
  const ImageLossOutput a = run_loss(*backend, &found), b = run_loss(*ref, &expected);
  expect_same(c, found, expected);
  EXPECT_NEAR(a.l1, b.l1, 1e-3 * b.l1);
  EXPECT_NEAR(a.dssim, b.dssim, 1e-3 * b.dssim);
  EXPECT_NEAR(a.mse, b.mse, 1e-3 * b.mse);
  EXPECT_NEAR(a.colour_variance, b.colour_variance, 1e-5);
  EXPECT_EQ(a.pixels, 70 * 43 - 400);
  EXPECT_NEAR(a.transmittance, b.transmittance, 1e-3);
  EXPECT_GT(b.transmittance, 0);
  EXPECT_NEAR(a.range, b.range, 1e-3 * b.range);
  EXPECT_GT(b.range, 0);
}

TEST_P(GaussianStagesTest, AnUpdateByALossThatIsNotFiniteChangesNothing) {
  const auto backend = make();
  const GaussianCase c(kMei, true, true);
  const std::vector<std::uint8_t> target(3 * 70 * 43, 99);
  std::vector<float> numbers = c.numbers, errors(c.numbers.size() / kGaussianRows, 0.5f);
  std::vector<std::uint32_t> moments(numbers.size(), pack_moments(0.1f, 0.2f));
  GaussianUpdate update;
  update.step = adam_step(0, 3);
  for (float& rate : update.rates) rate = 0.01f;
  update.numbers = numbers;
  update.moments = moments;
  update.errors = errors;
  ImageLossInput input;
  input.target = {.width = 70, .rgb = target};
  for (const float gain : {NAN, 1.0f}) {
    const bool finite = gain == 1;
    SCOPED_TRACE(gain);
    for (float& colour : input.gains.colour) colour = gain;
    std::array<GaussianPoseGradient<NumberMath<double>>, 1> d_pose{};
    const ImageLossOutput loss =
        backend->gaussians()
            .rasterise(c.view(), {c.n, numbers}, c.options())
            .backward(input, {.transmittance = 0.3f, .range = 1e-3f}, {.update = &update}, d_pose);
    backend->gaussians().fetch();
    EXPECT_EQ(is_finite(loss), finite);
    EXPECT_EQ(numbers == c.numbers, !finite);
    EXPECT_EQ(std::ranges::count(moments, pack_moments(0.1f, 0.2f)) == std::ssize(moments),
              !finite);
    EXPECT_EQ(std::ranges::count(errors, 0.5f) == std::ssize(errors), !finite);
    EXPECT_EQ(d_pose[0].translation[0] == 0, !finite);
  }
}

TEST_P(GaussianStagesTest, LossIsZeroInThePaddingWhateverWasThere) {
  const auto backend = make();
  const LossCase c;
  const std::size_t plane = c.size.plane();
  std::vector<float> d_rgb(3 * plane, 7), error(plane, 7);
  backend->gaussians().image_loss(c.input(0.8f, 0.2f), d_rgb, error);
  std::size_t padding = 0;
  for (std::size_t i = 0; i < plane; ++i) {
    const int x = static_cast<int>(i) % c.size.stride, y = static_cast<int>(i) / c.size.stride;
    if (x < c.size.width && y < c.size.height) continue;
    ++padding;
    ASSERT_EQ(error[i], 0) << x << " " << y;
    for (int k = 0; k < 3; ++k) ASSERT_EQ(d_rgb[k * plane + i], 0) << x << " " << y;
  }
  EXPECT_GT(padding, 0u);
}

TEST_P(GaussianStagesTest, LossAgreesWithItsDerivative) {
  const auto backend = make();
  LossCase c;
  std::vector<float> d_rgb(c.rgb.size()), error(c.size.plane());
  const auto loss = [&](const ImageLossInput& input) {
    const ImageLossOutput out = backend->gaussians().image_loss(input, d_rgb, error);
    return out.l1 + out.dssim;
  };
  ImageLossInput input = c.input(0.3f, 0.7f);
  const auto difference = [&](float* number) {
    const float before = *number;
    *number = before + 1e-2f;
    const double above = loss(input);
    *number = before - 1e-2f;
    const double below = loss(input);
    *number = before;
    return (above - below) / 2e-2;
  };
  for (const std::size_t i : {100, 377, 1700, 2900}) {
    loss(input);
    const double derivative = d_rgb[i];
    EXPECT_NEAR(derivative, difference(&c.rgb[i]), 0.02 * std::fabs(derivative) + 2e-6) << i;
  }
}

TEST_P(GaussianStagesTest, BrightnessOfPatchesIsOfWhatIsNeitherMaskedNorSaturated) {
  const auto backend = make();
  LossCase c;
  c.alpha.clear();
  std::vector<float> d_rgb(c.rgb.size()), error(c.size.plane());
  const ImageLossInput input = c.input(0.8f, 0);
  std::vector<PatchBrightness> expected(c.size.plane() / (kPatchSide * kPatchSide));
  int saturated = 0;
  for (int y = 0; y < c.size.height; ++y)
    for (int x = 0; x < c.size.width; ++x)
      for (int k = 0; k < 3; ++k) {
        const std::size_t pixel = (y + 8) * 50 + x + 10,
                          at = k * c.size.plane() + y * c.size.stride + x;
        const float target = c.target[3 * pixel + k] / 255.0f;
        if (!c.used[pixel]) continue;
        if (target >= kSaturated) {
          ++saturated;
          continue;
        }
        PatchBrightness& patch =
            expected[y / kPatchSide * (c.size.stride / kPatchSide) + x / kPatchSide];
        patch.pixels[k] += 1;
        patch.target[k] += target;
        patch.rendered[k] += c.rgb[at] * static_cast<float>(c.gain(x, y, k));
      }
  EXPECT_GT(saturated, 10);
  const ImageLossOutput out = backend->gaussians().image_loss(input, d_rgb, error);
  ASSERT_EQ(out.patches.size(), expected.size());
  for (std::size_t t = 0; t < expected.size(); ++t)
    for (int k = 0; k < 3; ++k) {
      EXPECT_EQ(out.patches[t].pixels[k], expected[t].pixels[k]) << t;
      EXPECT_NEAR(out.patches[t].target[k], expected[t].target[k], 1e-3) << t;
      EXPECT_NEAR(out.patches[t].rendered[k], expected[t].rendered[k], 1e-3) << t;
    }
}

/// Numbers and moments after a step that updates them.
struct Updated {
  std::vector<float> numbers;
  std::vector<std::uint32_t> moments;
  std::vector<float> errors;
};
/// `kept`: by gradients that are computed first.
Updated run_update(Backend& backend, const GaussianCase& c, bool kept = false) {
  Updated out;
  out.numbers = c.numbers;
  const std::vector<float> m = random_floats(c.numbers.size(), 43, -1, 1),
                           v = random_floats(c.numbers.size(), 44, 0, 1);
  for (std::size_t i = 0; i < m.size(); ++i) out.moments.push_back(pack_moments(m[i], v[i]));
  out.errors = random_floats(c.numbers.size() / kGaussianRows, 45, 0, 1);
  GaussianUpdate update;
  update.step = adam_step(0, 3);
  update.step.epsilon = 1e-15f;
  update.min_log_scale = -2.5f;
  for (int row = 0; row < kDistanceRow; ++row) update.rates[row] = 0.01f * float(row + 1);
  update.numbers = out.numbers;
  update.moments = out.moments;
  update.errors = out.errors;
  update.rows = seen_by(c.camera);
  if (kept) {
    const Result kept_result = run(backend, c);
    backend.gaussians().update_gaussians(update, c.n, kept_result.gradients, kept_result.errors);
    backend.gaussians().fetch();
    return out;
  }
  backend.gaussians()
      .rasterise(c.view(), {c.n, out.numbers}, c.options())
      .backward({c.d_rgb, c.d_transmittance, c.error, c.d_range}, {.update = &update}, {});
  backend.gaussians().fetch();
  return out;
}

// Adam as optim/adam.h has it, by the gradients that the same backend gives.
void expect_adam(Backend& backend, GaussianCase c) {
  for (std::size_t i = 0; i < c.n; ++i)
    c.numbers[gaussian_slot(i, kDistanceRow)] =
        std::fabs(c.numbers[gaussian_slot(i, kDistanceRow)]) + 0.1f;
  const Result computed = run(backend, c);
  const std::vector<float>& gradients = computed.gradients;
  const Updated after = run_update(backend, c);
  const std::vector<float> m = random_floats(c.numbers.size(), 43, -1, 1),
                           v = random_floats(c.numbers.size(), 44, 0, 1),
                           e = random_floats(c.numbers.size() / kGaussianRows, 45, 0, 1);
  int drawn = 0, bounded = 0;
  for (std::size_t i = 0; i < c.n; ++i) {
    const bool changes = gradients[gaussian_slot(i, kOpacityRow)] != 0;
    drawn += changes;
    const float distance = c.numbers[gaussian_slot(i, kDistanceRow)];
    EXPECT_EQ(after.numbers[gaussian_slot(i, kDistanceRow)], distance);
    EXPECT_NEAR(after.errors[i], e[i] + (changes ? computed.errors[i] : 0), 1e-4);
    float expected[kDistanceRow];
    for (int row = 0; row < kDistanceRow; ++row) {
      const std::size_t slot = gaussian_slot(i, row);
      const std::uint32_t packed = pack_moments(m[slot], v[slot]);
      expected[row] = c.numbers[slot];
      if (!changes || !is_seen(seen_by(c.camera), row)) {
        EXPECT_EQ(after.moments[slot], packed);
        continue;
      }
      AdamStep step = adam_step(0.01 * (row + 1) * (row < kLogScaleRow ? distance : 1), 3);
      step.epsilon = 1e-15f;
      float first = unpacked_first(packed), second = unpacked_second(packed);
      adam_update(step, gradients[slot], expected[row], first, second);
      EXPECT_NEAR(unpacked_first(after.moments[slot]), first, 0x1.01p-8 * std::fabs(first));
      EXPECT_NEAR(unpacked_second(after.moments[slot]), second, 0x1.01p-9 * second);
    }
    float* const scales = expected + kLogScaleRow;
    const float smallest = std::min({scales[0], scales[1], scales[2]}),
                least = -2.5f + std::log(distance);
    for (int k = 0; changes && k < 3; ++k)
      if (scales[k] > smallest && scales[k] < least) {
        scales[k] = least;
        ++bounded;
      }
    for (int row = 0; row < kDistanceRow; ++row)
      EXPECT_NEAR(after.numbers[gaussian_slot(i, row)], expected[row],
                  2e-5f * (1 + std::fabs(expected[row])))
          << "row " << row << " of " << i;
  }
  EXPECT_GT(drawn, 60);
  EXPECT_LT(drawn, static_cast<int>(c.n)) << "the others stay";
  EXPECT_GT(bounded, 2);
}

TEST_P(GaussianStagesTest, AnUpdateIsAdamByTheGradients) {
  const auto backend = make();
  GaussianCase c(kPinhole, false, false);
  expect_adam(*backend, c);
  c.make_scan();
  expect_adam(*backend, c);
}

TEST_P(GaussianStagesTest, AnUpdateByKeptGradientsIsTheSame) {
  const auto backend = make();
  GaussianCase c(kMei, true, true);
  for (const bool scan : {false, true}) {
    if (scan) c.make_scan();
    const Updated in_step = run_update(*backend, c), after = run_update(*backend, c, true);
    EXPECT_EQ(in_step.moments, after.moments);
    EXPECT_EQ(in_step.numbers, after.numbers);
  }
}

TEST_P(GaussianStagesTest, ThreadsChangeNoBit) {
  if (make()->name() != "cpu") GTEST_SKIP() << "it has one thread";
  const GaussianCase c(kMei, false, true);
  const Isa isa = *make()->isa();
  const auto one = make_cpu_backend(isa, 1), four = make_cpu_backend(isa, 4);
  const Result a = run(*one, c), b = run(*four, c);
  EXPECT_EQ(a.gradients, b.gradients);
  const Updated of_one = run_update(*one, c), of_four = run_update(*four, c);
  EXPECT_EQ(of_one.numbers, of_four.numbers);
  EXPECT_EQ(of_one.moments, of_four.moments);
  for (int k = 0; k < 3; ++k) EXPECT_EQ(a.poses[0].rotation[k], b.poses[0].rotation[k]);
}

// Sigmoid is 1 in floats: nothing may stop an opaque Gaussian from being trained.
TEST_P(GaussianStagesTest, OpaqueGaussiansHaveGradients) {
  const auto backend = make();
  GaussianCase c(kPinhole, false, false);
  for (std::size_t i = 0; i < c.n; ++i) c.numbers[gaussian_slot(i, kOpacityRow)] = 25;
  const Result result = run(*backend, c);
  int seen = 0, trained = 0;
  for (std::size_t i = 0; i < c.n; ++i) {
    seen += result.gradients[gaussian_slot(i, kColourRow)] != 0;
    trained += result.gradients[gaussian_slot(i, kOpacityRow)] != 0;
  }
  EXPECT_GT(seen, 50);
  EXPECT_GE(trained, 9 * seen / 10);
}

/// A disc that lies in a plane has that plane's depth in every pixel, not its centre's.
TEST_P(GaussianStagesTest, DepthOfADiscIsThatOfItsPlane) {
  const auto backend = make();
  for (const CameraModelInfo& model : camera_models()) {
    SCOPED_TRACE(model.name);
    GaussianCase c(model.name, false, false);
    c.n = 1;
    c.numbers.assign(kBlockSize, 0);
    const Eigen::Vector3d centre(0.5, 0.3, 6),
        normal = Eigen::Vector3d(0.2, -0.8, -0.5).normalized();
    const Eigen::Quaterniond rotation =
        Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), normal);
    const auto set = [&](int row, double value) {
      c.numbers[gaussian_slot(0, row)] = static_cast<float>(value);
    };
    for (int k = 0; k < 3; ++k) {
      set(kPositionRow + k, centre[k]);
      set(kLogScaleRow + k, std::log(k < 2 ? 0.4 : 1e-3));
      set(kColourRow + k, 0.5);
    }
    set(kQuaternionRow, rotation.w());
    for (int k = 0; k < 3; ++k) set(kQuaternionRow + 1 + k, rotation.vec()[k]);
    set(kOpacityRow, 6);
    c.poses = {plain(Rigid3d::Identity())};
    const Raster raster = backend->gaussians().rasterise(c.view(), c.gaussians(), c.options());
    const RasterImage& image = raster.image();
    int found = 0;
    double least = 1e9, most = 0;
    for (int y = 0; y < c.camera.height; ++y)
      for (int x = 0; x < c.camera.width; ++x) {
        const std::size_t i = static_cast<std::size_t>(y) * c.size.stride + x;
        if (image.transmittance[i] > 0.9f) continue;
        // The plane's point in this pixel, by Newton's method along the disc.
        Eigen::Vector2d on_disc(0, 0);
        const Eigen::Matrix3d axes = rotation.toRotationMatrix();
        const auto pixel_of = [&](const Eigen::Vector2d& at) {
          const Eigen::Vector3d p = centre + axes.leftCols<2>() * at;
          const auto pixel = project<NumberMath<double>>(c.camera, p.x(), p.y(), p.z());
          return Eigen::Vector2d(pixel.u - x, pixel.v - y);
        };
        for (int step = 0; step < 20; ++step) {
          constexpr double kStep = 1e-5;
          Eigen::Matrix2d slope;
          for (int k = 0; k < 2; ++k)
            slope.col(k) = (pixel_of(on_disc + kStep * Eigen::Vector2d::Unit(k)) -
                            pixel_of(on_disc - kStep * Eigen::Vector2d::Unit(k))) /
                           (2 * kStep);
          on_disc -= slope.inverse() * pixel_of(on_disc);
        }
        const double expected = (centre + axes.leftCols<2>() * on_disc).norm();
        // The pixel is linear on the disc but for the square of its extent over the distance.
        EXPECT_NEAR(double(image.depth[i]) / expected, 1, 0.02) << x << " " << y;
        least = std::min(least, double(image.depth[i]));
        most = std::max(most, double(image.depth[i]));
        ++found;
      }
    EXPECT_GT(found, 20);
    EXPECT_GT(most / least, 1.15) << "the disc is tilted";
  }
}

/// What a user may steer a camera into: inside a Gaussian, at the fold, needles, huge Gaussians.
TEST_P(GaussianStagesTest, ExtremeGaussiansGiveFiniteImagesAndGradients) {
  const auto backend = make();
  for (const CameraModelInfo& model : camera_models()) {
    SCOPED_TRACE(model.name);
    GaussianCase c(model.name, false, false);
    for (std::size_t i = 0; i < c.n; ++i) {
      for (int k = 0; k < 3; ++k)
        c.numbers[gaussian_slot(i, kLogScaleRow + k)] = (i + k) % 4 == 0   ? 6.0f
                                                        : (i + k) % 4 == 1 ? -18.0f
                                                                           : -1.0f;
      if (i % 5 == 0)
        for (int k = 0; k < 3; ++k)
          c.numbers[gaussian_slot(i, kPositionRow + k)] = k == 2 ? 0.21f : 0.0f;
      if (i % 7 == 0) c.numbers[gaussian_slot(i, kOpacityRow)] = 60;
      if (i % 11 == 0)
        for (int k = 0; k < 4; ++k) c.numbers[gaussian_slot(i, kQuaternionRow + k)] *= 1e-6f;
    }
    const Result result = run(*backend, c);
    for (const float g : result.gradients) ASSERT_TRUE(std::isfinite(g));
    for (std::size_t i = 0; i < 3 * c.size.plane(); ++i)
      ASSERT_TRUE(std::isfinite(result.image.rgb[i]));
  }
}

}  // namespace
}  // namespace redrive::kernels::conformance

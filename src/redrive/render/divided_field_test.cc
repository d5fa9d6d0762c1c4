// SPDX-License-Identifier: Apache-2.0
// Two blocks of Gaussians whose colours, depths and gains are known.
#include "redrive/render/divided_field.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <stdexcept>

#include <gtest/gtest.h>

#include "redrive/methods/splat/known_splats_testing.h"

namespace redrive {
namespace {

constexpr int kFrames = 40;                  ///< a metre and 0.1 s apart; the border is at 19.5 m
constexpr double kFieldLog[] = {0.3, -0.2};  ///< how bright the fields are
constexpr std::int64_t kObject = 7;

/// Log gain of the camera's exposure, as recorded.
double recorded_log(double t_s) { return 0.1 * t_s - 0.1; }

Camera small_camera() {
  return make_camera(
      {"CAM", "opencv_pinhole", {20, 20, 7.5, 5.5, 0, 0, 0, 0, 0}, 16, 12, Rigid3d::Identity()});
}

/// Adds a round Gaussian.
void add(const Eigen::Vector3f& at, float colour, float size, GaussianList* list) {
  std::vector<float> rows(kGaussianRows, 0.0f);
  for (int k = 0; k < 3; ++k) {
    rows[kPositionRow + k] = at[k];
    rows[kLogScaleRow + k] = std::log(size);
    rows[kColourRow + k] = colour;
  }
  rows[kHarmonicsRow] = 0.1f;
  rows[kQuaternionRow] = 1;
  rows[kOpacityRow] = 6;
  rows[kDistanceRow] = 10;
  list->rows.insert(list->rows.end(), rows.begin(), rows.end());
}

/// Block 0 has frames 0..24, block 1 15..39. A field is grey, exp(kFieldLog) too bright, its gains
/// make up for it. With `walls`, a wall is 8 m ahead of where a camera looks in block 0, 10 m in 1.
/// With an object, block 0 has one; block 1 does not know it.
std::shared_ptr<const LoadedBlock> make_block(int b, bool walls, bool with_object = false) {
  auto block = std::make_shared<LoadedBlock>();
  auto model = std::make_unique<SplatModel>();
  const int first = b == 0 ? 0 : 15, last = b == 0 ? 24 : 39;
  model->gains.appearance.cameras = 1;
  model->gains.appearance.knots = last - first + 1;
  model->gains.appearance.knot_spacing_s = 0.1f;
  GaussianList list;
  for (int x = 0; x < kFrames; x += 2)
    if (walls) add({float(x), 0, b == 0 ? 8.0f : 10.0f}, 0.3f, 2, &list);
  known_splats::set_gaussians(list, model.get());
  if (with_object && b == 0) {
    std::vector<GaussianList> lists(2);
    add({0, 0, 0}, static_cast<float>(0.6 * std::exp(kFieldLog[0])), 1, &lists[1]);
    const MovingObject object{.id = kObject, .size_m = {2, 2, 2}, .keys = {{}}};
    model->set_gaussians(lists, {&object, 1});
  }
  for (float& colour : model->background) colour = static_cast<float>(0.4 * std::exp(kFieldLog[b]));
  const std::vector<ModelTensor> tensors = model->tensors();
  const auto appearance = std::ranges::find(tensors, "appearance", &ModelTensor::name);
  EXPECT_NE(appearance, tensors.end());
  float* const knots = model->parameters.data() + appearance->offset;
  for (int f = first; f <= last; ++f)
    for (int c = 0; c < 3; ++c)
      knots[3 * (f - first) + c] =
          static_cast<float>((recorded_log(0.1 * f) - kFieldLog[b]) / kLogGainScale);
  block->scene.rig.push_back({.name = "CAM", .camera = small_camera(), .recorded = small_camera()});
  for (int f = first; f <= last; ++f)
    block->scene.add_frame({f, f * 100'000'000ll, Rigid3d(Eigen::Translation3d(f, 0, 0))});
  block->bytes = model->parameters.size() * sizeof(float);
  block->model = std::move(model);
  return block;
}

class DividedFieldTest : public testing::Test {
 protected:
  explicit DividedFieldTest(bool walls = false, bool with_object = false) : walls_(walls) {
    std::vector<Eigen::Vector3d> positions;
    std::vector<std::int64_t> t_ns;
    for (int f = 0; f < kFrames; ++f) {
      positions.emplace_back(f, 0, 0);
      t_ns.push_back(f * 100'000'000ll);
    }
    const std::size_t last[] = {19, 39};
    // exp(log gain) times the field: the same brightness, where they sum to 0.
    const double off = (kFieldLog[0] + kFieldLog[1]) / 2;
    SeamExposure seams{{"CAM"}, {}};
    for (const double field : kFieldLog)
      seams.log_gains.push_back({{off - field, off - field, off - field}});
    field_ = std::make_unique<DividedField>(
        std::make_unique<SplatModel>(),
        DividedDrive{{"CAM"}, t_ns, BlockWay(positions, last), seams},
        [this, with_object](int b) {
          const std::lock_guard lock(mutex_);
          ++loads_[b];
          if (b == missing_) throw std::runtime_error("block 001 is not trained");
          return make_block(b, walls_, with_object);
        },
        1'000'000);
  }

  RenderedImage at(double x, const Exposure& exposure) const {
    return field_->render(*backend_, table_, Rigid3d(Eigen::Translation3d(x, 0.2, 0)), exposure);
  }
  RenderedImage of_block(int b, double x) const {
    return make_block(b, walls_)->model->render(*backend_, table_,
                                                Rigid3d(Eigen::Translation3d(x, 0.2, 0)), {});
  }
  int loads(int block) {
    const std::lock_guard lock(mutex_);
    return loads_[block];
  }

  const bool walls_;
  std::mutex mutex_;
  std::map<int, int> loads_;
  int missing_ = -1;
  std::unique_ptr<DividedField> field_;
  const std::unique_ptr<kernels::Backend> backend_ = known_splats::fast_backend();
  const RayTable table_ = make_ray_table(small_camera());
};

class DividedFieldWithWalls : public DividedFieldTest {
 protected:
  DividedFieldWithWalls() : DividedFieldTest(/*walls=*/true) {}
};

class DividedFieldWithObject : public DividedFieldTest {
 protected:
  DividedFieldWithObject() : DividedFieldTest(/*walls=*/false, /*with_object=*/true) {}
};

TEST_F(DividedFieldWithObject, IsDrawnAndTracedInABlockThatDidNotTrainOnIt) {
  const auto with_object = [&](double x) {
    ShutterPoses poses{Rigid3d(Eigen::Translation3d(x, 0.2, 0))};
    ShutterPoses::Actor actor{.body = kObject};
    actor.actor_from_camera = {plain(Rigid3d(Eigen::Translation3d(0, 0, -5)))};
    poses.set_actors({actor});
    return field_->render(*backend_, table_, poses, {});
  };
  const RenderedImage own = with_object(5), moved = with_object(30), none = at(30, {});
  const std::size_t middle = 6 * 16 + 8;
  EXPECT_GT(own.opacity[middle], 0.9f);
  EXPECT_GT(std::abs(own.rgb[3 * middle] - none.rgb[3 * middle]), 0.05f);
  for (std::size_t i = 0; i < own.rgb.size(); ++i)
    EXPECT_NEAR(moved.rgb[i], own.rgb[i], 1e-5) << "as bright in both";
  EXPECT_NEAR(moved.depth[middle], own.depth[middle], 1e-5f);

  // Rays along z from both blocks, with the object 5 m ahead of the second one.
  MovingObject object{.id = kObject, .size_m = {2, 2, 2}, .keys = {{}}};
  object.keys[0].world_from_box = Rigid3d(Eigen::Translation3d(30, 0, 5));
  object.keys[0].velocity_in_world_m_per_s.setZero();
  const std::vector<float> origin = {5, 30, 0, 0, 0, 0}, direction = {0, 0, 0, 0, 1, 1};
  const std::vector<std::int64_t> t_ns(2, 0);
  const RenderedRays rays = field_->trace(*backend_, {2, origin, direction, t_ns}, {object});
  EXPECT_EQ(rays.opacity[0], 0);
  EXPECT_GT(rays.opacity[1], 0.5f);
}

TEST_F(DividedFieldWithObject, ExportsTheObjectAsBrightAsTheWorld) {
  const MovingObject object{.id = kObject, .type = "CAR", .size_m = {2, 2, 2}, .keys = {{}}};
  const ActorBody body = field_->as_gaussians()->body(object);
  ASSERT_EQ(body.n, 1u);
  EXPECT_EQ(body.type, "CAR");
  EXPECT_NEAR(body.numbers[gaussian_slot(0, kColourRow)],
              0.6 * std::exp((kFieldLog[0] + kFieldLog[1]) / 2), 1e-6);
  EXPECT_EQ(body.numbers[gaussian_slot(0, kOpacityRow)], 6);
  ExportOptions options;
  options.actor = &object;
  const std::vector<ExportFormat> formats = field_->export_formats();
  ASSERT_EQ(formats.at(0).name, "splat-ply");
  EXPECT_EQ(parse_actor_body(formats[0].encode(options), "car.ply").n, 1u);
  for (const ExportFormat& format : formats) EXPECT_GT(format.encode(options).size(), 20u);
  EXPECT_TRUE(field_->has_body(kObject));
  EXPECT_FALSE(field_->has_body(kObject + 1));
}

TEST_F(DividedFieldTest, BlocksAreEquallyBrightWithoutExposure) {
  const double expected = 0.4 * std::exp((kFieldLog[0] + kFieldLog[1]) / 2);
  for (const double x : {0.0, 10.0, 18.0, 19.5, 21.0, 30.0})
    EXPECT_NEAR(at(x, {}).rgb[100], expected, 1e-5) << x;
}

TEST_F(DividedFieldTest, AnExposureIsThatOfItsTimeInEveryBlock) {
  for (const double x : {5.0, 19.0, 35.0})
    for (const double t_s : {0.0, 1.0, 1.95, 2.2, 3.9})
      EXPECT_NEAR(at(x, {0, static_cast<float>(t_s)}).rgb[100], 0.4 * std::exp(recorded_log(t_s)),
                  2e-5)
          << "at " << x << " m, exposed at " << t_s << " s";
}

TEST_F(DividedFieldTest, LoadsWhatIsNeededAndTheNextOneAhead) {
  at(3, {});
  EXPECT_EQ(loads(0), 1);
  EXPECT_EQ(loads(1), 0) << "a camera that stands needs one block";
  at(4, {});
  while (field_->cache().size() < 2) std::this_thread::yield();
  at(19, {});
  at(30, {});
  EXPECT_EQ(loads(0), 1);
  EXPECT_EQ(loads(1), 1);
}

TEST_F(DividedFieldTest, AMissingBlockFailsWhereItIsNeeded) {
  missing_ = 1;
  EXPECT_NO_THROW(at(3, {}));
  EXPECT_NO_THROW(at(4, {}));
  EXPECT_THROW(at(30, {}), std::runtime_error);
  missing_ = -1;
  EXPECT_NO_THROW(at(30, {}));
}

TEST_F(DividedFieldWithWalls, BlendsByWeightAndOpacity) {
  const double x = 19.5 - kSeam_m / 4, weight = 0.15625;  // u = 1/4
  const RenderedImage a = of_block(0, x), b = of_block(1, x), both = at(x, {});
  const std::size_t centre = 6 * 16 + 8;
  ASSERT_GT(a.opacity[centre], 0.9);
  ASSERT_LT(a.depth[centre] + 1, b.depth[centre]);
  for (std::size_t i = 0; i < a.depth.size(); ++i) {
    const double of_a = (1 - weight) * a.opacity[i], of_b = weight * b.opacity[i];
    EXPECT_NEAR(both.opacity[i], of_a + of_b, 1e-5);
    if (std::isfinite(a.depth[i] + b.depth[i]) && of_a > 0 && of_b > 0) {
      EXPECT_NEAR(both.depth[i], (of_a * a.depth[i] + of_b * b.depth[i]) / (of_a + of_b), 1e-3);
    }
    const double off = (kFieldLog[0] + kFieldLog[1]) / 2;
    EXPECT_NEAR(both.rgb[3 * i],
                (1 - weight) * std::exp(off - kFieldLog[0]) * a.rgb[3 * i] +
                    weight * std::exp(off - kFieldLog[1]) * b.rgb[3 * i],
                1e-5);
    EXPECT_EQ(both.valid[i], a.valid[i]);
  }
}

TEST_F(DividedFieldWithWalls, ABlockAloneHasItsBits) {
  const auto block = make_block(1, true);
  const RenderedImage whole = at(30, {0, 3.0f}),
                      alone = block->model->render(
                          *backend_, table_, Rigid3d(Eigen::Translation3d(30, 0.2, 0)),
                          {0, static_cast<float>(1e-9 * (3'000'000'000 - 1'500'000'000))});
  EXPECT_EQ(whole.rgb, alone.rgb);
  EXPECT_EQ(whole.depth, alone.depth);
}

TEST_F(DividedFieldWithWalls, TracesEachRayInItsBlock) {
  const std::vector<float> origin{4, 30, 10, 0.2f, 0.2f, 0.2f, 0, 0, 0},
      direction{0, 0, 0, 0, 0, 0, 1, 1, 1};
  const RenderedRays rays = field_->trace(*backend_, {3, origin, direction});
  EXPECT_NEAR(rays.depth[0], rays.depth[2], 0.01);
  EXPECT_NEAR(rays.depth[1] - rays.depth[0], 2, 0.05);
}

TEST_F(DividedFieldWithWalls, MergesTheGaussiansOfTheCores) {
  const WorldGaussians merged = field_->as_gaussians()->world();
  ASSERT_EQ(merged.gaussians.n, static_cast<std::size_t>(kFrames / 2)) << "each once";
  const double off = (kFieldLog[0] + kFieldLog[1]) / 2;
  for (const float colour : merged.background)
    EXPECT_NEAR(colour, 0.4 * std::exp(off), 1e-6) << "as bright as the blocks' own";
  for (std::size_t i = 0; i < merged.gaussians.n; ++i) {
    const auto number = [&](int row) { return merged.gaussians.numbers[gaussian_slot(i, row)]; };
    const int b = number(kPositionRow) > 19.5;
    EXPECT_EQ(number(kPositionRow + 2), b == 0 ? 8 : 10);
    EXPECT_NEAR(number(kColourRow), 0.3 * std::exp(off - kFieldLog[b]), 1e-6);
    EXPECT_NEAR(number(kHarmonicsRow), 0.1 * std::exp(off - kFieldLog[b]), 1e-6);
    EXPECT_EQ(number(kOpacityRow), 6);
  }
}

}  // namespace
}  // namespace redrive

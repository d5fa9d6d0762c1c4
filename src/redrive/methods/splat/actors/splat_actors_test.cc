// SPDX-License-Identifier: Apache-2.0
// Steps of method splat with an object that moves.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <memory>

#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/methods/splat/actors/articulated.h"
#include "redrive/methods/splat/known_splats_testing.h"

namespace redrive::known_splats {
namespace {

constexpr std::int64_t kId = 7;

/// An object that crosses the known scene, turning, in 1.2 s.
MovingObject crossing(const char* type = "CAR") {
  MovingObject object{.id = kId, .type = type, .size_m = {1.6, 1, 1}, .keys = {}};
  for (int i = -1; i < 14; ++i)
    object.keys.push_back(
        {100'000'000ll * i, pose({-1.2 + 0.2 * i, 0.2, 3.2}, {0, 0.1 * i, 0}), {2, 0, 0}});
  return object;
}

/// Gaussians in the object's box, redder than the world.
GaussianList of_object(int n) {
  GaussianList list = known_gaussians(n);
  for (std::size_t i = 0; i < list.size(); ++i) {
    float* const rows = &list.rows[i * kGaussianRows];
    rows[kPositionRow] *= 0.3f;
    rows[kPositionRow + 1] *= 0.3f;
    rows[kPositionRow + 2] = 0.3f * (rows[kPositionRow + 2] - 4.5f);
    for (int k = 0; k < 3; ++k) rows[kLogScaleRow + k] -= 0.7f;
    rows[kColourRow] = 0.9f;
    rows[kDistanceRow] = 3;
  }
  return list;
}

/// Moves and turns the parts of the one object, each in its own way.
void articulate(SplatModel* model) {
  const std::size_t keys = crossing().keys.size(), parts = model->actor_ids.size();
  float* motion = model->parameters.data() + (model->size() - kMotionSize * keys * parts);
  for (std::size_t part = 0; part < parts; ++part)
    for (std::size_t key = 0; key < keys; ++key, motion += kMotionSize) {
      const float phase = 0.9f * static_cast<float>(key) + 1.7f * static_cast<float>(part);
      motion[0] = 0.06f * std::sin(phase);
      motion[4] = 0.09f * std::cos(phase);
    }
  model->freeze();
}

struct TrafficScene : KnownScene {
  explicit TrafficScene(const char* type = "CAR") {
    scene.actors = {crossing(type)};
    const std::vector<GaussianList> lists{known_gaussians(80), of_object(40)};
    truth.set_gaussians(lists, scene.actors);
    if (truth.actor_ids.size() > 1) articulate(&truth);
    truth.correct_actors(&scene.actors);
    const auto backend = fast_backend();
    held_out.clear();
    for (std::size_t v = 0; v < scene.views.size(); ++v) {
      const Image8 image = drawn(*backend, truth, v);
      if (scene.views[v].held_out)
        held_out.push_back(image);
      else
        images[v].rgb = image.rgb;
    }
  }
};

void begin(Training* training, const TrafficScene& traffic, float off) {
  const std::vector<GaussianList> lists{disturbed(known_gaussians(80), off),
                                        disturbed(of_object(40), off)};
  training->begin(lists[0]);
  training->model.set_gaussians(lists, traffic.scene.actors);
  training->model.max_gaussians = 120;
  training->model.replaced = 0;  // the known Gaussians stay
  training->adam = training->model.zero_moments();
  training->model.opacity_weight = 0;
}

TEST(SplatActors, FindsAKnownObjectAgainThatMoves) {
  const TrafficScene traffic;
  const auto backend = fast_backend();
  Training training;
  training.steps = 300;
  begin(&training, traffic, 0.04f);
  const double before = traffic.psnr_db(*backend, training.model);
  training.run(*backend, traffic.data());
  EXPECT_LT(before, 26);
  EXPECT_GT(traffic.psnr_db(*backend, training.model), 38) << "from " << before;
  const GaussianLayout layout = training.model.layout();
  EXPECT_EQ(layout.world, 80u);
  EXPECT_EQ(layout.actor_ends, std::vector<std::int64_t>{5 + 3});
}

// The annotated boxes are off by up to 8 cm and 3 degrees, from box to box by less.
TEST(SplatActors, CorrectsATrack) {
  TrafficScene traffic;
  std::vector<MovingObject> exact = traffic.scene.actors;
  MovingObject& object = traffic.scene.actors[0];
  for (std::size_t i = 0; i < object.keys.size(); ++i) {
    Rigid3d off = Rigid3d::Identity();
    off.translation() = 0.08 * Eigen::Vector3d(std::sin(0.7 * i), std::cos(0.5 * i), 0);
    off.linear() = so3_exp(0.05 * Eigen::Vector3d(0, std::sin(0.6 * i), 0));
    object.keys[i].world_from_box = object.keys[i].world_from_box * off;
  }
  const auto backend = fast_backend();
  const auto error_m = [&](const std::vector<MovingObject>& objects) {
    double sum = 0;  // errors of steps between keys: the whole track may be off by the same
    for (std::size_t i = 1; i < exact[0].keys.size(); ++i) {
      const auto step = [&](const MovingObject& of) -> Eigen::Vector3d {
        return of.keys[i].world_from_box.translation() -
               of.keys[i - 1].world_from_box.translation();
      };
      sum += (step(objects[0]) - step(exact[0])).norm();
    }
    return sum / double(exact[0].keys.size() - 1);
  };
  const std::vector<MovingObject> given = traffic.scene.actors;
  double psnr_db[2];
  for (const bool corrects : {false, true}) {
    Training training;
    training.steps = 300;
    begin(&training, traffic, 0.02f);
    training.model.motion_rate = corrects ? 0.2f : 0;
    training.run(*backend, traffic.data());
    training.model.correct_actors(&traffic.scene.actors);
    training.model.correct_actors(&traffic.scene.actors);  // a second time changes nothing
    psnr_db[corrects] = traffic.psnr_db(*backend, training.model);
    traffic.scene.actors[0].apply_corrections();
    if (corrects)
      EXPECT_LT(error_m(traffic.scene.actors), 0.6 * error_m(given));
    else
      EXPECT_EQ(error_m(traffic.scene.actors), error_m(given));
    traffic.scene.actors = given;
  }
  EXPECT_GT(psnr_db[1], psnr_db[0] + 0.5);
}

TEST(SplatActors, FindsTheMotionsOfAPersonsParts) {
  const auto backend = fast_backend();
  TrafficScene traffic("pedestrian");
  ASSERT_EQ(traffic.truth.actor_ids.size(), kArticulatedParts);
  const double of_truth = traffic.psnr_db(*backend, traffic.truth);
  double psnr_db[2];
  for (const bool moves : {false, true}) {
    traffic.scene.actors = {crossing("pedestrian")};
    Training training;
    training.steps = 400;
    begin(&training, traffic, 0.02f);
    training.model.motion_rate = moves ? 0.2f : 0;
    training.run(*backend, traffic.data());
    training.model.correct_actors(&traffic.scene.actors);
    psnr_db[moves] = traffic.psnr_db(*backend, training.model);
  }
  EXPECT_GT(of_truth, 45);
  EXPECT_GT(psnr_db[1], psnr_db[0] + 1) << psnr_db[0];
}

TEST(SplatActors, AnObjectOfPartsHasOneExtentInImages) {
  const auto backend = fast_backend();
  TrafficScene traffic("pedestrian");
  RenderedImage image;
  image.labelled = true;
  const View& view = traffic.scene.views[5];
  const RayTable rays = make_ray_table(traffic.scene.rig[view.camera].camera);
  traffic.truth.render_to(*backend, rays, traffic.scene.shutter_poses(view),
                          traffic.scene.exposure(view), &image);
  ASSERT_EQ(image.seen.size(), 1u);
  EXPECT_EQ(image.seen[0].number, 1);
  EXPECT_GT(image.seen[0].whole, 50u);
  EXPECT_EQ(std::ranges::count(image.ids, 1), image.seen[0].visible);
}

// An object infinitely far away: nothing of it is seen, and its track alone has no gradient.
TEST(SplatActors, ATrackWithoutAFiniteGradientCostsNothingElse) {
  const TrafficScene traffic;
  const auto backend = fast_backend();
  Training training;
  begin(&training, traffic, 0.02f);
  SplatModel& model = training.model;
  const std::size_t motions = traffic.scene.actors[0].keys.size() * kMotionSize;
  for (std::size_t i = model.size() - motions; i < model.size(); i += kMotionSize)
    model.parameters[i] = std::numeric_limits<float>::infinity();  // along x
  training.step = training.steps - 1;
  StepRequest request = training.request();
  const StepUpdate update{1e-3, training.step + 1, model.parameters, &training.adam};
  request.update = &update;
  const float before = model.parameters[0];
  const StepOutput out = training.gradients(*backend, traffic.data(), request);
  ASSERT_TRUE(std::isfinite(training.loss()));
  EXPECT_NE(model.parameters[0], before);
  EXPECT_EQ(out.left_out_tracks, 1);
  EXPECT_TRUE(std::ranges::all_of(model.sentinels(training.buffers.gradients),
                                  [](float x) { return std::isfinite(x); }));
}

TEST(SplatActors, RefusesOtherObjectsThanInTraining) {
  const TrafficScene traffic;
  std::vector<MovingObject> objects = traffic.scene.actors;
  const auto message = [&] {
    try {
      traffic.truth.check_actors("recording", "moving.json", objects);
    } catch (const InputError& error) {
      return std::string(error.what());
    }
    return std::string();
  };
  EXPECT_EQ(message(), "");
  objects[0].keys.pop_back();
  EXPECT_NE(message().find("boxes of object 7"), std::string::npos);
  objects.clear();
  EXPECT_NE(message().find("boxes of object 7"), std::string::npos);
  objects = {crossing(), crossing()};
  objects[1].id = 8;
  EXPECT_NE(message().find("boxes of object 8"), std::string::npos);
}

TEST(SplatActors, AnImageWithoutTheObjectShowsTheWorldAlone) {
  TrafficScene traffic;
  const auto backend = fast_backend();
  SplatModel world;
  set_gaussians(known_gaussians(80), &world);
  const Image8 with = traffic.drawn(*backend, traffic.truth, 5),
               expected = traffic.drawn(*backend, world, 5);
  EXPECT_NE(with.rgb, expected.rgb);
  EXPECT_EQ(traffic.truth.world().gaussians.n, 80u);
  traffic.scene.actors.clear();
  EXPECT_EQ(traffic.drawn(*backend, traffic.truth, 5).rgb, expected.rgb);
}

// A body that was exported and is shown on the same track gives the same image, up to the rounding
// of colours; the model stays as it is.
TEST(SplatActors, AnExportedBodyIsTheObject) {
  TrafficScene traffic;
  const auto backend = fast_backend();
  const std::vector<float> before(traffic.truth.parameters.data(),
                                  traffic.truth.parameters.data() + traffic.truth.size());
  const Image8 expected = traffic.drawn(*backend, traffic.truth, 5);
  const std::vector<ExportFormat> formats = traffic.truth.export_formats();
  const std::string ply = formats[0].encode({.actor = &traffic.scene.actors[0]});
  auto body = std::make_shared<ActorBody>(parse_actor_body(ply, "car.ply"));
  EXPECT_EQ(body->n, 40u);
  EXPECT_EQ(body->type, "CAR");
  EXPECT_LT((body->size_m - traffic.scene.actors[0].size_m).norm(), 1e-9);
  traffic.scene.actors[0].id = 99;  // that no Gaussians have
  EXPECT_NE(traffic.drawn(*backend, traffic.truth, 5).rgb, expected.rgb);
  traffic.scene.actors[0].imported = body;
  const Image8 imported = traffic.drawn(*backend, traffic.truth, 5);
  for (std::size_t i = 0; i < expected.rgb.size(); ++i)
    ASSERT_NEAR(imported.rgb[i], expected.rgb[i], 1) << i;
  traffic.scene.actors[0].gain = {0, 1, 1};
  EXPECT_NE(traffic.drawn(*backend, traffic.truth, 5).rgb, imported.rgb);
  EXPECT_EQ(
      std::memcmp(traffic.truth.parameters.data(), before.data(), before.size() * sizeof(float)),
      0);
  EXPECT_THROW(formats[1].encode({.actor = &traffic.scene.actors[0]}), UsageError)
      << "the model has no Gaussians of this id";
}

// Its parts stand as they do on average: here where they are, since each key moves as any other.
TEST(SplatActors, TheBodyOfAPersonHasItsPartsWhereTheyAre) {
  const auto backend = fast_backend();
  TrafficScene traffic("pedestrian");
  SplatModel& model = traffic.truth;
  float* motion = model.parameters.data() +
                  (model.size() - kMotionSize * crossing().keys.size() * kArticulatedParts);
  for (std::size_t part = 0; part < kArticulatedParts; ++part)
    for (std::size_t key = 0; key < crossing().keys.size(); ++key, motion += kMotionSize)
      for (std::size_t k = 0; k < kMotionSize; ++k)
        motion[k] = 0.05f * std::sin(static_cast<float>(part + 3 * k));
  model.freeze();
  model.correct_actors(&traffic.scene.actors);
  MovingObject& person = traffic.scene.actors[0];
  const Image8 expected = traffic.drawn(*backend, model, 5);
  person.imported = std::make_shared<ActorBody>(model.body(person));
  const Image8 imported = traffic.drawn(*backend, model, 5);
  int differences = 0;
  for (std::size_t i = 0; i < expected.rgb.size(); ++i)
    differences += std::abs(imported.rgb[i] - expected.rgb[i]) > 2;
  EXPECT_LT(differences, static_cast<int>(expected.rgb.size()) / 100);
  person.imported = nullptr;
  person.gain = {0.999f, 1, 1};  // then the Gaussians are copied
  const Image8 copied = traffic.drawn(*backend, model, 5);
  for (std::size_t i = 0; i < expected.rgb.size(); ++i)
    ASSERT_NEAR(copied.rgb[i], expected.rgb[i], 1) << i;
}

/// A plate of flat, opaque Gaussians across x, 2 m wide and high.
GaussianList plate() {
  GaussianList list;
  for (int j = -10; j <= 10; ++j)
    for (int k = -10; k <= 10; ++k) {
      std::array<float, kGaussianRows> rows{};
      rows[kPositionRow + 1] = 0.1f * static_cast<float>(j);
      rows[kPositionRow + 2] = 0.1f * static_cast<float>(k);
      for (int d = 0; d < 3; ++d) rows[kLogScaleRow + d] = std::log(d == 0 ? 0.001f : 0.08f);
      rows[kQuaternionRow] = 1;
      rows[kOpacityRow] = 5;
      rows[kDistanceRow] = 10;
      list.rows.insert(list.rows.end(), rows.begin(), rows.end());
    }
  return list;
}

/// A plate 20 m ahead in the world, and one that comes closer, from 15 m at 20 m/s.
struct PlateScene {
  MovingObject object{.id = kId, .type = "PLATE", .size_m = {0.2, 2, 2}, .keys = {}};
  SplatModel model;
  std::vector<float> origin, direction;  ///< [3, n]
  std::vector<std::int64_t> t_ns;

  PlateScene() {
    for (int i = 0; i <= 5; ++i) {
      Rigid3d pose = Rigid3d::Identity();
      pose.translation().x() = 15 - 2 * i;
      object.keys.push_back({100'000'000ll * i, pose, {-20, 0, 0}});
    }
    GaussianList world = plate();
    for (std::size_t i = 0; i < world.size(); ++i)
      world.rows[i * kGaussianRows + kPositionRow] = 20;
    const std::vector<GaussianList> lists{world, plate()};
    model.set_gaussians(lists, {&object, 1});
    // Rays straight ahead at eleven times, then one past everything.
    const int n = 12;
    origin.assign(3 * n, 0);
    direction.assign(3 * n, 0);
    for (int i = 0; i < n; ++i) {
      direction[(i < 11 ? 0 : 1) * n + i] = 1;
      origin[2 * n + i] = 0.03f;
      t_ns.push_back(std::min(i, 10) * 47'000'000ll);
    }
  }
  kernels::Rays rays() const { return {static_cast<int>(t_ns.size()), origin, direction, t_ns}; }
  RenderedRays traced(const std::vector<MovingObject>& actors) const {
    const auto backend = fast_backend();
    return model.trace(*backend, rays(), actors);
  }
};

TEST(TraceActors, RaysMeetAnObjectWhereItIsAtTheirOwnTime) {
  const PlateScene scene;
  const RenderedRays traced = scene.traced({scene.object});
  for (std::size_t i = 0; i < 11; ++i) {
    EXPECT_NEAR(traced.depth[i], 15 - 20 * 1e-9 * double(scene.t_ns[i]), 0.015) << i;
    EXPECT_GT(traced.opacity[i], 0.9);
  }
  EXPECT_LT(traced.opacity[11], 1e-3);
  for (std::size_t i = 0; i < 11; ++i) EXPECT_NEAR(scene.traced({}).depth[i], 20, 0.02);
}

TEST(TraceActors, TheNearerSurfaceCountsAndHiddenObjectsDoNot) {
  const PlateScene scene;
  MovingObject behind = scene.object, hidden = scene.object, copy = scene.object;
  for (MovingObject::Key& key : behind.keys) key.world_from_box.translation().x() += 30;
  hidden.hidden_ns = {{0, 250'000'000}};
  copy.id = 5;
  copy.body = kId;
  for (MovingObject::Key& key : copy.keys) key.world_from_box.translation().x() -= 3;
  const RenderedRays far = scene.traced({behind}), later = scene.traced({hidden}),
                     both = scene.traced({copy, scene.object}),
                     other_order = scene.traced({scene.object, copy});
  for (std::size_t i = 0; i < 11; ++i) {
    const double own = 15 - 20 * 1e-9 * double(scene.t_ns[i]);
    EXPECT_NEAR(far.depth[i], 20, 0.02) << "the world hides it";
    EXPECT_NEAR(later.depth[i], scene.t_ns[i] <= 250'000'000 ? 20 : own, 0.02);
    EXPECT_NEAR(both.depth[i], own - 3, 0.015);
    EXPECT_EQ(other_order.depth[i], both.depth[i]);
  }
}

TEST(SplatActors, GaussiansStayWithTheirObjectAndInItsBox) {
  const TrafficScene traffic;
  const auto backend = fast_backend();
  Training training;
  training.steps = 100;
  begin(&training, traffic, 0.04f);
  training.model.max_gaussians = 200;
  training.model.densify_every = 20;
  // One starts outside of the box.
  const std::size_t strayed = training.model.layout().first_block(0) * kGaussianBlock;
  training.model.parameters[gaussian_slot(strayed, kPositionRow)] = 1.5f;
  training.run(*backend, traffic.data());
  const GaussianLayout layout = training.model.layout();
  EXPECT_GT(layout.world, 80u);
  std::size_t of_actor = 0;
  for (std::size_t i = layout.first_block(0) * kGaussianBlock; i < layout.blocks() * kGaussianBlock;
       ++i) {
    if (training.model.parameters[gaussian_slot(i, kOpacityRow)] < -10) continue;  // unused
    ++of_actor;
    EXPECT_LT(std::fabs(training.model.parameters[gaussian_slot(i, kPositionRow)]), 1.1f);
  }
  EXPECT_GT(of_actor, 40u);
  EXPECT_EQ(training.adam.size(), training.model.size());
}

TEST(SplatActors, ColoursOfObjectsStayBetween0And1) {
  const TrafficScene traffic;
  Training training;
  begin(&training, traffic, 0);
  SplatModel& model = training.model;
  const std::size_t of_world = 3, of_object = 5 * kGaussianBlock + 3;  // behind 80 of the world
  for (const std::size_t i : {of_world, of_object}) {
    model.parameters[gaussian_slot(i, kColourRow)] = 1.5f;
    model.parameters[gaussian_slot(i, kColourRow + 1)] = -0.5f;
    model.parameters[gaussian_slot(i, kColourRow + 2)] = 0.25f;
    model.parameters[gaussian_slot(i, kHarmonicsRow)] = -0.5f;
  }
  Buffer<float> gradients(model.gradients_size(/*with_update=*/false));
  for (const std::size_t i : {of_world, of_object})
    gradients[gaussian_slot(i, kOpacityRow)] = 1e-3f;  // both are drawn
  model.update(*fast_backend(), 1e-3, 1, gradients, &training.adam);
  const auto at = [&](std::size_t i, int row) { return model.parameters[gaussian_slot(i, row)]; };
  EXPECT_EQ(at(of_object, kColourRow), 1);
  EXPECT_EQ(at(of_object, kColourRow + 1), 0);
  EXPECT_EQ(at(of_object, kColourRow + 2), 0.25f);
  EXPECT_EQ(at(of_object, kHarmonicsRow), -0.5f);
  EXPECT_EQ(at(of_world, kColourRow), 1.5f);
  EXPECT_EQ(at(of_world, kColourRow + 1), -0.5f);
}

TEST(SplatActors, ThreadsChangeNoBit) {
  const TrafficScene traffic;
  Training one, four;
  for (Training* training : {&one, &four}) {
    training->steps = 40;
    begin(training, traffic, 0.04f);
    training->model.max_gaussians = 150;
    training->model.densify_every = 10;
    training->run(*fast_backend(training == &one ? 1 : 4), traffic.data());
  }
  ASSERT_EQ(one.model.size(), four.model.size());
  EXPECT_EQ(std::memcmp(one.model.parameters.data(), four.model.parameters.data(),
                        one.model.parameters.size() * sizeof(float)),
            0);
}

}  // namespace
}  // namespace redrive::known_splats

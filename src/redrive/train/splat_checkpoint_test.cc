// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/files/checkpoint_testing.h"

#include <array>
#include <limits>

#include "redrive/methods/splat/actors/articulated.h"
#include "redrive/methods/splat/splat_model.h"

namespace redrive {
namespace {

using ::testing::HasSubstr;

/// A model with two blocks of Gaussians, the second of which has one, and maybe two actors.
TrainState example_splat_state(bool with_actors = false) {
  auto model = std::make_unique<SplatModel>();
  model->gaussians = 17;
  model->first_gaussians = 5;
  if (with_actors) {
    model->actor_ids = {-4, 9};
    model->actor_ends = {3, 5};
    model->actor_keys = {2, 6};
  }
  model->max_gaussians = 2000;
  model->gains.appearance = {1, 3};
  model->gains.shading = {1, 4, 2};
  model->parameters = Buffer<float>(model->size());
  for (std::size_t i = 0; i < model->size(); ++i) model->parameters[i] = random_unit(3, i) - 0.5f;
  TrainState state;
  state.adam = model->zero_moments();
  state.mean = {Buffer<float>(model->size()), 3};
  for (std::size_t i = 0; i < model->size(); ++i) state.mean.values[i] = random_unit(6, i);
  state.model = std::move(model);
  return midway(std::move(state));
}

TEST(SplatCheckpoint, RoundTripIsBitExact) {
  const TrainState state = example_splat_state(/*with_actors=*/true),
                   back = parse_checkpoint(checkpoint_bytes(state), "c");
  ASSERT_STREQ(back.model->method(), "splat");
  expect_equal(back.model->parameters, state.model->parameters);
  expect_equal(back.adam.first_moment, state.adam.first_moment);
  expect_equal(back.adam.second_moment, state.adam.second_moment);
  EXPECT_TRUE(std::ranges::equal(back.adam.packed.span(), state.adam.packed.span()));
  expect_equal(back.adam.errors, state.adam.errors);
  expect_equal(back.mean.values, state.mean.values);
  EXPECT_EQ(back.mean.steps, 3);
  const auto& model = dynamic_cast<const SplatModel&>(*back.model);
  EXPECT_EQ(model.gaussians, 17);
  EXPECT_EQ(model.first_gaussians, 5);
  EXPECT_EQ(model.actor_ids, (std::vector<std::int64_t>{-4, 9}));
  EXPECT_EQ(model.actor_ends, (std::vector<std::int64_t>{3, 5}));
  EXPECT_EQ(model.max_gaussians, 2000);
  EXPECT_EQ(model.gains.appearance.knots, 3);
  EXPECT_EQ(model.gains.shading.columns, 4);
  EXPECT_EQ(checkpoint_bytes(back), checkpoint_bytes(state));
}

TEST(SplatCheckpoint, KeepsTheGainsOfSeveralLidars) {
  TrainState state = example_splat_state();
  state.lidar_gains = {
      {1, {{-0.1f, 0.7000001f}, {0.02f, 1.2f}}}, {0.1f, {}}, {3.0000002f, {{0, 1}}}};
  for (const std::size_t cell : {3, 4, 5, 129599}) state.lidar_gains[1].blind.insert(cell);
  const std::string bytes = checkpoint_bytes(state);
  EXPECT_EQ(parse_checkpoint(bytes, "c").lidar_gains, state.lidar_gains);
  for (const char* broken :
       {R"({})", R"([1])", "[1,", R"([{"gain":0,"beams":[],"blind":[]}])",
        R"([{"gain":"x","beams":[],"blind":[]}])", R"([{"gain":1e9,"beams":[],"blind":[]}])",
        R"([{"gain":1}])", R"([{"gain":1,"beams":[[0]],"blind":[]}])",
        R"([{"gain":1,"beams":[[9,1]],"blind":[]}])", R"([{"gain":1,"beams":[[0,-1]],"blind":[]}])",
        R"([{"gain":1,"beams":[],"blind":[[129599,2]]}])"}) {
    CheckpointParts parts(bytes);
    parts.header["__metadata__"]["lidar_gains"] = broken;
    EXPECT_THAT(checkpoint_error(parts.bytes()), HasSubstr("__metadata__.lidar_gains")) << broken;
  }
}

TEST(SplatCheckpoint, KeepsThePartsOfArticulatedActors) {
  TrainState state = example_splat_state();
  auto& model = dynamic_cast<SplatModel&>(*state.model);
  for (std::size_t part = 0; part < kArticulatedParts; ++part) {
    model.actor_ids.push_back(9);
    model.actor_ends.push_back(3 + static_cast<std::int64_t>(part));
    model.actor_keys.push_back(2 + 2 * static_cast<std::int64_t>(part));
  }
  model.parameters = Buffer<float>(model.size());
  state.adam = model.zero_moments();
  state.mean = {};
  const std::string good = checkpoint_bytes(state);
  const TrainState back = parse_checkpoint(good, "c");
  EXPECT_EQ(dynamic_cast<const SplatModel&>(*back.model).actor_ids, model.actor_ids);
  model.actor_keys[3] += 1;  // one part has three keys, the next one
  EXPECT_THAT(checkpoint_error(checkpoint_bytes(state)), HasSubstr("__metadata__.actor_keys"));
}

TEST(SplatCheckpoint, RejectsDamageToActorsByName) {
  const std::string good = checkpoint_bytes(example_splat_state(/*with_actors=*/true));
  ASSERT_EQ(checkpoint_error(good), "");
  for (const auto& [key, value, field] : std::vector<std::array<std::string, 3>>{
           {"actor_ends", "2,5", "__metadata__.actor_ends"},  // within the world's blocks
           {"actor_ends", "5,3", "__metadata__.actor_ends"},
           {"actor_ends", "5", "__metadata__.actor_ends"},
           {"actor_ends", "3,4000000000", "__metadata__.actor_ends"},
           {"actor_ends", "3,x", "__metadata__.actor_ends"},
           {"actor_ends", "3,6", "adam.packed.shape"},
           {"actor_ids", "-4", "__metadata__.actor_keys"},
           {"actor_keys", "2", "__metadata__.actor_keys"},
           {"actor_keys", "2,7", "adam.first_moment.shape"},
           {"actor_ids", "9,-4", "__metadata__.actor_ids"},
           {"actor_ids", "9,9", "__metadata__.actor_ids"},  // one part, or all of them
           {"gaussians", "49", "__metadata__.actor_ends"}}) {
    CheckpointParts parts(good);
    parts.header["__metadata__"][key] = value;
    EXPECT_THAT(checkpoint_error(parts.bytes()), HasSubstr(field)) << key << " = " << value;
  }
}

TEST(SplatCheckpoint, RejectsDamageByName) {
  const std::string good = checkpoint_bytes(example_splat_state());
  ASSERT_EQ(checkpoint_error(good), "");
  const auto number = [](const char* tensor, int index, auto value) {
    return [=](CheckpointParts& p) {
      const auto begin = p.header[tensor]["data_offsets"][0].get<std::size_t>();
      std::memcpy(p.data.data() + begin + 4 * index, &value, 4);
    };
  };
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const CheckpointDamage table[] = {
      {"fewer Gaussians", with_metadata("gaussians", "16"), "adam.packed.shape"},
      {"more Gaussians", with_metadata("gaussians", "33"), "adam.packed.shape"},
      {"no Gaussians", with_metadata("gaussians", "0"), "parameter_mean.shape"},
      {"a negative number", with_metadata("gaussians", "-1"), "__metadata__.gaussians"},
      {"a negative first number", with_metadata("first_gaussians", "-17"),
       "__metadata__.first_gaussians"},
      {"beyond all memory", with_metadata("gaussians", "1000000000"), "__metadata__.gaussians"},
      {"beyond int", with_metadata("gaussians", "4294967313"), "__metadata__.gaussians"},
      {"half a Gaussian", with_metadata("gaussians", "17.5"), "__metadata__.gaussians"},
      {"the most that is allowed", with_metadata("gaussians", "20000000"), "adam.packed.shape"},
      {"number missing", [](CheckpointParts& p) { p.header["__metadata__"].erase("gaussians"); },
       "__metadata__.gaussians"},
      {"knots", with_metadata("appearance.knots", "4"), "adam.first_moment.shape"},
      {"knots below 0", with_metadata("appearance.knots", "-3"), "__metadata__.appearance.knots"},
      {"blocks of another length",
       [](CheckpointParts& p) {
         p.header["gaussians"]["shape"] = {2, 12, 32};
       },
       "gaussians.shape"},
      {"a NaN", number("gaussians", 100, nan), "gaussians[100]"},
      {"a NaN among the exposures", number("appearance", 4, nan), "appearance[4]"},
      {"a negative square", number("adam.second_moment", 7, -1.0f), "adam.second_moment[7]"},
      {"an infinite moment", number("adam.packed", 600, 0x7f800000u), "adam.packed[600]"},
      {"an infinite square", number("adam.packed", 601, 0xff00u), "adam.packed[601]"},
      {"an infinite error", number("adam.errors", 5, 0xff800000u), "adam.errors[5]"},
      {"a mean of no steps", with_metadata("mean.steps", "0"), "8 tensors"},
      {"a mean of fewer", with_metadata("mean.steps", "-1"), "__metadata__.mean.steps"},
      {"no mean",
       [](CheckpointParts& p) {
         p.header["other"] = p.header["parameter_mean"];
         p.header.erase("parameter_mean");
       },
       "parameter_mean"},
      {"an infinite mean", number("parameter_mean", 3, 0x7f800000u), "parameter_mean[3]"},
      {"moments that are not words",
       [](CheckpointParts& p) { p.header["adam.packed"]["dtype"] = "F32"; }, "adam.packed.dtype"},
      {"scales", with_metadata("max_scale", "0.0001"), "__metadata__.max_scale"},
      {"another method's numbers", with_metadata("method", "grid"), "__metadata__"},
  };
  expect_rejected(good, table);
}

}  // namespace
}  // namespace redrive

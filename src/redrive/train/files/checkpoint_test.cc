// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/files/checkpoint_testing.h"

#include <limits>

#include "redrive/methods/grid/grid_model.h"

namespace redrive {
namespace {

using ::testing::HasSubstr;

TrainState example_state(int fine_samples = 8) {
  Scene scene;
  scene.near_m = 0.5;
  scene.far_m = 12;
  scene.unit_from_world = {{1.5f, -0.1f, 1e-3f}, 0.07f};
  TrainOptions options;
  options.method = "nerf";
  options.set("width", 32);
  options.set("samples", 16);
  options.set("fine_samples", fine_samples);
  return midway(make_initial_state(options, scene));
}

/// A model with the smallest possible tables.
TrainState example_grid_state(int colour_layers = 1) {
  auto model = std::make_unique<GridModel>();
  model->field = {{2, 8, 2, 8, 4}, 16, colour_layers};
  model->proposal = {1, 1, 2, 2, 6};
  model->sky = {1, 4, 2, 2, 6};
  model->contraction = {{1.5f, -0.1f, 1e-3f}, 33, false};
  model->spacing = {0.25f, 321, 7};
  model->proposal_samples = {11, 7};
  model->samples = 5;
  GridModel& grid = *model;
  TrainState state = midway(initial_state(std::move(model), 3));
  grid.active_fraction = 0.625;
  state.cell_errors = Buffer<float>(3);
  state.cell_errors[0] = kInitialError;
  state.cell_errors[1] = 1.0f / 3;
  state.poses.corrections.frames = 2;
  state.poses.corrections.cameras = 1;
  for (auto* values :
       {&state.poses.corrections.values, &state.poses.moments.first, &state.poses.moments.second})
    for (std::size_t i = 0; i < state.poses.corrections.size(); ++i)
      values->push_back(1e-3f / static_cast<float>(i + 3));
  state.poses.moments.updates = 41;
  return state;
}

TEST(Checkpoint, RoundTripIsBitExact) {
  for (const int fine_samples : {0, 8}) {
    const TrainState state = example_state(fine_samples);
    const TrainState back = parse_checkpoint(checkpoint_bytes(state), "c");
    expect_equal(back.model->parameters, state.model->parameters);
    expect_equal(back.adam.first_moment, state.adam.first_moment);
    expect_equal(back.adam.second_moment, state.adam.second_moment);
    EXPECT_EQ(nerf(back).config, nerf(state).config);
    EXPECT_EQ(nerf(back).samples, 16);
    EXPECT_EQ(nerf(back).fine_samples, fine_samples);
    EXPECT_EQ(nerf(back).near_m, nerf(state).near_m);
    EXPECT_EQ(nerf(back).far_m, nerf(state).far_m);
    EXPECT_EQ(nerf(back).unit_from_world.center, nerf(state).unit_from_world.center);
    EXPECT_EQ(nerf(back).unit_from_world.scale, nerf(state).unit_from_world.scale);
    EXPECT_EQ(back.step, state.step);
    EXPECT_EQ(back.pixels_drawn, state.pixels_drawn);
    EXPECT_EQ(back.seconds, state.seconds);
    EXPECT_EQ(back.seed, state.seed);
    EXPECT_EQ(back.restarts, state.restarts);
    EXPECT_EQ(back.bad_steps, state.bad_steps);
    EXPECT_EQ(back.skipped_steps, state.skipped_steps);
    EXPECT_EQ(back.watch, state.watch);
    EXPECT_EQ(back.rollbacks, state.rollbacks);
    EXPECT_EQ(back.rate_factor, state.rate_factor);
    EXPECT_EQ(back.loss_watch, state.loss_watch);
    EXPECT_EQ(back.window, state.window);
  }
}

TEST(Checkpoint, GridRoundTripIsBitExact) {
  for (const int colour_layers : {1, 2}) {
    const TrainState state = example_grid_state(colour_layers);
    const std::string bytes = checkpoint_bytes(state);
    const TrainState back = parse_checkpoint(bytes, "c");
    ASSERT_STREQ(back.model->method(), "grid");
    const auto &a = dynamic_cast<const GridModel&>(*state.model),
               &b = dynamic_cast<const GridModel&>(*back.model);
    expect_equal(b.parameters, a.parameters);
    expect_equal(back.adam.first_moment, state.adam.first_moment);
    expect_equal(back.adam.second_moment, state.adam.second_moment);
    EXPECT_EQ(b.field, a.field);
    EXPECT_EQ(b.proposal, a.proposal);
    EXPECT_EQ(b.sky, a.sky);
    EXPECT_EQ(b.contraction, a.contraction);
    EXPECT_EQ(b.spacing.near_m, a.spacing.near_m);
    EXPECT_EQ(b.spacing.far_m, a.spacing.far_m);
    EXPECT_EQ(b.spacing.half_m, a.spacing.half_m);
    EXPECT_EQ(b.proposal_samples, a.proposal_samples);
    EXPECT_EQ(b.samples, a.samples);
    EXPECT_EQ(b.active_fraction, 0.625);
    EXPECT_TRUE(std::ranges::equal(back.cell_errors.span(), state.cell_errors.span()));
    EXPECT_EQ(back.poses.corrections.frames, 2);
    EXPECT_EQ(back.poses.corrections.cameras, 1);
    EXPECT_EQ(back.poses.corrections.values, state.poses.corrections.values);
    EXPECT_EQ(back.poses.moments.first, state.poses.moments.first);
    EXPECT_EQ(back.poses.moments.second, state.poses.moments.second);
    EXPECT_EQ(back.poses.moments.updates, 41);
    EXPECT_EQ(back.step, state.step);
    EXPECT_EQ(back.window, state.window);
    EXPECT_EQ(checkpoint_bytes(back), bytes);
  }
}

TEST(Checkpoint, LaysTensorsOutAsSafetensors) {
  const TrainState state = example_state();
  const std::string bytes = checkpoint_bytes(state);
  const CheckpointParts parts(bytes);
  EXPECT_EQ((bytes.size() - parts.data.size()) % 8, 0u);
  const nlohmann::json& weight = parts.header.at("fine.trunk.0.weight");
  EXPECT_EQ(weight.at("dtype"), "F32");
  EXPECT_EQ(weight.at("shape"), (std::vector<int>{32, 63}));
  float first = 0;
  std::memcpy(&first, parts.data.data() + weight.at("data_offsets")[0].get<std::size_t>(), 4);
  EXPECT_EQ(first, nerf(state).network(1)[nerf_layer(nerf(state).config, 0).weight]);
  EXPECT_EQ(parts.header.at("coarse.trunk.0.bias").at("shape"), (std::vector<int>{32}));
  EXPECT_EQ(parts.header.at("__metadata__").at("step"), "123456789012");
}

TEST(Checkpoint, RejectsDamageByName) {
  const std::string good = checkpoint_bytes(example_state());
  ASSERT_EQ(checkpoint_error(good), "");
  ASSERT_EQ(checkpoint_error(CheckpointParts(good).bytes()), "")
      << "parsing and writing alone must not be rejected";
  const CheckpointDamage table[] = {
      {"other dtype", [](CheckpointParts& p) { p.header["coarse.rgb.bias"]["dtype"] = "BF16"; },
       "coarse.rgb.bias.dtype"},
      {"no dtype", [](CheckpointParts& p) { p.header["coarse.rgb.bias"].erase("dtype"); },
       "coarse.rgb.bias"},
      {"shape of another size",
       [](CheckpointParts& p) { p.header["coarse.rgb.bias"]["shape"] = {4}; },
       "coarse.rgb.bias.shape"},
      {"shape turned",
       [](CheckpointParts& p) {
         p.header["coarse.trunk.0.weight"]["shape"] = {63, 32};
       },
       "coarse.trunk.0.weight.shape"},
      {"shape overflows",
       [](CheckpointParts& p) {
         p.header["coarse.rgb.bias"]["shape"] = {4294967296, 4294967296, 3};
       },
       "shape"},
      {"negative shape", [](CheckpointParts& p) { p.header["coarse.rgb.bias"]["shape"] = {-3}; },
       "shape"},
      {"shape no list", [](CheckpointParts& p) { p.header["coarse.rgb.bias"]["shape"] = 3; },
       "shape"},
      {"offsets swapped",
       [](CheckpointParts& p) {
         std::swap(p.header["coarse.rgb.bias"]["data_offsets"][0],
                   p.header["coarse.rgb.bias"]["data_offsets"][1]);
       },
       "data_offsets"},
      {"offsets past the end",
       [](CheckpointParts& p) {
         p.header["coarse.rgb.bias"]["data_offsets"] = {1e9, 1e9 + 12};
       },
       "data_offsets"},
      {"one offset", [](CheckpointParts& p) { p.header["coarse.rgb.bias"]["data_offsets"] = {0}; },
       "data_offsets"},
      {"overlap",
       [](CheckpointParts& p) {
         p.header["coarse.rgb.bias"]["data_offsets"] = {0, 12};
       },
       "overlaps"},
      {"tensor missing", [](CheckpointParts& p) { p.header.erase("adam.second_moment"); },
       "bytes of data"},
      {"tensor renamed",
       [](CheckpointParts& p) {
         p.header["x"] = p.header["fine.rgb.bias"];
         p.header.erase("fine.rgb.bias");
       },
       "fine.rgb.bias"},
      {"data cut off", [](CheckpointParts& p) { p.data.resize(p.data.size() - 4); }, ""},
      {"data too long", [](CheckpointParts& p) { p.data += "more"; }, "bytes of data"},
      {"no metadata", [](CheckpointParts& p) { p.header.erase("__metadata__"); },
       "__metadata__.format"},
      {"metadata no object", [](CheckpointParts& p) { p.header["__metadata__"] = 7; },
       "__metadata__"},
      {"metadata no text", [](CheckpointParts& p) { p.header["__metadata__"]["step"] = 7; },
       "__metadata__.step"},
      {"step missing", [](CheckpointParts& p) { p.header["__metadata__"].erase("step"); },
       "__metadata__.step"},
      {"step no number", with_metadata("step", "12x"), "__metadata__.step"},
      {"step negative", with_metadata("step", "-1"), "__metadata__.step"},
      {"seconds not finite", with_metadata("seconds", "nan"), "__metadata__.seconds"},
      {"width of another network", with_metadata("width", "64"), "adam.first_moment.shape"},
      {"width out of range", with_metadata("width", "1000000"), "__metadata__.width"},
      {"width no multiple", with_metadata("width", "33"), "__metadata__.width"},
      {"octaves", with_metadata("position_octaves", "11"), "__metadata__.position_octaves"},
      {"samples", with_metadata("samples", "0"), "__metadata__.samples"},
      {"fine network left out", with_metadata("fine_samples", "0"), "adam.first_moment.shape"},
      {"far before near", with_metadata("far_m", "0.25"), "__metadata__.far_m"},
      {"scale", with_metadata("unit_from_world.scale", "0"), "__metadata__.unit_from_world.scale"},
      {"another format", with_metadata("format", "torch"), "__metadata__.format"},
  };
  expect_rejected(good, table);
}

TEST(Checkpoint, RejectsDamageToAGridByName) {
  const std::string good = checkpoint_bytes(example_grid_state());
  ASSERT_EQ(checkpoint_error(good), "");
  const CheckpointDamage table[] = {
      {"another method's numbers", with_metadata("method", "nerf"),
       "__metadata__.position_octaves"},
      {"unknown method", with_metadata("method", "splats"), "__metadata__.method"},
      {"method missing", [](CheckpointParts& p) { p.header["__metadata__"].erase("method"); },
       "__metadata__.method"},
      {"number missing", [](CheckpointParts& p) { p.header["__metadata__"].erase("sky.n_levels"); },
       "__metadata__.sky.n_levels"},
      {"levels", with_metadata("grid.n_levels", "0"), "__metadata__.grid.n_levels"},
      {"levels no multiple", with_metadata("grid.n_levels", "3"), "__metadata__.grid.n_levels"},
      {"rows beyond all memory", with_metadata("grid.log2_hashmap_size", "63"),
       "__metadata__.grid.log2_hashmap_size"},
      {"rows that the file does not hold", with_metadata("grid.log2_hashmap_size", "8"),
       "adam.first_moment.shape"},
      {"features of a sky", with_metadata("sky.features_per_level", "1"),
       "__metadata__.sky.features_per_level"},
      {"width", with_metadata("width", "17"), "__metadata__.width"},
      {"width of another network", with_metadata("width", "32"), "adam.first_moment.shape"},
      {"colour layers", with_metadata("colour_layers", "3"), "__metadata__.colour_layers"},
      {"near region of no size", with_metadata("contraction.half_m", "0"),
       "__metadata__.contraction.half_m"},
      {"centre not finite", with_metadata("contraction.center_x", "nan"),
       "__metadata__.contraction.center_x"},
      {"far before near", with_metadata("far_m", "0.125"), "__metadata__.far_m"},
      {"no samples", with_metadata("samples", "0"), "__metadata__.samples"},
      {"no proposals", with_metadata("proposal_samples_1", "-1"),
       "__metadata__.proposal_samples_1"},
      {"tensor renamed",
       [](CheckpointParts& p) {
         p.header["x"] = p.header["proposal"];
         p.header.erase("proposal");
       },
       "proposal"},
      {"matrix turned",
       [](CheckpointParts& p) {
         p.header["colour.0.weight"]["shape"] = {32, 16};
       },
       "colour.0.weight.shape"},
      {"poses of more frames than there are", with_metadata("poses.frames", "3"), "poses.shape"},
      {"poses of a negative number of frames", with_metadata("poses.frames", "-2"),
       "__metadata__.poses.frames"},
      {"poses of too many cameras", with_metadata("poses.cameras", "200000"),
       "__metadata__.poses.cameras"},
      {"updates", with_metadata("poses.updates", "-1"), "__metadata__.poses.updates"},
      {"poses of no frame and no camera",
       [](CheckpointParts& p) {
         for (const char* name : {"poses.frames", "poses.cameras"})
           p.header["__metadata__"][name] = "0";
       },
       "tensors"},
      {"a negative square",
       [](CheckpointParts& p) {
         const float below = -1;
         std::memcpy(p.data.data() +
                         p.header["poses.second_moment"]["data_offsets"][0].get<std::size_t>() + 4,
                     &below, 4);
       },
       "poses.second_moment"},
      {"errors that are no list",
       [](CheckpointParts& p) {
         p.header["cell_errors"]["shape"] = {1, 3};
       },
       "cell_errors.shape"},
      {"an error beyond what can be",
       [](CheckpointParts& p) {
         const float beyond = 1.5f;
         std::memcpy(
             p.data.data() + p.header["cell_errors"]["data_offsets"][0].get<std::size_t>() + 4,
             &beyond, 4);
       },
       "cell_errors[1]"},
      {"an error below",
       [](CheckpointParts& p) {
         const float below = -0.5f;
         std::memcpy(
             p.data.data() + p.header["cell_errors"]["data_offsets"][0].get<std::size_t>() + 8,
             &below, 4);
       },
       "cell_errors[2]"},
      {"rays drawn", with_metadata("pixels_drawn", "-1"), "__metadata__.pixels_drawn"},
      {"active fraction", with_metadata("active_fraction", "1.5"), "__metadata__.active_fraction"},
      {"the format before", with_metadata("format", "redrive-7"), "__metadata__.format"},
  };
  expect_rejected(good, table);
}

TEST(Checkpoint, RejectsNonFiniteAndNegativeValues) {
  const std::string good = checkpoint_bytes(example_state());
  for (const char* tensor :
       {"coarse.trunk.5.weight", "fine.density.bias", "adam.first_moment", "adam.second_moment"})
    for (const float value :
         {std::numeric_limits<float>::quiet_NaN(), -std::numeric_limits<float>::infinity()}) {
      CheckpointParts parts(good);
      std::memcpy(parts.data.data() + parts.header[tensor]["data_offsets"][0].get<std::size_t>(),
                  &value, 4);
      EXPECT_THAT(checkpoint_error(parts.bytes()), HasSubstr(std::string(tensor) + "[0]"));
    }
  CheckpointParts parts(good);
  const float negative = -1e-20f;
  std::memcpy(parts.data.data() +
                  parts.header["adam.second_moment"]["data_offsets"][0].get<std::size_t>() + 8,
              &negative, 4);
  EXPECT_THAT(checkpoint_error(parts.bytes()), HasSubstr("adam.second_moment[2]"));
}

TEST(Checkpoint, RejectsEveryTruncation) {
  const std::string good = checkpoint_bytes(example_state(0));
  const std::size_t header = good.size() - CheckpointParts(good).data.size();
  for (std::size_t size = 0; size < header + 64; ++size)
    EXPECT_NE(checkpoint_error(good.substr(0, size)), "") << size;
  for (std::size_t size = header; size < good.size(); size += 4093)
    EXPECT_NE(checkpoint_error(good.substr(0, size)), "") << size;
  EXPECT_NE(checkpoint_error(good.substr(0, good.size() - 1)), "");
}

TEST(Checkpoint, RejectsAnImpossibleHeaderLength) {
  const std::string good = checkpoint_bytes(example_state(0));
  for (const std::uint64_t length :
       {std::uint64_t{0}, std::uint64_t{1}, std::uint64_t{good.size()},
        std::numeric_limits<std::uint64_t>::max(), std::numeric_limits<std::uint64_t>::max() - 7}) {
    std::string bytes = good;
    std::memcpy(bytes.data(), &length, 8);
    EXPECT_THAT(checkpoint_error(bytes), HasSubstr("header length")) << length;
  }
}

}  // namespace
}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
#include <cstring>
#include <functional>
#include <limits>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/rng.h"
#include "redrive/model/grid_model.h"
#include "redrive/model/splat_model.h"
#include "redrive/train/safetensors.h"
#include "redrive/train/train_testing.h"

namespace redrive {
namespace {

using ::testing::HasSubstr;

/// A state in which every value differs from its initial one.
TrainState midway(TrainState state) {
  for (std::size_t i = 0; i < state.adam.first_moment.size(); ++i) {
    state.adam.first_moment[i] = random_unit(1, i) - 0.5f;
    state.adam.second_moment[i] = random_unit(2, i) * 1e-30f;
  }
  state.step = 123456789012;
  state.pixels_drawn = 9876543210987;
  state.seconds = 0.1 + 0.2;
  state.seed = 18446744073709551615ull;
  state.restarts = 2;
  state.bad_steps = 1;
  state.skipped_steps = 4;
  state.watch = {3, 0.1, 0.2, 1.0 / 3};
  state.rollbacks = 3;
  state.rate_factor = 0.125;
  state.loss_watch = {1ull << 60, 99999.5, 0.1, 1.0 / 7, 2};
  state.window = {7, 7168, 0.7, 0.6, 1e-9, {0.25, 1.0 / 3}};
  return state;
}

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
  state.adam.first_moment = Buffer<float>(model->size());
  state.adam.second_moment = Buffer<float>(model->size());
  state.model = std::move(model);
  return midway(std::move(state));
}

void expect_equal(std::span<const float> a, std::span<const float> b) {
  ASSERT_EQ(a.size(), b.size());
  EXPECT_EQ(std::memcmp(a.data(), b.data(), a.size_bytes()), 0);
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

/// A parsed file: header as JSON, and the data.
struct Parts {
  nlohmann::json header;
  std::string data;

  explicit Parts(const std::string& bytes) {
    std::uint64_t length = 0;
    std::memcpy(&length, bytes.data(), 8);
    header = nlohmann::json::parse(bytes.substr(8, length));
    data = bytes.substr(8 + length);
  }
  std::string bytes() const {
    std::string text = header.dump();
    text.resize((text.size() + 7) / 8 * 8, ' ');
    const std::uint64_t length = text.size();
    return std::string(reinterpret_cast<const char*>(&length), 8) + text + data;
  }
};

TEST(Checkpoint, LaysTensorsOutAsSafetensors) {
  const TrainState state = example_state();
  const std::string bytes = checkpoint_bytes(state);
  const Parts parts(bytes);
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

// Earlier builds trained on the LiDAR of held-out frames.
TEST(Checkpoint, KnowsWhetherItHoldsLidarOut) {
  TrainState state = example_state();
  const std::string bytes = checkpoint_bytes(state);
  EXPECT_TRUE(parse_checkpoint(bytes, "a").holds_out_lidar);
  Parts earlier(bytes);
  earlier.header["__metadata__"].erase("holds_out_lidar");
  EXPECT_FALSE(parse_checkpoint(earlier.bytes(), "a").holds_out_lidar);
  state.holds_out_lidar = false;
  EXPECT_FALSE(parse_checkpoint(checkpoint_bytes(state), "a").holds_out_lidar);
}

std::string error_message(const std::string& bytes) {
  try {
    parse_checkpoint(bytes, "run/checkpoint.safetensors");
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

struct Damage {
  const char* name;
  std::function<void(Parts&)> apply;
  const char* message;  ///< part of the message
};

TEST(Checkpoint, RejectsDamageByName) {
  const std::string good = checkpoint_bytes(example_state());
  ASSERT_EQ(error_message(good), "");
  ASSERT_EQ(error_message(Parts(good).bytes()), "")
      << "parsing and writing alone must not be rejected";
  const auto metadata = [](const char* key, const char* value) {
    return [=](Parts& p) { p.header["__metadata__"][key] = value; };
  };
  const Damage table[] = {
      {"other dtype", [](Parts& p) { p.header["coarse.rgb.bias"]["dtype"] = "BF16"; },
       "coarse.rgb.bias.dtype"},
      {"no dtype", [](Parts& p) { p.header["coarse.rgb.bias"].erase("dtype"); }, "coarse.rgb.bias"},
      {"shape of another size", [](Parts& p) { p.header["coarse.rgb.bias"]["shape"] = {4}; },
       "coarse.rgb.bias.shape"},
      {"shape turned",
       [](Parts& p) {
         p.header["coarse.trunk.0.weight"]["shape"] = {63, 32};
       },
       "coarse.trunk.0.weight.shape"},
      {"shape overflows",
       [](Parts& p) {
         p.header["coarse.rgb.bias"]["shape"] = {4294967296, 4294967296, 3};
       },
       "shape"},
      {"negative shape", [](Parts& p) { p.header["coarse.rgb.bias"]["shape"] = {-3}; }, "shape"},
      {"shape no list", [](Parts& p) { p.header["coarse.rgb.bias"]["shape"] = 3; }, "shape"},
      {"offsets swapped",
       [](Parts& p) {
         std::swap(p.header["coarse.rgb.bias"]["data_offsets"][0],
                   p.header["coarse.rgb.bias"]["data_offsets"][1]);
       },
       "data_offsets"},
      {"offsets past the end",
       [](Parts& p) {
         p.header["coarse.rgb.bias"]["data_offsets"] = {1e9, 1e9 + 12};
       },
       "data_offsets"},
      {"one offset", [](Parts& p) { p.header["coarse.rgb.bias"]["data_offsets"] = {0}; },
       "data_offsets"},
      {"overlap",
       [](Parts& p) {
         p.header["coarse.rgb.bias"]["data_offsets"] = {0, 12};
       },
       "overlaps"},
      {"tensor missing", [](Parts& p) { p.header.erase("adam.second_moment"); }, "bytes of data"},
      {"tensor renamed",
       [](Parts& p) {
         p.header["x"] = p.header["fine.rgb.bias"];
         p.header.erase("fine.rgb.bias");
       },
       "fine.rgb.bias"},
      {"data cut off", [](Parts& p) { p.data.resize(p.data.size() - 4); }, ""},
      {"data too long", [](Parts& p) { p.data += "more"; }, "bytes of data"},
      {"no metadata", [](Parts& p) { p.header.erase("__metadata__"); }, "__metadata__.format"},
      {"metadata no object", [](Parts& p) { p.header["__metadata__"] = 7; }, "__metadata__"},
      {"metadata no text", [](Parts& p) { p.header["__metadata__"]["step"] = 7; },
       "__metadata__.step"},
      {"step missing", [](Parts& p) { p.header["__metadata__"].erase("step"); },
       "__metadata__.step"},
      {"step no number", metadata("step", "12x"), "__metadata__.step"},
      {"step negative", metadata("step", "-1"), "__metadata__.step"},
      {"seconds not finite", metadata("seconds", "nan"), "__metadata__.seconds"},
      {"width of another network", metadata("width", "64"), "adam.first_moment.shape"},
      {"width out of range", metadata("width", "1000000"), "__metadata__.width"},
      {"width no multiple", metadata("width", "33"), "__metadata__.width"},
      {"octaves", metadata("position_octaves", "11"), "__metadata__.position_octaves"},
      {"samples", metadata("samples", "0"), "__metadata__.samples"},
      {"fine network left out", metadata("fine_samples", "0"), "adam.first_moment.shape"},
      {"far before near", metadata("far_m", "0.25"), "__metadata__.far_m"},
      {"scale", metadata("unit_from_world.scale", "0"), "__metadata__.unit_from_world.scale"},
      {"another format", metadata("format", "torch"), "__metadata__.format"},
  };
  for (const Damage& damage : table) {
    Parts parts(good);
    damage.apply(parts);
    const std::string what = error_message(parts.bytes());
    EXPECT_THAT(what, HasSubstr("run/checkpoint.safetensors")) << damage.name;
    EXPECT_THAT(what, HasSubstr(damage.message)) << damage.name;
  }
}

TEST(Checkpoint, RejectsDamageToAGridByName) {
  const std::string good = checkpoint_bytes(example_grid_state());
  ASSERT_EQ(error_message(good), "");
  const auto metadata = [](const char* key, const char* value) {
    return [=](Parts& p) { p.header["__metadata__"][key] = value; };
  };
  const Damage table[] = {
      {"another method's numbers", metadata("method", "nerf"), "__metadata__.position_octaves"},
      {"unknown method", metadata("method", "splats"), "__metadata__.method"},
      {"method missing", [](Parts& p) { p.header["__metadata__"].erase("method"); },
       "__metadata__.method"},
      {"number missing", [](Parts& p) { p.header["__metadata__"].erase("sky.n_levels"); },
       "__metadata__.sky.n_levels"},
      {"levels", metadata("grid.n_levels", "0"), "__metadata__.grid.n_levels"},
      {"levels no multiple", metadata("grid.n_levels", "3"), "__metadata__.grid.n_levels"},
      {"rows beyond all memory", metadata("grid.log2_hashmap_size", "63"),
       "__metadata__.grid.log2_hashmap_size"},
      {"rows that the file does not hold", metadata("grid.log2_hashmap_size", "8"),
       "adam.first_moment.shape"},
      {"features of a sky", metadata("sky.features_per_level", "1"),
       "__metadata__.sky.features_per_level"},
      {"width", metadata("width", "17"), "__metadata__.width"},
      {"width of another network", metadata("width", "32"), "adam.first_moment.shape"},
      {"colour layers", metadata("colour_layers", "3"), "__metadata__.colour_layers"},
      {"near region of no size", metadata("contraction.half_m", "0"),
       "__metadata__.contraction.half_m"},
      {"centre not finite", metadata("contraction.center_x", "nan"),
       "__metadata__.contraction.center_x"},
      {"far before near", metadata("far_m", "0.125"), "__metadata__.far_m"},
      {"no samples", metadata("samples", "0"), "__metadata__.samples"},
      {"no proposals", metadata("proposal_samples_1", "-1"), "__metadata__.proposal_samples_1"},
      {"tensor renamed",
       [](Parts& p) {
         p.header["x"] = p.header["proposal"];
         p.header.erase("proposal");
       },
       "proposal"},
      {"matrix turned",
       [](Parts& p) {
         p.header["colour.0.weight"]["shape"] = {32, 16};
       },
       "colour.0.weight.shape"},
      {"poses of more frames than there are", metadata("poses.frames", "3"), "poses.shape"},
      {"poses of a negative number of frames", metadata("poses.frames", "-2"),
       "__metadata__.poses.frames"},
      {"poses of too many cameras", metadata("poses.cameras", "200000"),
       "__metadata__.poses.cameras"},
      {"updates", metadata("poses.updates", "-1"), "__metadata__.poses.updates"},
      {"poses of no frame and no camera",
       [](Parts& p) {
         for (const char* name : {"poses.frames", "poses.cameras"})
           p.header["__metadata__"][name] = "0";
       },
       "tensors"},
      {"a negative square",
       [](Parts& p) {
         const float below = -1;
         std::memcpy(p.data.data() +
                         p.header["poses.second_moment"]["data_offsets"][0].get<std::size_t>() + 4,
                     &below, 4);
       },
       "poses.second_moment"},
      {"errors that are no list",
       [](Parts& p) {
         p.header["cell_errors"]["shape"] = {1, 3};
       },
       "cell_errors.shape"},
      {"an error beyond what can be",
       [](Parts& p) {
         const float beyond = 1.5f;
         std::memcpy(
             p.data.data() + p.header["cell_errors"]["data_offsets"][0].get<std::size_t>() + 4,
             &beyond, 4);
       },
       "cell_errors[1]"},
      {"an error below",
       [](Parts& p) {
         const float below = -0.5f;
         std::memcpy(
             p.data.data() + p.header["cell_errors"]["data_offsets"][0].get<std::size_t>() + 8,
             &below, 4);
       },
       "cell_errors[2]"},
      {"rays drawn", metadata("pixels_drawn", "-1"), "__metadata__.pixels_drawn"},
      {"active fraction", metadata("active_fraction", "1.5"), "__metadata__.active_fraction"},
      {"the format before", metadata("format", "redrive-7"), "__metadata__.format"},
  };
  for (const Damage& damage : table) {
    Parts parts(good);
    damage.apply(parts);
    const std::string what = error_message(parts.bytes());
    EXPECT_THAT(what, HasSubstr("run/checkpoint.safetensors")) << damage.name;
    EXPECT_THAT(what, HasSubstr(damage.message)) << damage.name;
  }
}

TEST(Checkpoint, SplatRoundTripIsBitExact) {
  const TrainState state = example_splat_state(/*with_actors=*/true),
                   back = parse_checkpoint(checkpoint_bytes(state), "c");
  ASSERT_STREQ(back.model->method(), "splat");
  expect_equal(back.model->parameters, state.model->parameters);
  expect_equal(back.adam.first_moment, state.adam.first_moment);
  expect_equal(back.adam.second_moment, state.adam.second_moment);
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

TEST(Checkpoint, RejectsDamageToActorsByName) {
  const std::string good = checkpoint_bytes(example_splat_state(/*with_actors=*/true));
  ASSERT_EQ(error_message(good), "");
  for (const auto& [key, value, field] : std::vector<std::array<std::string, 3>>{
           {"actor_ends", "2,5", "__metadata__.actor_ends"},  // of the world's blocks
           {"actor_ends", "5,3", "__metadata__.actor_ends"},
           {"actor_ends", "5", "__metadata__.actor_ends"},
           {"actor_ends", "3,4000000000", "__metadata__.actor_ends"},
           {"actor_ends", "3,x", "__metadata__.actor_ends"},
           {"actor_ends", "3,6", "adam.first_moment.shape"},
           {"actor_ids", "-4", "__metadata__.actor_keys"},
           {"actor_keys", "2", "__metadata__.actor_keys"},
           {"actor_keys", "2,7", "adam.first_moment.shape"},
           {"actor_ids", "9,-4", "__metadata__.actor_ids"},
           {"gaussians", "49", "__metadata__.actor_ends"}}) {
    Parts parts(good);
    parts.header["__metadata__"][key] = value;
    EXPECT_THAT(error_message(parts.bytes()), HasSubstr(field)) << key << " = " << value;
  }
}

TEST(Checkpoint, RejectsDamageToGaussiansByName) {
  const std::string good = checkpoint_bytes(example_splat_state());
  ASSERT_EQ(error_message(good), "");
  const auto metadata = [](const char* key, const char* value) {
    return [=](Parts& p) { p.header["__metadata__"][key] = value; };
  };
  const auto number = [](const char* tensor, int index, float value) {
    return [=](Parts& p) {
      const auto begin = p.header[tensor]["data_offsets"][0].get<std::size_t>();
      std::memcpy(p.data.data() + begin + 4 * index, &value, 4);
    };
  };
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const Damage table[] = {
      {"fewer Gaussians", metadata("gaussians", "16"), "adam.first_moment.shape"},
      {"more Gaussians", metadata("gaussians", "33"), "adam.first_moment.shape"},
      {"no Gaussians", metadata("gaussians", "0"), "adam.first_moment.shape"},
      {"a negative number", metadata("gaussians", "-1"), "__metadata__.gaussians"},
      {"a negative first number", metadata("first_gaussians", "-17"),
       "__metadata__.first_gaussians"},
      {"beyond all memory", metadata("gaussians", "1000000000"), "__metadata__.gaussians"},
      {"beyond int", metadata("gaussians", "4294967313"), "__metadata__.gaussians"},
      {"half a Gaussian", metadata("gaussians", "17.5"), "__metadata__.gaussians"},
      {"the most that is allowed", metadata("gaussians", "20000000"), "adam.first_moment.shape"},
      {"number missing", [](Parts& p) { p.header["__metadata__"].erase("gaussians"); },
       "__metadata__.gaussians"},
      {"knots", metadata("appearance.knots", "4"), "adam.first_moment.shape"},
      {"knots below 0", metadata("appearance.knots", "-3"), "__metadata__.appearance.knots"},
      {"blocks of another length",
       [](Parts& p) {
         p.header["gaussians"]["shape"] = {2, 12, 32};
       },
       "gaussians.shape"},
      {"a NaN", number("gaussians", 100, nan), "gaussians[100]"},
      {"a NaN among the exposures", number("appearance", 4, nan), "appearance[4]"},
      {"a negative square", number("adam.second_moment", 700, -1), "adam.second_moment[700]"},
      {"scales", metadata("max_scale", "0.0001"), "__metadata__.max_scale"},
      {"another method's numbers", metadata("method", "grid"), "__metadata__"},
  };
  for (const Damage& damage : table) {
    Parts parts(good);
    damage.apply(parts);
    const std::string what = error_message(parts.bytes());
    EXPECT_THAT(what, HasSubstr("run/checkpoint.safetensors")) << damage.name;
    EXPECT_THAT(what, HasSubstr(damage.message)) << damage.name;
  }
}

TEST(Checkpoint, RejectsNonFiniteAndNegativeValues) {
  const std::string good = checkpoint_bytes(example_state());
  for (const char* tensor :
       {"coarse.trunk.5.weight", "fine.density.bias", "adam.first_moment", "adam.second_moment"})
    for (const float value :
         {std::numeric_limits<float>::quiet_NaN(), -std::numeric_limits<float>::infinity()}) {
      Parts parts(good);
      std::memcpy(parts.data.data() + parts.header[tensor]["data_offsets"][0].get<std::size_t>(),
                  &value, 4);
      EXPECT_THAT(error_message(parts.bytes()), HasSubstr(std::string(tensor) + "[0]"));
    }
  Parts parts(good);
  const float negative = -1e-20f;
  std::memcpy(parts.data.data() +
                  parts.header["adam.second_moment"]["data_offsets"][0].get<std::size_t>() + 8,
              &negative, 4);
  EXPECT_THAT(error_message(parts.bytes()), HasSubstr("adam.second_moment[2]"));
}

TEST(Checkpoint, RejectsEveryTruncation) {
  const std::string good = checkpoint_bytes(example_state(0));
  const std::size_t header = good.size() - Parts(good).data.size();
  for (std::size_t size = 0; size < header + 64; ++size)
    EXPECT_NE(error_message(good.substr(0, size)), "") << size;
  for (std::size_t size = header; size < good.size(); size += 4093)
    EXPECT_NE(error_message(good.substr(0, size)), "") << size;
  EXPECT_NE(error_message(good.substr(0, good.size() - 1)), "");
}

TEST(Checkpoint, RejectsAnImpossibleHeaderLength) {
  const std::string good = checkpoint_bytes(example_state(0));
  for (const std::uint64_t length :
       {std::uint64_t{0}, std::uint64_t{1}, std::uint64_t{good.size()},
        std::numeric_limits<std::uint64_t>::max(), std::numeric_limits<std::uint64_t>::max() - 7}) {
    std::string bytes = good;
    std::memcpy(bytes.data(), &length, 8);
    EXPECT_THAT(error_message(bytes), HasSubstr("header length")) << length;
  }
}

}  // namespace
}  // namespace redrive

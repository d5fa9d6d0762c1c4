// SPDX-License-Identifier: Apache-2.0
// A run's options in config.json.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/train/files/options.h"

namespace redrive {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

TrainOptions unusual() {
  TrainOptions options;
  options.recording = "/drives/a b";
  options.method = "nerf";
  apply_preset(&options, {});
  options.preset = "report-1";
  options.cameras = {"A", "B"};
  options.frames = "3:9";
  options.downscale = 4;
  options.holdout_every = 8;
  options.undistort = true;
  options.near_m = 0.1;
  options.far_m = 123.456789012345;
  options.set("width", 64);
  options.set("fine_samples", 128);
  options.set("learning_rate", 1e-3);
  options.set("lr_milestones", std::string("10,20"));
  options.max_steps = 1234567890123 / 10;
  options.seed = 18446744073709551615ull;
  options.backend = "ref";
  return options;
}

TEST(TrainOptions, JsonRoundTripKeepsEveryField) {
  const nlohmann::json json = options_to_json(unusual());
  EXPECT_EQ(json.at("lr-milestones"), nlohmann::json({10, 20}));
  EXPECT_EQ(json.at("learning-rate"), 1e-3);
  EXPECT_EQ(json.at("width"), 64);
  const TrainOptions back = options_from_json(nlohmann::json::parse(json.dump()), "config.json");
  EXPECT_EQ(options_to_json(back), json);
  EXPECT_EQ(back.seed, 18446744073709551615ull);
  EXPECT_EQ(back.far_m, 123.456789012345);
  EXPECT_THAT(back.cameras, ElementsAre("A", "B"));
}

TEST(TrainOptions, RejectsMalformedJson) {
  const auto what = [](const nlohmann::json& json) -> std::string {
    try {
      options_from_json(json, "config.json");
    } catch (const InputError& error) {
      return error.what();
    }
    return "";
  };
  nlohmann::json json = options_to_json(unusual());
  json["colour"] = 1;
  EXPECT_THAT(what(json), HasSubstr("colour"));
  for (const TrainField& candidate : train_fields()) {
    json = options_to_json(unusual());
    json[candidate.name] = {{"x", nullptr}};
    EXPECT_THAT(what(json), HasSubstr(candidate.name)) << "an object";
    json[candidate.name] = nullptr;
    EXPECT_THAT(what(json), HasSubstr(candidate.name)) << "null";
  }
  json = options_to_json(unusual());
  json["width"] = 3'000'000'000ull;  // exceeds an int, and must not be truncated
  EXPECT_THAT(what(json), HasSubstr("width"));
  json["width"] = 100;
  EXPECT_THAT(what(json), HasSubstr("--width 100"));
  EXPECT_THAT(what(nlohmann::json::array()), HasSubstr("config.json"));
}

TEST(TrainOptions, AnOptionThatIsNewerThanTheRunHasItsDefault) {
  const nlohmann::json whole = options_to_json(unusual());
  nlohmann::json older = whole;
  older.erase("seed");
  const TrainOptions back = options_from_json(older, "config.json");
  EXPECT_NE(unusual().seed, TrainOptions().seed);
  EXPECT_EQ(back.seed, TrainOptions().seed);
  EXPECT_EQ(back.far_m, unusual().far_m);
  for (const std::string name : {"recording", "method"}) {
    nlohmann::json json = whole;
    json.erase(name);
    try {
      options_from_json(json, "config.json");
      ADD_FAILURE() << name;
    } catch (const InputError& error) {
      EXPECT_THAT(error.what(), HasSubstr(name + ": missing"));
    }
  }
}

}  // namespace
}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
// A Blender data set and a transforms.json, from inspect to render, and their faults.
#include <nlohmann/json.hpp>

#include "redrive/image/image_io.h"
#include "tests/e2e/end_to_end.h"

namespace redrive::testing {
namespace {

using nlohmann::json;
using ::testing::AllOf;
using ::testing::HasSubstr;

constexpr int kSize = 20;

/// A red disc on a transparent background from four units away: opaque in the middle, half
/// transparent at its edge, 20 x 20 pixels.
Image8 disc() {
  Image8 image{kSize, kSize, {}};
  for (int i = 0; i < kSize * kSize; ++i) {
    const double r = std::hypot(i % kSize - 9.5, i / kSize - 9.5);
    image.rgb.insert(image.rgb.end(), {200, 20, 10});
    image.alpha.push_back(r < 5 ? 255 : r < 6 ? 128 : 0);
  }
  return image;
}

class Photographs : public EndToEnd {
 protected:
  Photographs() {
    for (const auto& [split, count] : {std::pair{"train", 4}, std::pair{"test", 2}}) {
      json frames = json::array();
      fs::create_directories(set_ / split);
      for (int i = 0; i < count; ++i) {
        const double a = 1.3 * i + (split[1] == 'e' ? 0.5 : 0), c = std::cos(a), s = std::sin(a);
        const std::string name = std::string(split) + "/r_" + std::to_string(i);
        // Right, up and backward axes of a camera on a circle that looks at the centre.
        frames.push_back({{"file_path", "./" + name},
                          {"transform_matrix",
                           {{-s, 0, c, 4 * c}, {c, 0, s, 4 * s}, {0, 1, 0, 0}, {0, 0, 0, 1}}}});
        write_image(set_ / (name + ".png"), disc());
      }
      write_file(set_ / ("transforms_" + std::string(split) + ".json"),
                 json{{"camera_angle_x", 0.7}, {"frames", frames}}.dump());
    }
  }
  ProgramResult train(const std::vector<std::string>& more) const {
    std::vector<std::string> arguments = {
        "train", set_.string(), "--out", (folder_ / "run").string(), "--width", "32", "--samples",
        "12",    "--batch",     "128"};
    if (std::ranges::find(more, "--method") == more.end())
      arguments.insert(arguments.end(), {"--method", "grid"});
    if (std::ranges::find(more, "--max-steps") == more.end())
      arguments.insert(arguments.end(), {"--max-steps", "20"});
    arguments.insert(arguments.end(), more.begin(), more.end());
    return redrive(arguments);
  }
  const fs::path set_ = folder_ / "set";
};

TEST_F(Photographs, InspectTrainEvalRender) {
  const ProgramResult table = redrive({"inspect", set_.string()});
  EXPECT_EQ(table.exit_code, kExitOk) << table.err;
  EXPECT_THAT(
      table.out,
      AllOf(HasSubstr("(blender)"),
            HasSubstr("6, ids 0 to 5 in file-name order; neither metric scale nor timestamps"),
            HasSubstr("1.51515 around 0 0 0"), HasSubstr("2 images by the recording's own split"),
            HasSubstr("--background")));
  EXPECT_THAT(table.out, ::testing::Not(HasSubstr("driven")));
  const ProgramResult inspected = redrive({"inspect", set_.string(), "--json"});
  const json report = json::parse(inspected.out);
  EXPECT_EQ(report.at("metric"), false);
  EXPECT_EQ(report.at("drive"), nullptr);
  EXPECT_EQ(report.at("cameras").at(0).at("held_out"), 2);
  EXPECT_EQ(report.at("cameras").at(0).at("alpha"), true);

  const ProgramResult trained = train({"--background", "white"});
  ASSERT_EQ(trained.exit_code, kExitOk) << trained.err;
  EXPECT_THAT(trained.out, HasSubstr("6 frames, 4 images for training, 2 held out"));
  const json config = read_json(folder_ / "run/config.json");
  EXPECT_EQ(config.at("background"), "white");
  EXPECT_GT(config.at("near"), 1) << "cameras stand 4 from the middle of a cube of +-1.5";
  EXPECT_LT(config.at("far"), 8);
  const ProgramResult scored = redrive({"eval", (folder_ / "run").string(), "--json"});
  EXPECT_EQ(scored.exit_code, kExitOk) << scored.err;
  EXPECT_EQ(json::parse(scored.out).at("overall").at("images"), 2);
  const std::string run = (folder_ / "run").string(), rendered = (folder_ / "a.png").string();
  const std::vector<std::string> render = {"render",  run, "--camera", "camera",
                                           "--frame", "5", "--out",    rendered};
  EXPECT_EQ(redrive(render).exit_code, kExitOk);
  EXPECT_EQ(read_image(rendered).width, kSize);
  std::vector<std::string> level = render;
  level.insert(level.end(), {"--force", "--axes", "local"});
  const ProgramResult refused = redrive(level);
  EXPECT_EQ(refused.exit_code, kExitUsage);
  EXPECT_THAT(refused.err, HasSubstr("--axes local"));
}

TEST_F(Photographs, TrainsTheGridOnAConstantBackground) {
  // The loss falls; an image is red in the middle and has the run's background in its corner.
  const ProgramResult trained = train({"--background", "random", "--max-steps", "300"});
  ASSERT_EQ(trained.exit_code, kExitOk) << trained.err;
  const std::string run = (folder_ / "run").string(), rendered = (folder_ / "a.png").string();
  ASSERT_EQ(
      redrive({"render", run, "--camera", "camera", "--frame", "0", "--out", rendered}).exit_code,
      kExitOk);
  const Image8 image = read_image(rendered);
  const auto at = [&](int x, int y) { return &image.rgb[3 * (y * kSize + x)]; };
  EXPECT_NEAR(at(10, 10)[0], 200, 30);
  EXPECT_LT(at(10, 10)[1], 60);
  for (int k = 0; k < 3; ++k) EXPECT_LT(at(0, 0)[k], 25);
  // A run whose config.json names another background is invalid.
  edit_json(folder_ / "run/config.json", [](json& config) { config["background"] = "white"; });
  const ProgramResult other = redrive({"eval", run});
  EXPECT_EQ(other.exit_code, kExitBadInput);
  EXPECT_THAT(other.err, HasSubstr("background"));
}

TEST_F(Photographs, TrainsSplatsUnlessToldOtherwise) {
  const std::string run = (folder_ / "run").string();
  const ProgramResult trained =
      redrive({"train", set_.string(), "--out", run, "--background", "white", "--max-steps", "20"});
  ASSERT_EQ(trained.exit_code, kExitOk) << trained.err;
  EXPECT_EQ(read_json(folder_ / "run/config.json").at("method"), "splat");
  EXPECT_EQ(redrive({"eval", run}).exit_code, kExitOk);
}

TEST_F(Photographs, TransparencyNeedsABackground) {
  ProgramResult ended = train({});
  EXPECT_EQ(ended.exit_code, kExitUsage);
  EXPECT_THAT(ended.err,
              AllOf(HasSubstr("--background"), HasSubstr("r_0.png"), HasSubstr("transparent")));
  ended = train({"--method", "nerf"});
  EXPECT_EQ(ended.exit_code, kExitUsage);
  EXPECT_THAT(ended.err, HasSubstr("transparent"));
  ended = train({"--method", "nerf", "--background", "random"});
  EXPECT_EQ(ended.exit_code, kExitUsage);
  EXPECT_THAT(ended.err, HasSubstr("--background random"));
  Image8 opaque = disc();
  opaque.alpha.clear();
  write_image(set_ / "test/r_1.png", opaque);
  ended = train({"--background", "white"});
  EXPECT_EQ(ended.exit_code, kExitUsage) << "a held-out image, before the first step";
  EXPECT_THAT(ended.err,
              AllOf(HasSubstr("--background"), HasSubstr("r_1.png"), HasSubstr("alpha")));
  EXPECT_FALSE(fs::exists(folder_ / "run"));
}

TEST_F(Photographs, RefusesInvalidOptionsAndMasks) {
  ProgramResult ended = train({"--background", "white", "--holdout-every", "2"});
  EXPECT_EQ(ended.exit_code, kExitUsage);
  EXPECT_THAT(ended.err, HasSubstr("--holdout-every 2"));
  ended = train({"--background", "white", "--truth-poses"});
  EXPECT_EQ(ended.exit_code, kExitBadInput);
  write_image(set_ / "mask.png",
              Image8{kSize, kSize + 1, std::vector<std::uint8_t>(3 * kSize * (kSize + 1), 255)});
  edit_json(set_ / "transforms_train.json",
            [](json& file) { file["frames"][3]["mask_path"] = "mask.png"; });
  for (const ProgramResult& one : {train({"--background", "white", "--max-steps", "2"}),
                                   redrive({"inspect", set_.string()})}) {
    EXPECT_EQ(one.exit_code, kExitOk) << one.err;
    EXPECT_THAT(one.out, AllOf(HasSubstr("images: 1 of "), HasSubstr("mask.png"),
                               HasSubstr("20 x 21"), HasSubstr("20 x 20")));
  }
  EXPECT_EQ(redrive({"inspect", set_.string(), "--max-damaged", "0"}).exit_code, kExitBadInput);
}

}  // namespace
}  // namespace redrive::testing

// SPDX-License-Identifier: Apache-2.0
// Moving objects that nobody annotated: samples/street_traffic without its boxes.
#include <nlohmann/json.hpp>

#include "tests/e2e/traffic_testing.h"

namespace redrive::testing {
namespace {

using ::testing::HasSubstr;

class FoundTraffic : public TrafficEndToEnd {
 protected:
  FoundTraffic() {
    fs::create_directories(hidden_ / "dynamic");
    for (const char* part : {"sensor", "dynamic/raw-revolutions"})
      fs::create_directory_symlink(fs::path(REDRIVE_SAMPLES "/street_traffic") / part,
                                   hidden_ / part);
  }
  ProgramResult train(const fs::path& run, std::vector<std::string> more) const {
    more.insert(more.end(), {"--downscale", "2", "--set", "max_gaussians=20000"});
    return train_on(hidden_, run, 60, more);
  }
  static nlohmann::json scores(const fs::path& run) {
    const ProgramResult scored = redrive({"eval", run.string(), "--json"});
    EXPECT_EQ(scored.exit_code, kExitOk) << scored.err;
    return nlohmann::json::parse(scored.out);
  }

  const fs::path hidden_ = folder_ / "hidden";
};

TEST_F(FoundTraffic, IsDrawnScoredAndEditedAsAnnotatedTrafficIs) {
  const fs::path run = folder_ / "run";
  const ProgramResult trained = train(run, {});
  ASSERT_EQ(trained.exit_code, kExitOk) << trained.err;
  EXPECT_THAT(trained.out, HasSubstr("moving objects drawn: 1, 1 of them found in the LiDAR"));

  const nlohmann::json moving = scores(run).at("moving");
  ASSERT_EQ(moving.at("objects").size(), 1u);
  EXPECT_EQ(moving.at("objects").at("-1").at("type"), "FOUND");
  EXPECT_GT(moving.at("inside").at("psnr_db"), 14);

  const Image8 all = rendered(run, {}), none = rendered(run, {"--actors", "none"});
  EXPECT_NE(all.rgb, none.rgb);
  EXPECT_EQ(rendered(run, {"--actors=-1"}).rgb, all.rgb);
  EXPECT_EQ(rendered(run, {"--actors", "-1"}).rgb, all.rgb);
  const fs::path edit = folder_ / "edit.json";
  write_file(edit, R"({"actors": {"-1": {"remove": true}}})");
  EXPECT_EQ(rendered(run, {"--edit", edit}).rgb, none.rgb);
  const ProgramResult exported = redrive({"export", run.string(), "--actors", "-1", "--to",
                                          "splat-ply", (folder_ / "car.ply").string()});
  EXPECT_EQ(exported.exit_code, kExitOk) << exported.err;
  EXPECT_THAT(exported.out, HasSubstr("FOUND of "));
  const auto points = [&](const fs::path& of) {
    const fs::path out = folder_ / "points.las";
    EXPECT_EQ(redrive({"export", of.string(), "--to", "las", out.string(), "--force"}).exit_code,
              kExitOk);
    return fs::file_size(out);
  };
  EXPECT_LT(points(run), points(hidden_)) << "without those on the car";

  const ProgramResult resumed = redrive({"resume", run.string(), "--max-steps", "70"});
  EXPECT_EQ(resumed.exit_code, kExitOk) << resumed.err;

  write_file(run / "masks/moving.json", R"({"objects": []})");
  const ProgramResult removed = redrive({"eval", run.string()});
  EXPECT_EQ(removed.exit_code, kExitBadInput);
  EXPECT_THAT(removed.err, HasSubstr("masks/moving.json: boxes of object -1"));
}

TEST_F(FoundTraffic, IsMaskedWithoutActors) {
  const fs::path run = folder_ / "run";
  const ProgramResult trained = train(run, {"--set", "actors=0"});
  ASSERT_EQ(trained.exit_code, kExitOk) << trained.err;
  EXPECT_THAT(trained.out, HasSubstr("moving objects masked: 1, 1 of them found in the LiDAR"));
  const nlohmann::json masked = scores(run);
  EXPECT_GT(masked.at("overall").at("masked_pixels"), 300);
  EXPECT_EQ(masked.at("moving").at("outside"), masked.at("overall"));
  write_file(run / "masks/moving.json", R"({"objects": []})");
  EXPECT_LT(scores(run).at("overall").at("masked_pixels"),
            masked.at("overall").at("masked_pixels"));
}

TEST_F(FoundTraffic, IsListedByInspect) {
  const ProgramResult ended = redrive({"inspect", hidden_.string(), "--objects", "--json"});
  const nlohmann::json objects = nlohmann::json::parse(ended.out).at("objects");
  ASSERT_GE(objects.size(), 1u) << ended.err;
  EXPECT_EQ(objects[0].at("type"), "FOUND");
  EXPECT_LT(objects[0].at("id"), 0);
  EXPECT_EQ(objects[0].at("moves"), true);
  const fs::path masks = folder_ / "masks";
  ASSERT_EQ(redrive({"inspect", hidden_.string(), "--masks", masks.string()}).exit_code, kExitOk);
  EXPECT_EQ(read_json(masks / "moving.json").at("objects").size(), objects.size());
}

// A moving.json of --masks, which needs no mask, holds for all blocks.
TEST_F(FoundTraffic, IsDrawnByTheBlocksThatSeeIt) {
  const fs::path whole = folder_ / "whole", given = folder_ / "given", run = folder_ / "run";
  ASSERT_EQ(train(whole, {}).exit_code, kExitOk);
  fs::create_directory(given);
  fs::copy(whole / "masks/moving.json", given / "moving.json");
  const ProgramResult trained = train(run, {"--blocks", "6", "--masks", given});
  ASSERT_EQ(trained.exit_code, kExitOk) << trained.err;
  EXPECT_THAT(trained.out, HasSubstr("finished: 3 blocks"));
  EXPECT_THAT(trained.out, HasSubstr("moving objects drawn: 1, 1 of them found"));
  EXPECT_EQ(read_file(run / "masks/moving.json"), read_file(given / "moving.json"));
  EXPECT_NE(rendered(run, {"--actors=-1"}).rgb, rendered(run, {"--actors", "none"}).rgb);
  EXPECT_EQ(scores(run).at("moving").at("objects").size(), 1u);
}

// A block of 6 m is too short to see the car move.
TEST_F(FoundTraffic, IsSearchedInMoreThanABlock) {
  const fs::path run = folder_ / "run";
  const ProgramResult trained = train(run, {"--blocks", "6"});
  ASSERT_EQ(trained.exit_code, kExitOk) << trained.err;
  EXPECT_THAT(trained.out, HasSubstr("finished: 3 blocks"));
  EXPECT_EQ(read_json(run / "masks/moving.json").at("objects").size(), 1u);
  EXPECT_NE(rendered(run, {"--actors=-1"}).rgb, rendered(run, {"--actors", "none"}).rgb);
}

}  // namespace
}  // namespace redrive::testing

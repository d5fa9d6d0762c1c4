// SPDX-License-Identifier: Apache-2.0
// Moving objects on samples/street_traffic: trained, scored apart, selected and edited.
#include <nlohmann/json.hpp>

#include "redrive/image/image_io.h"
#include "tests/e2e/end_to_end.h"

namespace redrive::testing {
namespace {

using ::testing::HasSubstr;

constexpr const char* kCamera = "F_MIDLONGRANGECAM_CL";

class Traffic : public EndToEnd {
 protected:
  fs::path train(const std::string& name, int steps, const std::vector<std::string>& more) const {
    std::vector<std::string> arguments = {"train",
                                          REDRIVE_SAMPLES "/street_traffic",
                                          "--out",
                                          (folder_ / name).string(),
                                          "--method",
                                          "splat",
                                          "--truth-poses",
                                          "--cameras",
                                          kCamera,
                                          "--holdout-every",
                                          "6",
                                          "--max-steps",
                                          std::to_string(steps),
                                          "--threads",
                                          "2"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    const ProgramResult trained = redrive(arguments);
    EXPECT_EQ(trained.exit_code, kExitOk) << trained.err;
    return folder_ / name;
  }
  Image8 rendered(const fs::path& run, std::vector<std::string> more) const {
    const fs::path out = folder_ / "view.png";
    more.insert(more.begin(), {"render", run.string(), "--camera", kCamera, "--frame", "1012",
                               "--force", "--out", out.string()});
    const ProgramResult ended = redrive(more);
    EXPECT_EQ(ended.exit_code, kExitOk) << ended.err;
    printed_ = ended.out;
    return read_image(out);
  }
  mutable std::string printed_;
};

/// Number of pixels that differ clearly.
int changed(const Image8& a, const Image8& b) {
  int n = 0;
  for (std::size_t i = 0; i < a.rgb.size(); i += 3)
    n += std::abs(a.rgb[i] - b.rgb[i]) + std::abs(a.rgb[i + 1] - b.rgb[i + 1]) +
             std::abs(a.rgb[i + 2] - b.rgb[i + 2]) >
         60;
  return n;
}

TEST_F(Traffic, MovingObjectsAreDrawnScoredAndEdited) {
  const fs::path run = train("run", 150, {});
  const ProgramResult scored = redrive({"eval", run.string(), "--json"});
  ASSERT_EQ(scored.exit_code, kExitOk) << scored.err;
  const nlohmann::json moving = nlohmann::json::parse(scored.out).at("moving");
  EXPECT_GT(moving.at("inside").at("psnr_db"), 20);
  EXPECT_EQ(moving.at("objects").at("2").at("type"), "CAR");
  EXPECT_EQ(moving.at("objects").size(), 2u) << "the parked one is of the world";

  const Image8 all = rendered(run, {}), none = rendered(run, {"--actors", "none"});
  EXPECT_GT(changed(all, none), 300);
  EXPECT_EQ(rendered(run, {"--actors", "2,3"}).rgb, all.rgb);
  const fs::path edit = folder_ / "edit.json";
  write_file(edit, R"({"actors": {"2": {"remove": true}, "3": {"remove": true}}})");
  EXPECT_EQ(rendered(run, {"--edit", edit}).rgb, none.rgb);
  write_file(edit, R"({"actors": {"2": {"shift_m": [-3, 0, 0]}},
                       "copies": [{"of": 2, "id": 9, "shift_m": [-4, 0.3, 0],
                                   "gain": [1, 0, 0]}]})");
  EXPECT_GT(changed(rendered(run, {"--edit", edit}), all), 300);
  EXPECT_THAT(printed_, HasSubstr("objects 2 and 9 overlap"));

  write_file(edit, R"({"actors": {"5": {"remove": true}}})");
  const ProgramResult unknown = redrive({"render", run.string(), "--camera", kCamera, "--frame",
                                         "1012", "--edit", edit, "--out", folder_ / "no.png"});
  EXPECT_EQ(unknown.exit_code, kExitBadInput);
  EXPECT_THAT(unknown.err, HasSubstr("it draws 2, 3"));
  EXPECT_FALSE(fs::exists(folder_ / "no.png"));
}

TEST_F(Traffic, InspectListsObjects) {
  const std::string recording = REDRIVE_SAMPLES "/street_traffic";
  const ProgramResult table = redrive({"inspect", recording, "--objects"});
  EXPECT_EQ(table.exit_code, kExitOk) << table.err;
  EXPECT_THAT(table.out, HasSubstr("parked"));
  const ProgramResult ended = redrive({"inspect", recording, "--objects", "--json"});
  const nlohmann::json objects = nlohmann::json::parse(ended.out).at("objects");
  ASSERT_EQ(objects.size(), 3u);
  EXPECT_EQ(objects[1].at("id"), 2);
  EXPECT_EQ(objects[1].at("type"), "CAR");
  EXPECT_EQ(objects[1].at("moves"), true);
  EXPECT_EQ(objects[1].at("boxes"), 24);
  EXPECT_GT(objects[1].at("driven_m"), 3);
  EXPECT_GT(objects[1].at("images"), 20);
  EXPECT_TRUE(
      nlohmann::json::parse(redrive({"inspect", recording, "--json"}).out).at("objects").is_null());
}

TEST_F(Traffic, MovingObjectsAreMaskedWithoutActors) {
  const fs::path run = train("masked", 20, {"--set", "actors=0"});
  const ProgramResult scored = redrive({"eval", run.string(), "--json"});
  ASSERT_EQ(scored.exit_code, kExitOk) << scored.err;
  const nlohmann::json json = nlohmann::json::parse(scored.out);
  EXPECT_GT(json.at("overall").at("left_out_pixels"), 1000);
  EXPECT_EQ(json.at("moving").at("outside"), json.at("overall"));
  EXPECT_EQ(rendered(run, {}).rgb, rendered(run, {"--actors", "none"}).rgb);
}

}  // namespace
}  // namespace redrive::testing

// SPDX-License-Identifier: Apache-2.0
// Moving objects on samples/street_traffic: trained, scored apart, selected and edited.
#include <nlohmann/json.hpp>

#include "tests/e2e/traffic_testing.h"

namespace redrive::testing {
namespace {

using ::testing::HasSubstr;

class Traffic : public TrafficEndToEnd {
 protected:
  fs::path train(const std::string& name, int steps, const std::vector<std::string>& more) const {
    const ProgramResult trained =
        train_on(REDRIVE_SAMPLES "/street_traffic", folder_ / name, steps, more);
    EXPECT_EQ(trained.exit_code, kExitOk) << trained.err;
    return folder_ / name;
  }
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
  EXPECT_GT(moving.at("objects").at("2").at("ssim"), 0.3);
  const nlohmann::json lidar = nlohmann::json::parse(scored.out).at("lidar");
  EXPECT_GT(lidar.at("moving").at("returns"), 20);
  EXPECT_GT(lidar.at("moving").at("near_hit_rate"), 0.05);

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

  // A body out and in again: on its own track it is the object, and it drives where none did.
  const fs::path body = folder_ / "car.ply";
  const ProgramResult exported =
      redrive({"export", run.string(), "--actors", "2", "--to", "splat-ply", body.string()});
  ASSERT_EQ(exported.exit_code, kExitOk) << exported.err;
  EXPECT_THAT(exported.out, HasSubstr("CAR of 4.63 x 2.10 x 1.44 m"));
  write_file(edit, R"({"actors": {"2": {"body": {"file": "car.ply"}}}})");
  EXPECT_LT(changed(rendered(run, {"--edit", edit}), all), 10);
  write_file(edit, R"({"actors": {"2": {"remove": true}, "3": {"remove": true}},
                       "added": [{"id": 50, "body": {"file": "car.ply"}, "track": [
                                   {"time_s": 0, "position_m": [14, 0, 0.7]},
                                   {"time_s": 2, "position_m": [30, 0, 0.7]}]}]})");
  EXPECT_GT(changed(rendered(run, {"--edit", edit}), none), 300);
  EXPECT_EQ(rendered(run, {}).rgb, all.rgb) << "the run is as it was";
  for (const std::vector<std::string>& wrong : std::vector<std::vector<std::string>>{
           {"--actors", "5", "--to", "splat-ply"}, {"--actors", "2", "--to", "las"}}) {
    std::vector<std::string> arguments = {"export", run.string(), (folder_ / "no.ply").string()};
    arguments.insert(arguments.end(), wrong.begin(), wrong.end());
    EXPECT_EQ(redrive(arguments).exit_code, kExitUsage) << wrong[3];
    EXPECT_FALSE(fs::exists(folder_ / "no.ply"));
  }

  // LiDAR sees them.
  const auto scan = [&](const std::string& actors) {
    const ProgramResult scanned =
        redrive({"render", "lidar", run.string(), "--frame", "1012", "--actors", actors, "--out",
                 (folder_ / "scan.bin").string(), "--force"});
    EXPECT_EQ(scanned.exit_code, kExitOk) << scanned.err;
    return read_file(folder_ / "scan.bin");
  };
  EXPECT_NE(scan("all"), scan("none"));

  const ProgramResult figures =
      redrive({"figures", run.string(), "--max-images", "2", "--threads", "2"});
  ASSERT_EQ(figures.exit_code, kExitOk) << figures.err;
  const std::string page = read_file(run / "report.html");
  EXPECT_THAT(page, HasSubstr("<h3>Moving objects</h3>"));
  EXPECT_THAT(page, HasSubstr("CAR 2"));
  EXPECT_THAT(page, HasSubstr("this run, on moving objects"));

  write_file(edit, R"({"actors": {"5": {"remove": true}}})");
  const ProgramResult unknown =
      redrive({"render", run.string(), "--camera", kTrafficCamera, "--frame", "1012", "--edit",
               edit, "--out", folder_ / "no.png"});
  EXPECT_EQ(unknown.exit_code, kExitBadInput);
  EXPECT_THAT(unknown.err, HasSubstr("there are 2, 3"));
  EXPECT_FALSE(fs::exists(folder_ / "no.png"));

  const ProgramResult shown = redrive({"view", run.string(), "--edit", edit});
  if (shown.err.find("this build has no page") != std::string::npos)
    GTEST_SKIP() << "the build had no node or npm";
  EXPECT_EQ(shown.exit_code, kExitBadInput);
  EXPECT_THAT(shown.err, HasSubstr("there are 2, 3"));
  EXPECT_EQ(redrive({"view", run.string(), "--actors", "5"}).exit_code, kExitUsage);
  EXPECT_EQ(redrive({"view", REDRIVE_SAMPLES "/street_traffic", "--actors", "none"}).exit_code,
            kExitUsage);
}

TEST_F(Traffic, InspectListsObjects) {
  const std::string recording = REDRIVE_SAMPLES "/street_traffic";
  const ProgramResult table = redrive({"inspect", recording, "--actors"});
  EXPECT_EQ(table.exit_code, kExitOk) << table.err;
  EXPECT_THAT(table.out, HasSubstr("parked"));
  const ProgramResult ended = redrive({"inspect", recording, "--objects", "--json"});
  const nlohmann::json objects = nlohmann::json::parse(ended.out).at("objects");
  ASSERT_EQ(objects.size(), 3u);
  EXPECT_EQ(objects[1].at("id"), 2);
  EXPECT_EQ(objects[1].at("type"), "CAR");
  EXPECT_EQ(objects[1].at("moves"), true);
  EXPECT_EQ(objects[1].at("boxes"), 24);
  EXPECT_GT(objects[1].at("distance_m"), 3);
  EXPECT_GT(objects[1].at("images"), 20);
  const ProgramResult one = redrive({"inspect", recording, "--actors=2", "--json"});
  EXPECT_EQ(nlohmann::json::parse(one.out).at("objects").size(), 1u);
  EXPECT_EQ(redrive({"inspect", recording, "--actors=99"}).exit_code, kExitUsage);
  EXPECT_TRUE(
      nlohmann::json::parse(redrive({"inspect", recording, "--json"}).out).at("objects").is_null());
}

TEST_F(Traffic, TheReportOfARecordingShowsItsObjects) {
  const fs::path report = folder_ / "check";
  const ProgramResult ended = redrive({"inspect", REDRIVE_SAMPLES "/street_traffic", "--frames",
                                       "1000:1011", "--report", report.string()});
  ASSERT_TRUE(fs::exists(report / "index.html")) << ended.err;
  const std::string page = read_file(report / "index.html");
  EXPECT_THAT(page, HasSubstr("<h2>Objects</h2>"));
  EXPECT_THAT(page, HasSubstr("parked"));
  const Image8 boxes = read_image(report / ("objects_" + std::string(kTrafficCamera) + ".jpg"));
  int orange = 0;
  for (std::size_t i = 0; i < boxes.rgb.size(); i += 3)
    orange += boxes.rgb[i] > 200 && boxes.rgb[i + 1] > 90 && boxes.rgb[i + 1] < 190 &&
              boxes.rgb[i + 2] < 90;
  EXPECT_GT(orange, 200);
  EXPECT_TRUE(fs::exists(report / "figures" / "objects_above.png"));
}

TEST_F(Traffic, MovingObjectsAreMaskedWithoutActors) {
  const fs::path run = train("masked", 20, {"--set", "actors=0"});
  const ProgramResult scored = redrive({"eval", run.string(), "--json"});
  ASSERT_EQ(scored.exit_code, kExitOk) << scored.err;
  const nlohmann::json json = nlohmann::json::parse(scored.out);
  EXPECT_GT(json.at("overall").at("masked_pixels"), 1000);
  EXPECT_EQ(json.at("moving").at("outside"), json.at("overall"));
  EXPECT_EQ(rendered(run, {}).rgb, rendered(run, {"--actors", "none"}).rgb);
  const fs::path edit = folder_ / "edit.json";
  write_file(edit, R"({"added": [{"id": 1, "body": {"file": "a.ply"}, "track": [
                        {"time_s": 0, "position_m": [0, 0, 0]},
                        {"time_s": 1, "position_m": [1, 0, 0]}]}]})");
  const ProgramResult added =
      redrive({"render", run.string(), "--camera", kTrafficCamera, "--frame", "1012", "--edit",
               edit, "--out", folder_ / "no.png"});
  EXPECT_EQ(added.exit_code, kExitBadInput);
  EXPECT_THAT(added.err, HasSubstr("draws no moving objects"));
}

}  // namespace
}  // namespace redrive::testing

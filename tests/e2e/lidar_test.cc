// SPDX-License-Identifier: Apache-2.0
// Drives with LiDAR and annotated vehicles.
#include <array>
#include <cmath>
#include <cstdio>
#include <fstream>

#include "redrive/base/files/files.h"
#include "redrive/train/run.h"
#include "tests/e2e/same_end.h"

namespace redrive::testing {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

class EndToEndLidar : public EndToEnd {
 protected:
  EndToEndLidar() {
    fs::copy(fs::path(REDRIVE_SAMPLES) / "street_traffic", street_, fs::copy_options::recursive);
  }
  ProgramResult train(const std::string& name, int steps = 3,
                      const std::vector<std::string>& more = {}) const {
    std::vector<std::string> arguments = {"train",       street_.string(),
                                          "--out",       (folder_ / name).string(),
                                          "--downscale", "8",
                                          "--frames",    "1000:1003",
                                          "--method",    "grid",
                                          "--batch",     "64",
                                          "--max-steps", std::to_string(steps),
                                          "--threads",   "2"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return redrive(arguments);
  }
  fs::path revolution() const {
    return street_ / "dynamic" / "raw-revolutions" / "frame_0001001.las";
  }
  fs::path boxes() const { return street_ / "dynamic" / "box" / "3d_body" / "frame_0001001.json"; }

  const fs::path street_ = folder_ / "street";
};

TEST_F(EndToEndLidar, LidarTrainsAndResumes) {
  const ProgramResult once = train("once", 6);
  ASSERT_EQ(once.exit_code, kExitOk) << once.err;
  EXPECT_THAT(once.out, AllOf(HasSubstr("LiDAR returns"), HasSubstr("moving objects masked")));
  ASSERT_EQ(train("again", 6).exit_code, kExitOk);
  const auto parameters = [&](const char* name) {
    const TrainState state = load_checkpoint(folder_ / name / "checkpoint.safetensors");
    const std::span<const float> all = state.model->parameters.span();
    return std::vector<float>(all.begin(), all.end());
  };
  EXPECT_EQ(parameters("once"), parameters("again"));
  ASSERT_EQ(train("without", 6, {"--lidar-rays", "0"}).exit_code, kExitOk);
  EXPECT_NE(parameters("once"), parameters("without"));
  const ProgramResult resumed =
      redrive({"resume", (folder_ / "once").string(), "--max-steps", "8"});
  EXPECT_EQ(resumed.exit_code, kExitOk) << resumed.err;
  EXPECT_NE(parameters("once"), parameters("again"));
}

// With Gaussians flattened onto planes of returns, images whose height is no multiple of a tile's,
// and a number of Gaussians that changes.
TEST_F(EndToEndLidar, SplatsKilledAndResumedEndAsUninterrupted) {
  const auto arguments = [&](const fs::path& run) {
    return std::vector<std::string>{"train",
                                    street_.string(),
                                    "--out",
                                    run.string(),
                                    "--downscale",
                                    "4",
                                    "--frames",
                                    "1000:1007",
                                    "--max-seconds",
                                    "0",
                                    "--max-steps",
                                    "360",
                                    "--threads",
                                    "2",
                                    "--max-gaussians",
                                    "20000",
                                    "--checkpoint-every",
                                    "70"};
  };
  const fs::path whole = folder_ / "whole", parts = folder_ / "parts";
  ASSERT_EQ(redrive(arguments(whole)).exit_code, kExitOk);
  expect_same_end_when_killed(whole, parts, arguments(parts), {3, 6});
}

// The terminal, the report and eval's JSON show the same numbers.
TEST_F(EndToEndLidar, ReportsTheSameRefinedPosesEverywhere) {
  const ProgramResult trained = train("run", 12);
  ASSERT_EQ(trained.exit_code, kExitOk) << trained.err;
  const std::string run = (folder_ / "run").string();
  const ProgramResult scored = redrive({"eval", run, "--json", "--max-images", "1"});
  ASSERT_EQ(scored.exit_code, kExitOk) << scored.err;
  const nlohmann::json changes = nlohmann::json::parse(scored.out).at("pose_changes");
  const ProgramResult drawn = redrive({"figures", run, "--max-images", "1"});
  ASSERT_EQ(drawn.exit_code, kExitOk) << drawn.err;
  for (const char* plot : {"poses_moved.png", "poses_turned.png"})
    EXPECT_TRUE(fs::exists(folder_ / "run" / "figures" / plot)) << plot;
  const std::string html = read_file(folder_ / "run" / "report.html");
  EXPECT_THAT(html, HasSubstr("<h2>Poses</h2>\n<p>As recorded. Training refined"));
  const auto text = [](const char* format, double value) {
    char out[40];
    std::snprintf(out, sizeof out, format, value);
    return std::string(out);
  };
  for (const char* camera : {"F_MIDLONGRANGECAM_CL", "F_MIDRANGECAM_C"}) {
    const nlohmann::json& change = changes.at("cameras").at(camera);
    const auto m = change.at("translation_m").get<std::array<double, 3>>();
    const double moved_cm = 100 * std::hypot(m[0], m[1], m[2]);
    EXPECT_GT(moved_cm, 0.005) << "too small to compare";
    EXPECT_THAT(trained.out, HasSubstr(camera + text(": by %.1f cm", moved_cm)));
    EXPECT_THAT(html, HasSubstr("\">" + text("%.2f", moved_cm) + "</td><td "));
  }
  const double frames_cm = 100 * changes.at("frames").at("translation_m").get<double>();
  EXPECT_THAT(trained.out, HasSubstr(text("frames by %.1f cm", frames_cm)));
  EXPECT_THAT(html, HasSubstr("\">" + text("%.2f", frames_cm) + "</td><td "));
}

TEST_F(EndToEndLidar, LeavesOutATruncatedRevolution) {
  fs::resize_file(revolution(), fs::file_size(revolution()) / 2);
  const ProgramResult ended = train("run");
  EXPECT_EQ(ended.exit_code, kExitOk) << ended.err;
  EXPECT_THAT(ended.out, AllOf(HasSubstr("lidar: 1 of "), HasSubstr("frame_0001001.las")));
}

TEST_F(EndToEndLidar, LeavesOutBoxesWithoutATime) {
  std::string text = read_file(boxes());
  const std::size_t at = text.find("\"Timestamp\"");
  ASSERT_NE(at, std::string::npos);
  text.replace(at, 11, "\"Timestomp\"");
  std::ofstream(boxes()) << text;
  const ProgramResult ended = train("run");
  EXPECT_EQ(ended.exit_code, kExitOk) << ended.err;
  EXPECT_THAT(ended.out, AllOf(HasSubstr("boxes: 1 of "), HasSubstr("frame_0001001.json"),
                               HasSubstr("Timestamp")));
}

}  // namespace
}  // namespace redrive::testing

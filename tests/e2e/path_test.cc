// SPDX-License-Identifier: Apache-2.0
// redrive render path on a small run.
#include <signal.h>

#include <chrono>
#include <cstdlib>
#include <thread>

#include <nlohmann/json.hpp>

#include "redrive/image/image_io.h"
#include "redrive/image/video.h"
#include "tests/e2e/end_to_end.h"

namespace redrive::testing {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

class Path : public EndToEnd {
 protected:
  ProgramResult rendered(std::vector<std::string> more,
                         std::optional<std::size_t> file_limit_bytes = {}) const {
    more.insert(more.begin(), {"render", "path", run_.string()});
    return redrive(more, file_limit_bytes);
  }
  int image(std::vector<std::string> more) const {
    more.insert(more.begin(), {"render", run_.string(), "--camera", kTinyLeft});
    return redrive(more).exit_code;
  }
  const fs::path run_ = trained("run", 5), out_ = folder_ / "path", file_ = folder_ / "path.json";
};

TEST_F(Path, StartsAndEndsAtItsKeyframes) {
  write_file(file_, nlohmann::json{{"keyframes",
                                    {{{"time_s", 0}, {"camera", kTinyLeft}, {"frame_id", 100}},
                                     {{"time_s", 0.2},
                                      {"camera", kTinyLeft},
                                      {"frame_id", 102},
                                      {"shift_body_m", {0, 0.5, 0}},
                                      {"yaw_deg", 10}}}}}
                        .dump());
  const ProgramResult ended = rendered({file_, "--out", out_});
  ASSERT_EQ(ended.exit_code, kExitOk) << ended.err;
  EXPECT_THAT(ended.out, HasSubstr("5 images, 44 x 36, 24 a second"));
  const fs::path first = folder_ / "first.png", last = folder_ / "last.png";
  ASSERT_EQ(image({"--frame", "100", "--out", first}), 0);
  ASSERT_EQ(image({"--frame", "102", "--translate", "0,0.5,0", "--yaw", "10", "--out", last}), 0);
  EXPECT_EQ(read_file(out_ / "000000.png"), read_file(first));
  EXPECT_EQ(read_file(out_ / "000004.png"), read_file(last));

  const auto before = contents(folder_);
  EXPECT_EQ(rendered({file_, "--out", out_}).exit_code, kExitUsage);
  EXPECT_EQ(rendered({file_, "--out", folder_, "--force"}).exit_code, kExitUsage)
      << "a folder with other files";
  EXPECT_EQ(rendered({file_, "--out", out_, "--force"}, 1000).exit_code, kExitIo);
  EXPECT_EQ(contents(folder_), before) << "nothing half-written";
  ASSERT_EQ(
      rendered({file_, "--out", out_, "--force", "--fps", "10", "--camera", kTinyFront}).exit_code,
      kExitOk);
  EXPECT_EQ(contents(out_).size(), 3u) << "two images and the mark of the folder";
  EXPECT_EQ(read_image(out_ / "000001.png").width, 48);
}

TEST_F(Path, TakesTheLensOfNerfstudiosFile) {
  const nlohmann::json camera = {
      {"camera_to_world", {0, 0, -1, 1, -1, 0, 0, 0, 0, 1, 0, 1, 0, 0, 0, 1}}, {"fov", 60}};
  nlohmann::json path = {{"render_width", 30},
                         {"render_height", 20},
                         {"fps", 10},
                         {"camera_path", {camera, camera, camera}}};
  write_file(file_, path.dump());
  const ProgramResult ended = rendered({file_, "--out", out_});
  ASSERT_EQ(ended.exit_code, kExitOk) << ended.err;
  EXPECT_THAT(ended.out, HasSubstr("3 images, 30 x 20, 10 a second, 0.30 s"));
  EXPECT_EQ(read_image(out_ / "000002.png").width, 30);

  path["camera_path"][1]["fov"] = 0;
  write_file(file_, path.dump());
  const ProgramResult bad = rendered({file_, "--out", folder_ / "other"});
  EXPECT_EQ(bad.exit_code, kExitBadInput);
  EXPECT_THAT(bad.err, AllOf(HasSubstr(file_.string()), HasSubstr("camera_path[1].fov = 0")));
}

TEST_F(Path, WritesAVideoOfTheDrive) {
  if (const auto obstacle = video_obstacle()) GTEST_SKIP() << *obstacle;
  const fs::path video = folder_ / "drive.mp4";
  const auto before = contents(folder_);
  EXPECT_EQ(rendered({"drive", "--out", video}, 1000).exit_code, kExitIo);
  EXPECT_EQ(contents(folder_), before) << "nothing half-written";
  ASSERT_EQ(rendered({"drive", "--seconds", "1.5", "--out", video}).exit_code, kExitOk);
  const std::string drive = read_file(video);
  EXPECT_EQ(rendered({"sideways:1", "--out", video}).exit_code, kExitUsage);
  EXPECT_EQ(read_file(video), drive);
  ASSERT_EQ(rendered({"sideways:1", "--camera", kTinyRear, "--fps", "20", "--seconds", "0.5",
                      "--out", video, "--force"})
                .exit_code,
            kExitOk);
  if (std::system("ffprobe -version >/dev/null 2>&1") != 0)
    GTEST_SKIP() << "there is no ffprobe (Debian package ffmpeg)";
  const fs::path probed = folder_ / "probed.json";
  ASSERT_EQ(std::system(("ffprobe -v error -count_frames -show_streams -of json " + video.string() +
                         " > " + probed.string())
                            .c_str()),
            0);
  const nlohmann::json stream = read_json(probed).at("streams").at(0);
  EXPECT_EQ(stream.at("nb_read_frames"), "10");
  EXPECT_EQ(stream.at("avg_frame_rate"), "20/1");
  EXPECT_EQ(stream.at("width"), 40);
  EXPECT_EQ(stream.at("height"), 24);
  EXPECT_NEAR(std::stod(stream.at("duration").get<std::string>()), 0.5, 1e-3);
}

TEST_F(Path, CtrlCLeavesNothing) {
  const auto before = contents(folder_);
  Program program(REDRIVE_BINARY, {"render", "path", run_.string(), "drive", "--seconds", "600",
                                   "--out", out_.string()});
  for (int i = 0; i < 6000 && !fs::exists(folder_ / ".path.redrive-tmp/000001.png"); ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  program.send(SIGINT);
  const ProgramResult ended = program.wait();
  EXPECT_EQ(ended.exit_code, kExitInterrupted);
  EXPECT_THAT(ended.err, HasSubstr("nothing written"));
  EXPECT_EQ(contents(folder_), before);
}

TEST_F(Path, RefusesOtherOutputsAndOptions) {
  for (const std::vector<std::string>& arguments :
       std::vector<std::vector<std::string>>{{"drive", "--out", folder_ / "a.avi"},
                                             {"drive", "--out", folder_ / "no" / "a.mp4"},
                                             {"sideways:x", "--out", out_},
                                             {"drive", "--out", out_, "--fps", "0"},
                                             {"drive", "--out", out_, "--camera", "NONE"},
                                             {"drive", "--out", out_, "--frame", "100"}}) {
    const ProgramResult ended = rendered(arguments);
    EXPECT_EQ(ended.exit_code, kExitUsage) << ended.out << ended.err;
  }
  EXPECT_EQ(rendered({"missing.json", "--out", out_}).exit_code, kExitBadInput);
  EXPECT_FALSE(fs::exists(out_));
}

}  // namespace
}  // namespace redrive::testing

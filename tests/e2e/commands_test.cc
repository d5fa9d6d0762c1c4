// SPDX-License-Identifier: Apache-2.0
// Every command on a small run, and the files that it writes.
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <csignal>

#include <nlohmann/json.hpp>

#include "redrive/image/image_io.h"
#include "redrive/methods/nerf/nerf_model.h"
#include "redrive/train/run.h"
#include "tests/e2e/end_to_end.h"

namespace redrive::testing {
namespace {

using ::testing::ContainsRegex;
using ::testing::HasSubstr;
using ::testing::MatchesRegex;
using ::testing::Not;

TEST_F(EndToEnd, HelpAndVersionSucceed) {
  EXPECT_EQ(redrive({"--help"}).exit_code, kExitOk);
  EXPECT_THAT(redrive({"--version"}).out, HasSubstr("redrive"));
  const ProgramResult help = redrive({"train", "--help"});
  EXPECT_EQ(help.exit_code, kExitOk);
  for (const TrainField& field : train_fields())
    EXPECT_THAT(help.out, HasSubstr(field.name == "recording" ? "RECORDING" : "--" + field.name));
}

// srun without an --mpi that this MPI knows: there, joining the other tasks is an error.
TEST_F(EndToEnd, HelpAndVersionNeedNoMpi) {
  ASSERT_EQ(::setenv("SLURM_STEP_NUM_TASKS", "2", 1), 0);
  ASSERT_EQ(::setenv("SLURM_STEP_ID", "0", 1), 0);
  for (const char* option : {"--help", "--version"}) {
    ASSERT_EQ(::setenv("SLURM_PROCID", "0", 1), 0);
    const ProgramResult first = redrive({option});
    EXPECT_EQ(first.exit_code, kExitOk) << first.err;
    EXPECT_THAT(first.out, HasSubstr("redrive"));
    ASSERT_EQ(::setenv("SLURM_PROCID", "1", 1), 0);
    const ProgramResult second = redrive({option});
    EXPECT_EQ(second.exit_code, kExitOk) << second.err;
    EXPECT_EQ(second.out, "") << "once";
  }
  for (const char* name : {"SLURM_STEP_NUM_TASKS", "SLURM_STEP_ID", "SLURM_PROCID"})
    ASSERT_EQ(::unsetenv(name), 0);
}

TEST_F(EndToEnd, DoctorListsGpusOrSaysWhyThereAreNone) {
  const ProgramResult found = redrive({"doctor"}), json = redrive({"doctor", "--json"});
  EXPECT_EQ(found.exit_code, kExitOk) << found.err;
  EXPECT_THAT(found.out, ContainsRegex("\ngpu 0  .* Vulkan 1\\.|\ngpu          no: "));
  EXPECT_THAT(found.out, ContainsRegex("passes the self-test|cannot be used|gpu          no: "));
  EXPECT_TRUE(nlohmann::json::parse(json.out).at("gpus").at("devices").is_array());
  ASSERT_EQ(::setenv("VK_ICD_FILENAMES", "/nowhere.json", 1), 0);
  const ProgramResult none = redrive({"doctor"});
  EXPECT_EQ(none.exit_code, kExitOk) << none.err;
  EXPECT_THAT(none.out, HasSubstr("\ngpu          no: "));
  ASSERT_EQ(::unsetenv("VK_ICD_FILENAMES"), 0);
}

TEST_F(EndToEnd, TrainWritesACompleteRunAndPrintsProgress) {
  const fs::path run = folder_ / "run";
  const ProgramResult ended = redrive(
      train_arguments(run, {"--epochs", "100", "--max-steps", "60", "--holdout-every", "4"}));
  ASSERT_EQ(ended.exit_code, kExitOk) << ended.err;
  EXPECT_THAT(ended.out, HasSubstr("backend="));
  EXPECT_THAT(ended.out, HasSubstr(std::string(kTinyLeft) + ": mei, 44 x 36"));
  EXPECT_THAT(ended.out, HasSubstr("4 frames, 9 images for training, 3 held out"));
  EXPECT_THAT(ended.err,
              ContainsRegex("step [0-9]+/60  loss [0-9.]+  [0-9.]+ dB  [0-9]+ rays/s  ETA"));
  EXPECT_THAT(ended.out + ended.err, Not(HasSubstr("\r"))) << "piped output has plain lines";
  EXPECT_TRUE(fs::exists(run / "checkpoint.safetensors"));
  EXPECT_EQ(read_json(run / "config.json").at("width"), 32);
  EXPECT_EQ(read_json(run / "config.json").at("max-steps"), 60);
  EXPECT_EQ(read_metrics({run}).back().step, 60);
}

TEST_F(EndToEnd, OrderOfFlagsDoesNotMatter) {
  const std::string drive = drive_.string(), a = (folder_ / "a").string(),
                    b = (folder_ / "b").string();
  ASSERT_EQ(redrive({"train", drive, "--out", a, "--preset", "report-2", "--width", "32", "--batch",
                     "32", "--max-steps", "2"})
                .exit_code,
            0);
  ASSERT_EQ(redrive({"train", "--max-steps", "2", "--batch", "32", "--width", "32", "--preset",
                     "report-2", "--out", b, drive})
                .exit_code,
            0);
  EXPECT_EQ(read_file(folder_ / "a/config.json"), read_file(folder_ / "b/config.json"));
  const nlohmann::json config = read_json(folder_ / "a/config.json");
  EXPECT_EQ(config.at("cameras"), (std::vector<std::string>{kTinyFront, kTinyRear}));
  EXPECT_EQ(config.at("samples"), 48);
  EXPECT_EQ(config.at("width"), 32);
}

TEST_F(EndToEnd, EvalScoresACameraThatWasNotTrainedOn) {
  const std::string run = trained("front", 5, {"--cameras", kTinyFront}).string();
  const ProgramResult ended = redrive({"eval", run, "--cameras", kTinyRear});
  ASSERT_EQ(ended.exit_code, kExitOk) << ended.err;
  EXPECT_THAT(ended.out, HasSubstr("camera not trained on"));
  EXPECT_THAT(ended.out, HasSubstr(std::string(kTinyRear) + ": after gains of"));
  const ProgramResult json = redrive({"eval", run, "--cameras", kTinyRear, "--all", "--json"});
  EXPECT_EQ(nlohmann::json::parse(json.out)["other_cameras"][kTinyRear]["images"], 4);
  const ProgramResult refused = redrive({"eval", run, "--cameras", kTinyFront});
  EXPECT_EQ(refused.exit_code, kExitUsage);
  EXPECT_THAT(refused.err, HasSubstr("was trained on"));
}

TEST_F(EndToEnd, EvalScoresALongerRunHigher) {
  const auto scores = [&](const fs::path& run) {
    const ProgramResult ended = redrive({"eval", run.string(), "--json"});
    EXPECT_EQ(ended.exit_code, kExitOk) << ended.err;
    return nlohmann::json::parse(ended.out);
  };
  const std::vector<std::string> holdout = {"--holdout-every", "4"};
  const nlohmann::json before = scores(trained("short", 1, holdout)),
                       after = scores(trained("long", 500, holdout));
  EXPECT_EQ(after.at("overall").at("images"), 3);
  for (const char* camera : {kTinyFront, kTinyRear, kTinyLeft}) {
    EXPECT_EQ(after.at("cameras").at(camera).at("images"), 1);
    // A tenfold smaller squared error is 10 dB; each camera has to gain half of that.
    EXPECT_GT(after["cameras"][camera]["psnr_db"].get<double>(),
              before["cameras"][camera]["psnr_db"].get<double>() + 5)
        << camera;
    EXPECT_GT(after["cameras"][camera]["ssim"].get<double>(),
              before["cameras"][camera]["ssim"].get<double>())
        << camera;
  }
}

TEST_F(EndToEnd, RendersAMountOfOnesOwn) {
  const fs::path run = trained("run", 3);
  for (const auto& [lens, width] : {std::pair("pinhole:90:64x48", 64), std::pair(kTinyLeft, 44)}) {
    const fs::path image = folder_ / (std::to_string(width) + ".png");
    const ProgramResult ended =
        redrive({"render", "mount", run.string(), "--mount=-1,0,1.5,180,-5,0", "--lens", lens,
                 "--frame", "101", "--translate", "0,0.5,0", "--out", image.string()});
    ASSERT_EQ(ended.exit_code, kExitOk) << ended.err;
    EXPECT_EQ(read_image(image).width, width);
  }
}

TEST_F(EndToEnd, RendersOneViewWithDepthOpacityAndNormals) {
  const fs::path run = trained("run", 20), image = folder_ / "a.png", depth = folder_ / "d.png",
                 opacity = folder_ / "o.png", normals = folder_ / "n.png";
  const ProgramResult ended =
      redrive({"render", run.string(), "--camera", kTinyLeft, "--frame", "101", "--translate",
               "0,-0.5,0", "--axes", "local", "--out", image.string(), "--depth", depth.string(),
               "--opacity", opacity.string(), "--normals", normals.string()});
  ASSERT_EQ(ended.exit_code, kExitOk) << ended.err;
  const Image8 rendered = read_image(image);
  EXPECT_EQ(rendered.width, 44);
  EXPECT_EQ(rendered.height, 36);
  const Image16 depth_mm = read_png16(depth);
  EXPECT_THAT(depth_mm.values, ::testing::Each(::testing::Le(10001)));  // sum w t <= far
  EXPECT_EQ(depth_mm.width, 44);
  for (const fs::path& file : {opacity, normals}) {
    const Image8 more = read_image(file);
    EXPECT_EQ(more.width, 44);
    EXPECT_EQ(more.height, 36);
    EXPECT_NE(std::ranges::max(more.rgb), 0) << file;
  }
}

TEST_F(EndToEnd, ViewServesARunUntilCtrlC) {
  const fs::path run = trained("run", 2);
  EXPECT_EQ(redrive({"view", (folder_ / "no_run").string()}).exit_code, kExitBadInput);
  EXPECT_EQ(redrive({"view", run.string(), "--port", "70000"}).exit_code, kExitUsage);
  const auto before = contents(run);
  const ProgramResult refused = redrive({"view", run.string(), "--listen", "nowhere"});
  if (refused.err.find("this build has no page") != std::string::npos)
    GTEST_SKIP() << "the build had no node or npm";
  EXPECT_EQ(refused.exit_code, kExitUsage) << refused.err;
  Program program(REDRIVE_BINARY, {"view", run.string(), "--port", "0", "--threads", "1"});
  ASSERT_TRUE(program.wait_for_output("Ctrl-C ends"));
  program.send(SIGINT);
  const ProgramResult ended = program.wait();
  EXPECT_EQ(ended.exit_code, kExitOk) << ended.err;
  EXPECT_THAT(ended.out, HasSubstr("http://127.0.0.1:"));
  EXPECT_EQ(contents(run), before) << "nothing is written";
  Program recording(REDRIVE_BINARY, {"view", drive_.string(), "--port", "0"});
  ASSERT_TRUE(recording.wait_for_output("Ctrl-C ends"));
  recording.send(SIGTERM);
  EXPECT_EQ(recording.wait().exit_code, kExitOk);
}

TEST_F(EndToEnd, ResumeShowsTheRunUntilCtrlC) {
  const fs::path run = trained("run", 2);
  const std::vector<std::string> resume = {"resume", run.string(), "--max-steps", "4"};
  const auto with = [&](std::vector<std::string> more) {
    more.insert(more.begin(), resume.begin(), resume.end());
    return more;
  };
  const ProgramResult alone = redrive(with({"--open"}));
  EXPECT_EQ(alone.exit_code, kExitUsage);
  EXPECT_THAT(alone.err, HasSubstr("--view"));
  const ProgramResult refused = redrive(with({"--view", "--listen", "nowhere"}));
  if (refused.err.find("this build has no page") != std::string::npos)
    GTEST_SKIP() << "the build had no node or npm";
  EXPECT_EQ(refused.exit_code, kExitUsage) << refused.err;
  EXPECT_THAT(refused.err, HasSubstr("nowhere"));
  Program program(REDRIVE_BINARY, with({"--view", "--port", "0", "--listen", "127.0.0.2"}));
  ASSERT_TRUE(program.wait_for_output("Ctrl-C ends"));
  program.send(SIGINT);
  const ProgramResult ended = program.wait();
  EXPECT_THAT(ended.out, HasSubstr("http://127.0.0.2:"));
}

TEST_F(EndToEnd, TrainLeavesNoRunWhereItsPortIsTaken) {
  const int taken = ::socket(AF_INET, SOCK_STREAM, 0);
  sockaddr_in address = {.sin_family = AF_INET, .sin_addr = {htonl(INADDR_LOOPBACK)}};
  socklen_t size = sizeof(address);
  auto* const any = reinterpret_cast<sockaddr*>(&address);
  ASSERT_EQ(::bind(taken, any, size), 0);
  ASSERT_EQ(::listen(taken, 1), 0);
  ASSERT_EQ(::getsockname(taken, any, &size), 0);
  const ProgramResult refused = redrive(train_arguments(
      folder_ / "run", {"--view", "--port", std::to_string(ntohs(address.sin_port))}));
  ::close(taken);
  EXPECT_EQ(refused.exit_code, kExitUsage) << refused.err;
  EXPECT_FALSE(fs::exists(folder_ / "run"));
}

TEST_F(EndToEnd, RendersTheImagesOfAPosesFile) {
  const fs::path run = trained("run", 20), poses = folder_ / "poses.json", out = folder_ / "novel";
  const nlohmann::json pose = read_json(tiny_egomotion(drive_)).at("102").at("RT_ECEF_body");
  write_file(poses, nlohmann::json{{"images",
                                    {{{"file", "x/absolute.png"},
                                      {"camera", kTinyFront},
                                      {"frame_id", 100},
                                      {"RT_ECEF_body", pose}},
                                     {{"file", "frame.png"},
                                      {"camera", kTinyFront},
                                      {"frame_id", 102},
                                      {"shift_body_m", {0, 0, 0}}},
                                     {{"file", "shifted.jpg"},
                                      {"camera", kTinyRear},
                                      {"frame_id", 100},
                                      {"shift_body_m", {0, 1, 0}}}}}}
                        .dump());
  const ProgramResult ended =
      redrive({"render", "poses", run.string(), poses.string(), "--out", out.string()});
  ASSERT_EQ(ended.exit_code, kExitOk) << ended.err;
  // The absolute pose is frame 102's: the same image as frame 102 without a shift.
  EXPECT_EQ(read_image(out / "x/absolute.png").rgb, read_image(out / "frame.png").rgb);
  EXPECT_EQ(read_image(out / "shifted.jpg").width, 40);
}

TEST_F(EndToEnd, FiguresAndReport) {
  const fs::path run = trained("run", 60);
  const ProgramResult ended = redrive({"figures", run.string()});
  ASSERT_EQ(ended.exit_code, kExitOk) << ended.err;
  EXPECT_THAT(ended.out, MatchesRegex((run / "report.html").string() +
                                      ": PSNR [0-9.]+ dB, SSIM [0-9.]+, FLIP [0-9.]+ on [0-9]+ "
                                      "training images\n"))
      << "one line";
  for (const std::string camera : {kTinyFront, kTinyRear, kTinyLeft})
    for (const char* figure : {"_original.png", "_reproduced.png", "_perturbed.png",
                               "_perturbed_camera_axes.png", "_depth.png"})
      EXPECT_GT(read_image(run / "figures" / (camera + figure)).width, 0);
  EXPECT_GT(read_image(run / "figures/loss.png").width, 0);
  const std::string html = read_file(run / "report.html");
  EXPECT_THAT(html, HasSubstr("data:image/png;base64,"));
  EXPECT_THAT(html, HasSubstr("No frame was held out"));
  EXPECT_THAT(html, HasSubstr("As recorded. Not refined by training."));
  EXPECT_THAT(html, Not(ContainsRegex("(src|href)=\"(https?:)?//"))) << "self-contained";
}

TEST_F(EndToEnd, FiguresCompareTwoRunsOfARecording) {
  const fs::path run = trained("run", 3), other = trained("other", 3);
  const ProgramResult ended =
      redrive({"figures", run.string(), "--max-images", "1", "--compare", other.string()});
  ASSERT_EQ(ended.exit_code, kExitOk) << ended.err;
  // The same options and seed: the same image.
  const std::string camera = kTinyFront;
  EXPECT_EQ(read_image(run / "figures" / (camera + "_beside.png")).rgb,
            read_image(run / "figures" / (camera + "_reproduced.png")).rgb);
  EXPECT_THAT(read_file(run / "report.html"), HasSubstr("<th>PSNR of nerf, 0.0 min</th>"));

  write_tiny_recording(folder_ / "other_drive");
  std::vector<std::string> arguments = train_arguments(folder_ / "elsewhere");
  *std::ranges::find(arguments, drive_.string()) = (folder_ / "other_drive").string();
  arguments.insert(arguments.end(), {"--max-steps", "3"});
  ASSERT_EQ(redrive(arguments).exit_code, kExitOk);
  const ProgramResult refused =
      redrive({"figures", run.string(), "--compare", (folder_ / "elsewhere").string()});
  EXPECT_EQ(refused.exit_code, kExitUsage);
  EXPECT_THAT(refused.err, HasSubstr("--compare"));
}

TEST_F(EndToEnd, InspectListsTheRecording) {
  const ProgramResult text = redrive({"inspect", drive_.string()}),
                      json = redrive({"inspect", drive_.string(), "--json"});
  EXPECT_EQ(text.exit_code, kExitOk) << text.err;
  for (const char* camera : {kTinyFront, kTinyRear, kTinyLeft}) {
    EXPECT_THAT(text.out, HasSubstr(camera));
    EXPECT_THAT(json.out, HasSubstr(camera));
  }
  EXPECT_TRUE(nlohmann::json::accept(json.out));
}

TEST_F(EndToEnd, InspectWritesMasks) {
  const std::filesystem::path masks = folder_ / "masks";
  const ProgramResult ended = redrive({"inspect", drive_.string(), "--masks-out", masks.string()});
  ASSERT_EQ(ended.exit_code, kExitOk) << ended.err;
  EXPECT_THAT(ended.out, HasSubstr("mask of " + std::string(kTinyLeft)));
  EXPECT_EQ(read_image(masks / (std::string(kTinyFront) + ".png")).width, 48);
  EXPECT_EQ(read_image(masks / (std::string(kTinyFront) + "_overlay.png")).height, 32);
  const ProgramResult again = redrive({"inspect", drive_.string(), "--masks-out", masks.string()});
  EXPECT_EQ(again.exit_code, kExitUsage);
  EXPECT_THAT(again.err, HasSubstr("exists"));
}

TEST_F(EndToEnd, InspectReportsBeforeTraining) {
  const std::filesystem::path report = folder_ / "report";
  const ProgramResult ended =
      redrive({"inspect", drive_.string(), "--json", "--report", report.string()});
  ASSERT_TRUE(ended.exit_code == kExitOk || ended.exit_code == kExitPreflightFailed) << ended.err;
  const nlohmann::json preflight = nlohmann::json::parse(ended.out)["preflight"];
  EXPECT_EQ(preflight["sensible"].get<bool>(), ended.exit_code == kExitOk);
  EXPECT_EQ(preflight["cameras"].size(), 3u);
  EXPECT_EQ(preflight["cameras"][0].at("time_offset"), nullptr)
      << "unobservable from smooth colours";
  EXPECT_TRUE(preflight["cameras"][0].at("contrast").empty()) << "no LiDAR";
  const std::string html = read_file(report / "index.html");
  EXPECT_THAT(html, HasSubstr(preflight["cameras"][0]["why"].get<std::string>().substr(0, 12)));
  EXPECT_GT(read_image(report / (std::string(kTinyFront) + ".jpg")).width, 0);
  for (const char* plot :
       {"rig_above.png", "rig_side.png", "way_above.png", "way_side.png", "exposure.png"})
    EXPECT_EQ(read_image(report / "figures" / plot).width, 1000) << plot;
  const ProgramResult again = redrive({"inspect", drive_.string(), "--report", report.string()});
  EXPECT_EQ(again.exit_code, kExitUsage);
  EXPECT_THAT(again.err, HasSubstr("exists"));
}

TEST_F(EndToEnd, FineSamplesTrainASecondNetwork) {
  const TrainState state =
      load_checkpoint(trained("run", 3, {"--fine-samples", "8"}) / "checkpoint.safetensors");
  EXPECT_EQ(dynamic_cast<const NerfModel&>(*state.model).networks(), 2);
}

TEST_F(EndToEnd, UndistortedPinholesTrainToo) {
  trained("run", 3, {"--undistort", "--cameras", std::string(kTinyFront) + "," + kTinyRear});
}

}  // namespace
}  // namespace redrive::testing

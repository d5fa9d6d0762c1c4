// SPDX-License-Identifier: Apache-2.0
// Invalid input: checks the exit code, that the message names the fault, and that no file is
// written or overwritten.
#include <algorithm>
#include <functional>

#include <nlohmann/json.hpp>

#include "tests/e2e/end_to_end.h"

namespace redrive::testing {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;

struct BadDrive {
  const char* name;
  std::function<void(const fs::path& drive)> spoil;
  std::vector<std::string> message;  ///< parts of the message on stderr
};

void front(const fs::path& drive, const char* key, const json& value) {
  edit_json(tiny_calibration(drive),
            [&](json& calibration) { calibration[kTinyFront][key] = value; });
}

void pose(const fs::path& drive, const json& value) {
  edit_json(tiny_egomotion(drive),
            [&](json& egomotion) { egomotion["101"]["RT_ECEF_body"] = value; });
}

void overwrite(const fs::path& file, const std::string& bytes) { write_file(file, bytes); }

const json kMirror = {{0, 0, 1, 2}, {1, 0, 0, 0.1}, {0, -1, 0, 1.5}, {0, 0, 0, 1}};
const json kSheared = {{0, 0.3, 1, 2}, {-1, 0, 0, 0.1}, {0, -1, 0, 1.5}, {0, 0, 0, 1}};

std::vector<BadDrive> bad_drives() {
  return {
      {"no recording", [](const fs::path& d) { fs::remove_all(d); }, {"no such folder"}},
      {"empty recording",
       [](const fs::path& d) {
         fs::remove_all(d);
         fs::create_directory(d);
       },
       {"drive"}},
      {"no image", [](const fs::path& d) { fs::remove_all(d / "sensor/camera"); }, {"drive"}},
      {"calibration missing",
       [](const fs::path& d) { fs::remove(tiny_calibration(d)); },
       {"calibration"}},
      {"calibration no JSON",
       [](const fs::path& d) { overwrite(tiny_calibration(d), "{\"a\": "); },
       {"calibration.json"}},
      {"calibration a list",
       [](const fs::path& d) { overwrite(tiny_calibration(d), "[1]"); },
       {"calibration.json"}},
      {"NaN",
       [](const fs::path& d) {
         front(d, "focal_length_px", {nullptr, 38});
       },
       {"calibration.json", "focal_length_px", "null"}},
      {"NaN by name",
       [](const fs::path& d) { overwrite(tiny_calibration(d), "{\"F\": {\"xi\": NaN}}"); },
       {"calibration.json"}},
      {"focal length 0",
       [](const fs::path& d) {
         front(d, "focal_length_px", {0, 38});
       },
       {kTinyFront, "focal_length_px[0]", "0"}},
      {"distortion too short",
       [](const fs::path& d) {
         front(d, "distortion_coeffs", {0.1, 0});
       },
       {kTinyFront, "distortion_coeffs"}},
      {"extrinsic too small",
       [](const fs::path& d) {
         front(d, "RT_body_from_sensor", {{1, 0}, {0, 1}});
       },
       {kTinyFront, "RT_body_from_sensor"}},
      {"extrinsic no rotation",
       [](const fs::path& d) { front(d, "RT_body_from_sensor", kSheared); },
       {kTinyFront, "RT_body_from_sensor"}},
      {"extrinsic mirrors",
       [](const fs::path& d) { front(d, "RT_body_from_sensor", kMirror); },
       {kTinyFront, "RT_body_from_sensor", "det"}},
      {"extrinsic inverted",
       [](const fs::path& d) {
         edit_json(tiny_calibration(d), [](json& c) {
           std::swap(c[kTinyFront]["RT_body_from_sensor"], c[kTinyFront]["RT_sensor_from_body"]);
         });
       },
       {kTinyFront, "RT_body_from_sensor", "invert"}},
      {"unknown model",
       [](const fs::path& d) { front(d, "model", "kannala"); },
       {kTinyFront, "model", "kannala"}},
      {"egomotion missing",
       [](const fs::path& d) { fs::remove(tiny_egomotion(d)); },
       {"egomotion"}},
      {"egomotion no JSON",
       [](const fs::path& d) { overwrite(tiny_egomotion(d), "not json"); },
       {"egomotion2.json"}},
  };
}

/// Drives of which one record is damaged.
std::vector<BadDrive> damaged_drives() {
  return {
      {"pose too small",
       [](const fs::path& d) {
         pose(d, {1, 2, 3});
       },
       {"egomotion2.json", "101", "RT_ECEF_body"}},
      {"pose not a number",
       [](const fs::path& d) {
         pose(d, {{1, 0, 0, nullptr}, {0, 1, 0, 0}, {0, 0, 1, 0}, {0, 0, 0, 1}});
       },
       {"101", "RT_ECEF_body", "null"}},
      {"pose no rotation",
       [](const fs::path& d) {
         pose(d, {{2, 0, 0, 4e6}, {0, 1, 0, 1e6}, {0, 0, 1, 4e6}, {0, 0, 0, 1}});
       },
       {"101", "RT_ECEF_body"}},
      {"pose mirrors",
       [](const fs::path& d) {
         pose(d, {{-1, 0, 0, 4e6}, {0, 1, 0, 1e6}, {0, 0, 1, 4e6}, {0, 0, 0, 1}});
       },
       {"101", "RT_ECEF_body", "det"}},
      {"JPEG truncated",
       [](const fs::path& d) {
         const fs::path file = tiny_image(d, kTinyRear, 102);
         const std::string bytes = read_file(file);
         overwrite(file, bytes.substr(0, bytes.size() * 3 / 4));
       },
       {std::string(kTinyRear) + "_0000102.jpg"}},
      {"JPEG empty",
       [](const fs::path& d) { overwrite(tiny_image(d, kTinyRear, 102), ""); },
       {"_0000102.jpg"}},
      {"JPEG no image",
       [](const fs::path& d) { overwrite(tiny_image(d, kTinyRear, 102), "<html>"); },
       {"_0000102.jpg"}},
      {"JPEG of another size",
       [](const fs::path& d) {
         fs::copy_file(tiny_image(d, kTinyRear, 100), tiny_image(d, kTinyFront, 101),
                       fs::copy_options::overwrite_existing);
       },
       {std::string(kTinyFront) + "_0000101.jpg", "40", "48"}},
      {"JPEG scratched",
       [](const fs::path& d) {
         const fs::path file = tiny_image(d, kTinyRear, 102);
         std::string bytes = read_file(file);
         const std::size_t middle = bytes.size() * 3 / 4;
         bytes.replace(middle, 8, "\xff\xc1\xff\xc1\xff\xc1\xff\xc1", 8);
         overwrite(file, bytes);
       },
       {"_0000102.jpg"}},
      {"time before the last",
       [](const fs::path& d) {
         edit_json(tiny_egomotion(d), [](json& e) { e["101"]["time_host"] = 3; });
       },
       {"egomotion2.json", "101.time"}},
  };
}

TEST_F(EndToEnd, RefusesInvalidDrives) {
  for (const BadDrive& bad : bad_drives()) {
    fs::remove_all(drive_);
    write_tiny_recording(drive_);
    bad.spoil(drive_);
    const auto before = contents(folder_);
    const ProgramResult ended = redrive(train_arguments(folder_ / "run", {"--max-steps", "2"}));
    EXPECT_EQ(ended.exit_code, kExitBadInput) << bad.name << "\n" << ended.out << ended.err;
    for (const std::string& part : bad.message) EXPECT_THAT(ended.err, HasSubstr(part)) << bad.name;
    EXPECT_FALSE(fs::exists(folder_ / "run")) << bad.name;
    EXPECT_EQ(contents(folder_), before) << bad.name;
    EXPECT_EQ(redrive({"inspect", drive_.string()}).exit_code, kExitBadInput) << bad.name;
  }
}

TEST_F(EndToEnd, OneDamagedRecordCostsItself) {
  for (const BadDrive& damaged : damaged_drives()) {
    fs::remove_all(drive_);
    fs::remove_all(folder_ / "run");
    write_tiny_recording(drive_);
    damaged.spoil(drive_);
    const ProgramResult inspected = redrive({"inspect", drive_.string()}),
                        trained = redrive(train_arguments(folder_ / "run", {"--max-steps", "2"}));
    for (const ProgramResult& ended : {inspected, trained}) {
      EXPECT_EQ(ended.exit_code, kExitOk) << damaged.name << "\n" << ended.out << ended.err;
      EXPECT_THAT(ended.out, HasSubstr("1 of ")) << damaged.name;
      for (const std::string& part : damaged.message)
        EXPECT_THAT(ended.out, HasSubstr(part)) << damaged.name;
    }
    EXPECT_EQ(redrive({"resume", (folder_ / "run").string(), "--max-steps", "4"}).exit_code,
              kExitOk)
        << damaged.name;
    EXPECT_EQ(redrive({"eval", (folder_ / "run").string(), "--all"}).exit_code, kExitOk)
        << damaged.name;
    // Where none may be damaged inspect passes nothing that train refuses.
    EXPECT_EQ(redrive({"inspect", drive_.string(), "--max-damaged", "0"}).exit_code, kExitBadInput)
        << damaged.name;
    EXPECT_EQ(
        redrive(train_arguments(folder_ / "strict", {"--max-steps", "2", "--max-damaged", "0"}))
            .exit_code,
        kExitBadInput)
        << damaged.name;
  }
}

TEST_F(EndToEnd, FramesThatAreNotChosenAreNotChecked) {
  for (const int id : {100, 101}) overwrite(tiny_image(drive_, kTinyRear, id), "");
  const std::vector<std::string> rest = {"--frames", "102:103", "--max-damaged", "0"};
  EXPECT_EQ(redrive({"inspect", drive_.string()}).exit_code, kExitBadInput);
  EXPECT_EQ(redrive({"inspect", drive_.string(), rest[0], rest[1]}).exit_code, kExitOk);
  std::vector<std::string> options = {"--max-steps", "2"};
  EXPECT_EQ(redrive(train_arguments(folder_ / "run", options)).exit_code, kExitBadInput);
  options.insert(options.end(), rest.begin(), rest.end());
  EXPECT_EQ(redrive(train_arguments(folder_ / "run", options)).exit_code, kExitOk);
}

TEST_F(EndToEnd, TheShareOfDamagedRecordsIsTheRunsUnlessGiven) {
  const std::string run = (folder_ / "run").string();
  for (const int id : {100, 101}) overwrite(tiny_image(drive_, kTinyRear, id), "");
  ASSERT_EQ(redrive(train_arguments(run, {"--max-steps", "2", "--max-damaged", "80"})).exit_code,
            kExitOk);
  const auto expect_ends = [](std::vector<std::string> command, const char* share, int exit_code) {
    if (share[0] != '\0') command.insert(command.end(), {"--max-damaged", share});
    const ProgramResult ended = redrive(command);
    EXPECT_EQ(ended.exit_code, exit_code) << command[0] << ended.out << ended.err;
    if (exit_code == kExitBadInput) {
      EXPECT_THAT(ended.err, HasSubstr("--max-damaged PERCENT accepts more")) << command[0];
    }
  };
  const std::vector<std::vector<std::string>> commands = {
      {"render", run, "--camera", kTinyRear, "--frame", "102", "--out",
       (folder_ / "a.png").string()},
      {"eval", run, "--all"},
      {"resume", run, "--max-steps", "4"}};
  for (const std::vector<std::string>& command : commands) {
    expect_ends(command, "5", kExitBadInput);
    expect_ends(command, "", kExitOk);
  }
  const std::vector<std::string> exported = {
      "export", drive_.string(), "--to", "aimotive", "--out", (folder_ / "exported").string()};
  expect_ends(exported, "", kExitBadInput);
  expect_ends(exported, "80", kExitOk);
}

TEST_F(EndToEnd, DropsAndListsFramesWithoutPose) {
  edit_json(tiny_egomotion(drive_), [](json& egomotion) { egomotion.erase("102"); });
  for (const ProgramResult& ended :
       {redrive({"inspect", drive_.string()}),
        redrive(train_arguments(folder_ / "run", {"--max-steps", "2"}))}) {
    EXPECT_EQ(ended.exit_code, kExitOk) << ended.err;
    EXPECT_THAT(ended.out + ended.err, HasSubstr("102"));
  }
}

TEST_F(EndToEnd, ListsMissingImages) {
  fs::remove(tiny_image(drive_, kTinyRear, 102));
  for (const ProgramResult& ended :
       {redrive({"inspect", drive_.string()}),
        redrive(train_arguments(folder_ / "run", {"--max-steps", "2"}))}) {
    EXPECT_EQ(ended.exit_code, kExitOk) << ended.err;
    EXPECT_THAT(ended.out + ended.err, HasSubstr("102"));
  }
}

TEST_F(EndToEnd, RefusesInvalidTrainingOptions) {
  const std::vector<std::vector<std::string>> table = {
      {"--cameras", "NO_SUCH_CAMERA"},
      {"--cameras", "Imu0"},
      {"--frames", "500:600"},
      {"--frames", "7"},
      {"--downscale", "0"},
      {"--downscale", "64"},
      {"--holdout-every", "1"},
      {"--near", "-1"},
      {"--near", "0"},
      {"--far", "0.5"},
      {"--width", "48"},
      {"--samples", "1"},
      {"--fine-samples", "-2"},
      {"--batch", "0"},
      {"--learning-rate", "0"},
      {"--lr-gamma", "1.5"},
      {"--lr-milestones", "5,5"},
      {"--epochs", "0"},
      {"--max-steps", "-1"},
      {"--max-seconds", "-1"},
      {"--seed", "x"},
      {"--checkpoint-every", "0"},
      {"--threads", "-1"},
      {"--backend", "tpu"},
      {"--backend", "cuda"},
      {"--isa", "sse"},
      {"--method", "splats"},
      {"--preset", "report-9"},
      {"--undistort"},
      {"--refine-poses", "maybe"},
      {"--rolling-shutter", "30ms"},
      {"--rolling-shutter", "estimate"},
      {"--no-such-option"},
      {"--holdout-every", "2", "--frames", "100:100"}};
  const auto before = contents(folder_);
  for (const std::vector<std::string>& more : table) {
    const ProgramResult ended = redrive(train_arguments(folder_ / "run", more));
    EXPECT_EQ(ended.exit_code, kExitUsage) << more[0] << "\n" << ended.out << ended.err;
    EXPECT_THAT(ended.err, HasSubstr(more[0]));
    EXPECT_FALSE(fs::exists(folder_ / "run")) << more[0];
  }
  EXPECT_EQ(redrive({"train", drive_.string()}).exit_code, kExitUsage) << "--out is missing";
  EXPECT_EQ(redrive({"train", "", "--out", (folder_ / "run").string()}).exit_code, kExitUsage);
  EXPECT_EQ(redrive({"train", drive_.string(), "--out", ""}).exit_code, kExitUsage);
  EXPECT_EQ(redrive({"train", "k\xf6ln", "--out", (folder_ / "run").string()}).exit_code,
            kExitUsage)
      << "not UTF-8";
  EXPECT_EQ(redrive({}).exit_code, kExitUsage);
  const ProgramResult unknown = redrive({"fly"});
  EXPECT_EQ(unknown.exit_code, kExitUsage);
  EXPECT_THAT(unknown.err, AllOf(HasSubstr("fly"), HasSubstr("inspect, align, train")))
      << "names the word and what there is";
  EXPECT_EQ(contents(folder_), before);
}

// The program and its threads take more than 50 MiB. The message estimates the need, and training
// succeeds with that much.
TEST_F(EndToEnd, RefusesToExceedTheMemoryLimit) {
  const fs::path run = folder_ / "run";
  const auto with_memory = [&](const std::string& memory) {
    return redrive(train_arguments(run, {"--memory", memory, "--max-steps", "2"}));
  };
  const auto before = contents(folder_);
  const ProgramResult refused = with_memory(std::to_string(50 << 20));
  EXPECT_EQ(refused.exit_code, kExitUsage) << refused.out << refused.err;
  EXPECT_THAT(refused.err,
              AllOf(HasSubstr("--memory"), HasSubstr("of 0.05 GiB allowed"), HasSubstr("lower ")));
  EXPECT_FALSE(fs::exists(run));
  EXPECT_EQ(contents(folder_), before);

  const std::string needs = "needs about ";  // e.g. 0.08 GiB
  const std::size_t at = refused.err.find(needs);
  ASSERT_NE(at, std::string::npos) << refused.err;
  const double needed_gib = std::stod(refused.err.substr(at + needs.size()));
  EXPECT_EQ(with_memory(std::to_string(needed_gib - 0.006) + "GiB").exit_code, kExitUsage);
  EXPECT_EQ(contents(folder_), before);
  const ProgramResult enough = with_memory(std::to_string(needed_gib + 0.006) + "GiB");
  EXPECT_EQ(enough.exit_code, kExitOk) << enough.err;

  const auto trained = contents(run);
  EXPECT_EQ(redrive({"resume", run.string(), "--max-steps", "4", "--memory", "0.05GiB"}).exit_code,
            kExitUsage);
  EXPECT_EQ(contents(run), trained);
}

TEST_F(EndToEnd, RefusesInvalidOptionsOfOtherCommands) {
  const std::string run = trained("run", 3).string();
  const std::vector<std::vector<std::string>> table = {
      {"eval", run, "--max-images", "0"},    {"eval", run, "--max-images", "3", "--all"},
      {"eval", run, "--threads", "-1"},      {"eval", run, "--isa", "sse"},
      {"figures", run, "--max-images", "0"}, {"resume", run, "--epochs", "0"},
      {"resume", run, "--max-steps", "-1"},  {"resume", run, "--max-seconds", "x"},
      {"resume", run, "--threads", "5000"},  {"bench", "--repetitions", "-1"},
      {"bench", "--threads", "-1"},          {"bench", "--filter", "no-such-benchmark"},
      {"bench", "--backend", "tpu"}};
  const auto before = contents(folder_);
  for (const std::vector<std::string>& arguments : table) {
    const ProgramResult ended = redrive(arguments);
    const std::string& option =
        *std::find_if(arguments.begin(), arguments.end(),
                      [](const std::string& word) { return word.starts_with("--"); });
    EXPECT_EQ(ended.exit_code, kExitUsage) << arguments[0] << " " << option << "\n"
                                           << ended.out << ended.err;
    EXPECT_THAT(ended.err, HasSubstr(option)) << arguments[0];
  }
  EXPECT_EQ(contents(folder_), before);
}

TEST_F(EndToEnd, RefusesAnExistingOutputFolder) {
  fs::create_directory(folder_ / "run");
  overwrite(folder_ / "run/notes.txt", "mine");
  const auto before = contents(folder_);
  const ProgramResult ended = redrive(train_arguments(folder_ / "run"));
  EXPECT_EQ(ended.exit_code, kExitUsage);
  EXPECT_THAT(ended.err, HasSubstr((folder_ / "run").string()));
  EXPECT_EQ(contents(folder_), before);
}

TEST_F(EndToEnd, RefusesInvalidRuns) {
  const fs::path run = trained("run", 3);
  const std::string config = read_file(run / "config.json"),
                    checkpoint = read_file(run / "checkpoint.safetensors");
  const auto refused = [&](const char* name, const std::string& part) {
    const auto before = contents(run);
    for (const char* command : {"resume", "eval", "figures"}) {
      const ProgramResult ended = redrive({command, run.string()});
      EXPECT_EQ(ended.exit_code, kExitBadInput) << name << " " << command << "\n" << ended.err;
      EXPECT_THAT(ended.err, HasSubstr(part)) << name;
    }
    EXPECT_EQ(contents(run), before) << name;
    overwrite(run / "config.json", config);
    overwrite(run / "checkpoint.safetensors", checkpoint);
  };
  overwrite(run / "checkpoint.safetensors", checkpoint.substr(0, checkpoint.size() / 2));
  refused("truncated checkpoint", "checkpoint.safetensors");
  overwrite(run / "checkpoint.safetensors", "");
  refused("empty checkpoint", "checkpoint.safetensors");
  edit_json(run / "config.json", [](json& c) { c["width"] = 64; });
  refused("checkpoint of another width", "width");
  edit_json(run / "config.json", [](json& c) { c["width"] = "wide"; });
  refused("option of another type", "width");
  edit_json(run / "config.json", [](json& c) { c.erase("recording"); });
  refused("option missing", "recording: missing");
  edit_json(run / "config.json", [](json& c) { c["colour"] = 1; });
  refused("option unknown", "colour");
  overwrite(run / "config.json", "{");
  refused("config no JSON", "config.json");
  edit_json(run / "config.json", [&](json& c) { c["recording"] = (folder_ / "gone").string(); });
  refused("recording gone", "gone");
  fs::remove(run / "config.json");
  refused("config missing", "config.json");
  edit_json(tiny_egomotion(drive_), [](json& e) {
    e["103"]["RT_ECEF_body"][0][3] = e["103"]["RT_ECEF_body"][0][3].get<double>() + 3;
  });
  refused("replaced by another recording", "no longer the recording");
  for (const char* command : {"resume", "eval", "figures"})
    EXPECT_EQ(redrive({command, (folder_ / "no-run").string()}).exit_code, kExitBadInput)
        << command;
}

TEST_F(EndToEnd, RefusesInvalidRenderRequests) {
  const fs::path run = trained("run", 3), poses = folder_ / "poses.json";
  overwrite(folder_ / "taken.png", "mine");
  const std::string out = (folder_ / "out.png").string(), front = kTinyFront;
  const auto render = [&](std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), "render");
    const auto place = std::ranges::find_if(
        arguments, [](const std::string& word) { return word.starts_with("--"); });
    arguments.insert(place, run.string());
    const auto before = contents(folder_);
    const ProgramResult ended = redrive(arguments);
    EXPECT_EQ(contents(folder_), before) << arguments[2];
    return ended.exit_code;
  };
  EXPECT_EQ(render({"--camera", "NO", "--frame", "100", "--out", out}), kExitUsage);
  EXPECT_EQ(render({"--camera", front, "--frame", "999", "--out", out}), kExitUsage);
  EXPECT_EQ(render({"--camera", front, "--frame", "x", "--out", out}), kExitUsage);
  EXPECT_EQ(render({"--camera", front, "--frame", "100", "--translate", "1,2", "--out", out}),
            kExitUsage);
  EXPECT_EQ(render({"--camera", front, "--frame", "100", "--translate", "1e300,0,0", "--out", out}),
            kExitUsage);
  EXPECT_EQ(render({"--camera", front, "--frame", "100", "--out", out, "--depth",
                    (folder_ / "." / fs::path(out).filename()).string()}),
            kExitUsage)
      << "the same file by another name";
  const std::string mount = "0,0,1,0,0,0", lens = "pinhole:90:64x48";
  EXPECT_EQ(render({"mount", "--mount", mount, "--frame", "100", "--out", out}), kExitUsage);
  EXPECT_EQ(render({"mount", "--mount", "0,0,1", "--lens", lens, "--frame", "100", "--out", out}),
            kExitUsage);
  EXPECT_EQ(render({"mount", "--mount", mount, "--lens", "NO", "--frame", "100", "--out", out}),
            kExitUsage);
  EXPECT_EQ(render({"--camera", front, "--frame", "100", "--axes", "up", "--out", out}),
            kExitUsage);
  EXPECT_EQ(render({"--camera", front, "--frame", "100", "--out", (folder_ / "out.gif").string()}),
            kExitUsage);
  EXPECT_EQ(
      render({"--camera", front, "--frame", "100", "--out", (folder_ / "taken.png").string()}),
      kExitUsage);
  EXPECT_EQ(render({"poses", "--out", out, poses.string()}), kExitBadInput) << "missing";
  overwrite(poses, "[]");
  EXPECT_EQ(render({"poses", "--out", out, poses.string()}), kExitBadInput);
  overwrite(poses,
            R"({"images": [{"file": "../up.png", "camera": "F_MIDLONGRANGECAM_CL", "frame_id": 100,
          "shift_body_m": [0, 0, 0]}]})");
  EXPECT_EQ(render({"poses", "--out", out, poses.string()}), kExitBadInput);
  overwrite(poses,
            R"({"images": [{"file": "a.png", "camera": "NO", "frame_id": 100,
          "shift_body_m": [0, 0, 0]}]})");
  EXPECT_EQ(render({"poses", "--out", out, poses.string()}), kExitBadInput);
}

TEST_F(EndToEnd, FailsOnFullStandardOutput) {
  const std::string command =
      std::string(REDRIVE_BINARY) + " inspect " + drive_.string() + " > /dev/full";
  EXPECT_EQ(Program("/bin/sh", {"-c", command}).wait().exit_code, kExitIo);
}

}  // namespace
}  // namespace redrive::testing

// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/files/options.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files/temporary_folder_testing.h"
#include "redrive/image/image_io.h"

namespace redrive {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

TrainField field(const std::string& name) {
  for (const TrainField& candidate : train_fields())
    if (candidate.name == name) return candidate;
  throw std::logic_error("no field " + name);
}

TrainOptions nerf_options() {
  TrainOptions options;
  options.method = "nerf";
  apply_preset(&options, {});
  return options;
}

std::string error_message(const std::string& name, const std::string& value) {
  try {
    TrainOptions options = nerf_options();
    options.recording = "drive";
    field(name).parse(options, value);
    validate(options);
  } catch (const UsageError& error) {
    return error.what();
  }
  return "";
}

struct Case {
  const char *option, *value;
};
void PrintTo(const Case& c, std::ostream* out) { *out << "--" << c.option << " " << c.value; }

class OutOfRange : public ::testing::TestWithParam<Case> {};

TEST_P(OutOfRange, IsRejectedNamingOptionAndValue) {
  const auto [option, value] = GetParam();
  const std::string what = error_message(option, value);
  EXPECT_THAT(what, HasSubstr(std::string("--") + option)) << value;
  EXPECT_THAT(what, HasSubstr(std::string(value).substr(
                        0, 3)));  // the message shows the parsed number, without all digits
}

INSTANTIATE_TEST_SUITE_P(
    Options, OutOfRange,
    ::testing::Values(
        Case{"method", "gaussians"}, Case{"frames", "7"}, Case{"frames", "9:7"},
        Case{"frames", "1:2:0"}, Case{"frames", "1:2:3:4"}, Case{"frames", "a:b"},
        Case{"frames", "-4:7"}, Case{"downscale", "0"}, Case{"downscale", "65"},
        Case{"downscale", "2.5"}, Case{"downscale", ""}, Case{"holdout-every", "-1"},
        Case{"holdout-every", "1"}, Case{"near", "0"}, Case{"near", "-1"}, Case{"near", "nan"},
        Case{"near", "1m"}, Case{"far", "inf"}, Case{"far", "0"}, Case{"far", "0.5"},
        Case{"width", "0"}, Case{"width", "16"}, Case{"width", "100"}, Case{"width", "544"},
        Case{"samples", "2"}, Case{"samples", "1025"}, Case{"fine-samples", "-1"},
        Case{"fine-samples", "1025"}, Case{"batch", "0"}, Case{"batch", "65537"},
        Case{"batch", "65536"}, Case{"error-rays", "-0.1"}, Case{"error-rays", "0.95"},
        Case{"error-rays", "0.5"}, Case{"error-rays", "half"}, Case{"learning-rate", "0"},
        Case{"learning-rate", "1.5"}, Case{"learning-rate", "nan"}, Case{"lr-gamma", "0"},
        Case{"lr-gamma", "2"}, Case{"lr-milestones", "0"}, Case{"lr-milestones", "20,10"},
        Case{"lr-milestones", "x"}, Case{"lidar-rays", "0"}, Case{"epochs", "0"},
        Case{"epochs", "10001"}, Case{"epochs", "99999999999999999999"}, Case{"max-steps", "-5"},
        Case{"max-seconds", "-0.5"}, Case{"max-seconds", "inf"}, Case{"max-seconds", "nan"},
        Case{"seed", "-1"}, Case{"seed", "18446744073709551616"}, Case{"checkpoint-every", "0"},
        Case{"gpu-memory", "6GB"}, Case{"gpu-memory", "0%"}, Case{"threads", "-2"},
        Case{"threads", "1025"}, Case{"backend", "tpu"}, Case{"isa", "sse2"},
        Case{"preset", "report-3"}, Case{"background", "grey"}, Case{"background", "random"}));

TEST(TrainOptions, RejectsCamerasThatAreRepeatedOrEmpty) {
  EXPECT_THAT(error_message("cameras", "A,A"), HasSubstr("--cameras"));
  EXPECT_THAT(error_message("cameras", "A,"), HasSubstr("--cameras"));
}

TEST(TrainOptions, AcceptsTheEndsOfTheRange) {
  for (const auto& [option, value] :
       {Case{"downscale", "64"}, Case{"width", "32"}, Case{"width", "512"}, Case{"samples", "3"},
        Case{"fine-samples", "1024"}, Case{"learning-rate", "1"}, Case{"frames", ":"},
        Case{"frames", "5:"}, Case{"frames", "5:5:9"}, Case{"seed", "18446744073709551615"}})
    EXPECT_THAT(error_message(option, value), IsEmpty()) << option << " " << value;
}

TEST(TrainOptions, EveryOptionHasAHelpWithItsDefault) {
  for (const TrainField& candidate : train_fields())
    EXPECT_FALSE(candidate.help.empty()) << candidate.name;
  EXPECT_THAT(help_text(field("near")), HasSubstr("default: 0.5"));
  EXPECT_THAT(help_text(field("learning-rate")), HasSubstr("default: 0.02"));
}

TEST(TrainOptions, FramesBecomeARangeOfTheScene) {
  TrainOptions options;
  options.frames = "33643::2";
  const SceneOptions scene = scene_options(options);
  EXPECT_EQ(scene.first_frame, 33643);
  EXPECT_EQ(scene.last_frame, -1);
  EXPECT_EQ(scene.frame_step, 2);
}

TEST(TrainOptions, PassesTheBackgroundToTheScene) {
  TrainOptions options;
  EXPECT_EQ(scene_options(options).background, Background::kNone);
  EXPECT_FALSE(scene_options(options).random_background);
  for (const auto& [name, background] :
       {std::pair{"white", Background::kWhite}, std::pair{"black", Background::kBlack},
        std::pair{"random", Background::kBlack}}) {
    options.background = name;
    EXPECT_EQ(scene_options(options).background, background);
    EXPECT_TRUE(scene_options(options).random_background);
  }
  options.method = "nerf";
  EXPECT_FALSE(scene_options(options).random_background) << "nerf has no random backgrounds";
}

// A cube of half side 1 around (10, 0, 0). From 4 in front of it: 3 to its face, its far corners at
// (5, 1, 1). From inside, it is all around.
TEST(TrainOptions, BoundsSetNearAndFarUnlessTheyAreGiven) {
  Recording recording;
  recording.frames = {{0, 0, Rigid3d(Eigen::Translation3d(6, 0, 0))}};
  TrainOptions options = nerf_options();
  resolve_bounds(&options, {}, recording);
  EXPECT_EQ(options.near_m, 1) << "no bounds";
  EXPECT_EQ(options.far_m, 10);
  recording.bounds = BoundingCube{{10, 0, 0}, 1};
  for (const char* given : {"near", "far"}) {
    resolve_bounds(&options, {given}, recording);
    EXPECT_EQ(options.far_m, 10) << given;
  }
  resolve_bounds(&options, {}, recording);
  EXPECT_NEAR(options.near_m, 3, 1e-12);
  EXPECT_NEAR(options.far_m, std::sqrt(27.0), 1e-12);
  recording.frames.push_back({1, 1, Rigid3d(Eigen::Translation3d(10, 0.5, 0))});
  resolve_bounds(&options, {}, recording);
  EXPECT_NEAR(options.near_m, 0.02, 1e-12);
  EXPECT_NEAR(options.far_m, std::sqrt(27.0), 1e-12);
  options =
      TrainOptions();  // from inside, the grid sees beyond the cube unless there is a background
  resolve_bounds(&options, {}, recording);
  EXPECT_NEAR(options.far_m, 100, 1e-12);
  options.background = "white";
  resolve_bounds(&options, {"near"}, recording);
  EXPECT_NEAR(options.far_m, 100, 1e-12);
  resolve_bounds(&options, {}, recording);
  EXPECT_NEAR(options.far_m, std::sqrt(27.0), 1e-12);
  options = nerf_options();
  options.preset = "report-1";
  resolve_bounds(&options, {}, recording);
  EXPECT_EQ(options.far_m, 10);
}

/// Returns the value of a hyperparameter that the options result in, without a scene.
std::string value_of(const TrainOptions& options, const std::string& name) {
  const auto model = make_model(options.method);
  apply_hyperparameters(options, model.get());
  for (const HyperparameterValue& value : hyperparameter_values(*model))
    if (value.what.name == name) return value.text;
  return "none";
}

TEST(TrainOptions, PresetFillsOnlyWhatIsNotGiven) {
  TrainOptions options;
  options.preset = "report-2";
  options.set("samples", 64);
  apply_preset(&options, {"samples"});
  EXPECT_EQ(value_of(options, "width"), "128");
  EXPECT_EQ(value_of(options, "samples"), "64");
  EXPECT_EQ(options.epochs, 2);
  EXPECT_FALSE(options.undistort);
  EXPECT_EQ(options.masks, "none");
  EXPECT_EQ(TrainOptions{}.masks, "auto");
}

TEST(TrainOptions, HaveTheDefaultMethod) {
  EXPECT_EQ(TrainOptions().method, kDefaultMethod);
  EXPECT_THAT(help_text(field("method")), HasSubstr("default: " + std::string(kDefaultMethod)));
  EXPECT_THAT(help_text(field("preset")), HasSubstr("splat: fast = --max-seconds 30, best = "));
  EXPECT_THAT(help_text(field("max-seconds")), HasSubstr("default: 120; grid: 300; nerf: 0)"));
  EXPECT_THAT(help_text(field("refine-poses")),
              HasSubstr("on for drives with splat and grid, off for nerf"));
}

TEST(TrainOptions, DefaultsAreThoseOfTheMethod) {
  TrainOptions options;
  options.method = "grid";
  apply_preset(&options, {});
  EXPECT_EQ(options.method, "grid");
  EXPECT_EQ(options.max_seconds, 300);
  EXPECT_EQ(value_of(options, "width"), "32");
  EXPECT_EQ(value_of(options, "error_rays"), "0.5");
  options = {};
  options.method = "grid";
  options.preset = "fast";
  apply_preset(&options, {"method"});
  EXPECT_EQ(options.method, "grid");
  EXPECT_EQ(options.max_seconds, 60);
  options = {};
  options.method = "splat";  // a preset of the same name
  options.preset = "fast";
  apply_preset(&options, {"method"});
  EXPECT_EQ(options.method, "splat");
  EXPECT_EQ(options.max_seconds, 30);
  EXPECT_EQ(value_of(options, "max_gaussians"), "246000") << "400,000 (30 s / 120 s)^0.35";
  options = {};
  options.method = "splat";
  options.max_seconds = 600;
  apply_preset(&options, {"method", "max-seconds"});
  EXPECT_EQ(value_of(options, "max_gaussians"), "703000");
  options = {};
  options.max_steps = 7;
  apply_preset(&options, {"max-steps"});
  EXPECT_EQ(options.max_seconds, 0);
  options = {};
  options.preset = "report-1";
  apply_preset(&options, {});
  EXPECT_EQ(options.method, "nerf");
  EXPECT_EQ(options.near_m, 1);
  EXPECT_EQ(options.far_m, 10);
  EXPECT_EQ(value_of(options, "width"), "256");
  EXPECT_EQ(value_of(options, "samples"), "96");
  EXPECT_EQ(value_of(options, "batch_rays"), "1024");
  EXPECT_EQ(value_of(options, "learning_rate"), "5e-04");
  EXPECT_EQ(options.epochs, 4);
  EXPECT_EQ(options.max_seconds, 0);
  options = {};
  options.method = "grid";
  options.preset = "report-1";
  EXPECT_THROW(apply_preset(&options, {"method"}), UsageError);
}

/// Returns the message of validate() for --set TEXT with a method.
std::string set_error_message(const std::string& text, const std::string& method = "grid") {
  TrainOptions options;
  options.recording = "drive";
  options.method = method;
  apply_preset(&options, {});
  try {
    field("set").parse(options, text);
    validate(options);
  } catch (const UsageError& error) {
    return error.what();
  }
  return "";
}

TEST(Set, SetsEveryNumberOfEveryMethod) {
  for (const Method& method : methods()) {
    const auto model = method.make();
    for (const HyperparameterValue& value : hyperparameter_values(*model)) {
      const std::string error_message =
          set_error_message(value.what.name + "=" + value.text, method.name);
      if (value.what.derived)
        EXPECT_THAT(error_message, HasSubstr("cannot be set")) << value.what.name;
      else
        EXPECT_EQ(error_message, "") << value.what.name;
    }
  }
  EXPECT_EQ(set_error_message("pose_refinement.first_rate_m=2e-3"), "");
}

TEST(Set, ReportsTheRuleOrTheKnownNames) {
  EXPECT_THAT(set_error_message("histogram_padding=-1"),
              AllOf(HasSubstr("--set histogram_padding -1"), HasSubstr("must be above 0")));
  EXPECT_THAT(set_error_message("range_weight=much"), HasSubstr("must be a number"));
  EXPECT_THAT(set_error_message("grid.max_resolution=8"), HasSubstr("base_resolution"));
  EXPECT_THAT(set_error_message("pose_refinement.decay=-1"), HasSubstr("must be 0..1000"));
  EXPECT_THAT(
      set_error_message("matter=1"),
      AllOf(HasSubstr("--set matter=1: unknown; known are grid.n_levels"),
            HasSubstr("(--method grid)"), HasSubstr("range_weight"),
            HasSubstr("pose_refinement.first_rate_m"), Not(HasSubstr("appearance.cameras"))));
  EXPECT_THAT(set_error_message("range_weight=1", "nerf"), HasSubstr("belongs to --method grid"));
  for (const char* text : {"", "range_weight", "=1"})
    EXPECT_THAT(set_error_message(text), HasSubstr("must be NAME=VALUE"));
}

TEST(Set, ReachesModelAndPoseRefinement) {
  TrainOptions options;
  options.method = "grid";
  field("set").parse(options, "range_weight=0.25");
  field("set").parse(options, "width=64");
  field("set").parse(options, "pose_refinement.steps_per_update=8");
  EXPECT_EQ(value_of(options, "range_weight"), "0.25");
  EXPECT_EQ(value_of(options, "width"), "64");
  EXPECT_EQ(pose_refinement(options).steps_per_update, 8);
  EXPECT_EQ(pose_refinement(options).decay, PoseRefinement().decay);
}

TEST(Set, IsInTheConfigUnderItsOptionOrUnderSet) {
  TrainOptions options;
  options.method = "grid";
  options.recording = "drive";
  for (const char* text : {"range_weight=0.25", "width=64"}) field("set").parse(options, text);
  const nlohmann::json json = options_to_json(options);
  EXPECT_EQ(json.at("width"), 64);
  EXPECT_EQ(json.at("set"), nlohmann::json({{"range_weight", 0.25}}));
  const TrainOptions back = options_from_json(json, "config.json");
  EXPECT_EQ(back.hyperparameters, options.hyperparameters);
}

TEST(TrainOptions, SecondSetupTakesTheRearCameraWhereTheMiddleOneIsMissing) {
  Recording recording;
  recording.cameras.resize(2);
  recording.cameras[0].calibration.name = "B_MIDRANGECAM_C";
  recording.cameras[1].calibration.name = "F_MIDLONGRANGECAM_CL";
  TrainOptions options;
  options.method = "nerf";
  options.preset = "report-2";
  resolve_cameras(&options, &recording);
  EXPECT_THAT(options.cameras, ElementsAre("F_MIDLONGRANGECAM_CL", "B_MIDRANGECAM_C"));

  recording.cameras[0].calibration.name = "F_MIDRANGECAM_C";
  options.cameras.clear();
  resolve_cameras(&options, &recording);
  EXPECT_THAT(options.cameras, ElementsAre("F_MIDLONGRANGECAM_CL", "F_MIDRANGECAM_C"));

  options.cameras = {"M_FISHEYE_L"};
  resolve_cameras(&options, &recording);
  EXPECT_THAT(options.cameras, ElementsAre("M_FISHEYE_L"));
}

TEST(TrainOptions, GreyCamerasAreLeftOutBesideColourOnes) {
  const TemporaryFolder folder;
  Recording recording;
  recording.cameras.resize(3);
  for (int c = 0; c < 3; ++c) {
    RecordedCamera& camera = recording.cameras[c];
    camera.calibration.name = std::string("CAM") + std::to_string(c);
    Image8 image{2, 2, std::vector<std::uint8_t>(12, 90)};
    if (c > 0) image.rgb[0] = 10;
    camera.images.push_back({{7, folder.path / (camera.calibration.name + ".png")}, {}, false});
    write_image(camera.images[0].path, image);
  }
  TrainOptions options;
  resolve_cameras(&options, &recording);
  EXPECT_THAT(options.cameras, ElementsAre("CAM1", "CAM2"));
  ASSERT_EQ(recording.findings.size(), 1u);
  EXPECT_EQ(recording.findings[0].subject, "CAM0");

  options.cameras = {"CAM0"};
  resolve_cameras(&options, &recording);
  EXPECT_THAT(options.cameras, ElementsAre("CAM0")) << "as named";

  options.cameras.clear();
  recording.cameras.resize(1);
  resolve_cameras(&options, &recording);
  EXPECT_TRUE(options.cameras.empty()) << "all are grey";
}

TEST(TrainOptions, RejectsHyperparametersOfAnotherMethod) {
  EXPECT_THAT(error_message("error-rays", "0.25"), HasSubstr("belongs to --method grid"));
  TrainOptions options;
  options.method = "grid";
  options.recording = "drive";
  options.set("fine_samples", 8);
  EXPECT_THROW(validate(options), UsageError);
  options.hyperparameters.clear();
  for (const double share : {0.0, 0.3, 0.9}) {
    options.set("error_rays", share);
    EXPECT_NO_THROW(validate(options));
  }
}

TEST(TrainOptions, TotalStepsAreEpochsOrMaxSteps) {
  TrainOptions options = nerf_options();
  options.epochs = 4;
  EXPECT_EQ(total_steps(options, 1000), 4000);
  options.max_steps = 800;
  EXPECT_EQ(total_steps(options, 1000), 800);
}

TEST(TrainOptions, RejectsTextThatIsNotUtf8ByName) {
  const auto what = [](const TrainOptions& options) -> std::string {
    try {
      validate(options);
    } catch (const UsageError& error) {
      return error.what();
    }
    return "";
  };
  TrainOptions options;
  options.recording = "/drives/k\xc3\xb6ln";
  EXPECT_EQ(what(options), "");
  options.recording = "/drives/k\xf6ln";
  EXPECT_THAT(what(options), HasSubstr("RECORDING: must be UTF-8"));
  options = {};
  options.cameras = {"A", "\xff"};
  EXPECT_THAT(what(options), HasSubstr("--cameras: must be UTF-8"));
}

TEST(Options, RefinesPosesOfDrivesWithGridByDefault) {
  Scene drive, photographs;
  photographs.metric = false;
  TrainOptions options;
  for (const char* method : {"grid", "nerf"}) {
    options.method = method;
    const bool grid = options.method == "grid";
    for (options.ground_truth_poses = false;; options.ground_truth_poses = true) {
      options.refine_poses = "auto";
      EXPECT_EQ(refines_poses(options, drive), grid && !options.ground_truth_poses) << method;
      EXPECT_FALSE(refines_poses(options, photographs));
      options.refine_poses = "on";
      EXPECT_TRUE(refines_poses(options, drive)) << method;
      EXPECT_THROW(refines_poses(options, photographs), UsageError);
      options.refine_poses = "off";
      EXPECT_FALSE(refines_poses(options, drive));
      EXPECT_FALSE(refines_poses(options, photographs));
      if (options.ground_truth_poses) break;
    }
  }
}

}  // namespace
}  // namespace redrive

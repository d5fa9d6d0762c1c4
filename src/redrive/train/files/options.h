// SPDX-License-Identifier: Apache-2.0
// Options of a training run. One field list (train_fields) feeds the command line, the help text,
// and writing and reading config.json. The order of flags has no effect: a preset sets only options
// that were not given.
#pragma once

#include <charconv>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <string>
#include <string_view>
#include <type_traits>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include "redrive/model/method.h"
#include "redrive/recording/formats/pose_files.h"
#include "redrive/scene/scene.h"
#include "redrive/train/poses/pose_refinement.h"

namespace redrive {

/// Seconds of training between two checkpoints at most, which bounds what a kill loses on slow
/// machines.
inline constexpr double kSecondsPerCheckpoint = 60;

struct TrainOptions {
  std::string recording;  ///< folder
  std::string method = kDefaultMethod;
  std::string preset;  ///< "", nerf: "report-1", "report-2"; grid: "fast", "best"
  // scene/scene.h SceneOptions
  std::vector<std::string> cameras;
  std::string frames;  ///< "FIRST:LAST[:STEP]", ids inclusive, either may be empty
  int downscale = 1;
  int holdout_every = 0, train_every = 0;
  bool undistort = false;
  bool ground_truth_poses = false;  ///< uses the ground-truth poses and calibration
  /// whether to read files outside the recording's folder that it names
  bool outside_files = false;
  double max_damaged = kMostDamagedPercent;  ///< share of a sensor's records that may be damaged
  std::string
      poses;  ///< folder of other poses and another calibration (recording/formats/pose_files.h);
              ///< "": the recording's own
  bool align = false;  ///< runs redrive align first and uses its poses
  std::vector<std::string>
      rolling_shutter;  ///< recording/core/readout_options.h; overrides the calibration
  std::string refine_poses = "auto";  ///< "auto", "on", "off"; auto: on for drives with grid, off
                                      ///< with ground_truth_poses
  double near_m = 0.5, far_m = 1000;
  /// "", "white", "black", "random" (black): colour behind transparent pixels
  std::string background;
  std::string masks = "auto";  ///< pixels to ignore: "auto" computes the masks, "none" has none, or
                               ///< a folder of CAM.png
  /// Hyperparameters of the method and of pose refinement that options, a preset or --set set, as
  /// text by name. The others have the model's defaults or follow from the scene
  /// (Trainee::configure).
  std::map<std::string, std::string> hyperparameters;
  // optimisation
  int epochs = 10000;          ///< 1..10000
  std::int64_t max_steps = 0;  ///< 0: no limit
  double max_seconds = 300;    ///< time of training, from the first step on; 0: no limit
  std::uint64_t seed = 1;
  int checkpoint_every = 1000;  ///< steps; also at the end and on Ctrl-C
  // resources
  int threads = 0;             ///< 0: all
  std::string memory = "70%";  ///< memory that training may use: bytes, or a number with GiB or %
  std::string backend = "auto", isa = "auto", device;
  std::string gpu_memory = "90%";  ///< as memory, for the device of the backend

  /// Sets a hyperparameter by name.
  template <class T>
  void set(const std::string& name, T value) {
    if constexpr (std::is_arithmetic_v<T>) {
      char text[64];
      hyperparameters[name] = {text, std::to_chars(text, text + sizeof text, value).ptr};
    } else {
      hyperparameters[name] = value;
    }
  }
};

/// One option: its flag without dashes ("near"), which is its JSON key, too; parse throws
/// UsageError.
struct TrainField {
  std::string name, help;
  std::string value = {}, rule = {};      ///< shown in the help: "DIR", "1..64"
  std::string group = {};                 ///< heading in the help
  std::vector<std::string> choices = {};  ///< all values; empty: any
  bool is_flag = false;                   ///< a switch without a value
  bool repeats = false;                   ///< may be given several times
  std::string hyperparameter;  ///< name of the one that it sets; empty: an option of every method
  std::function<void(TrainOptions&, const std::string&)> parse;    ///< from the command line
  std::function<void(const TrainOptions&, nlohmann::json&)> save;  ///< into json[name]
  std::function<void(TrainOptions&, const nlohmann::json&)>
      load;  ///< from json[name]; UsageError if it is of another type
  std::function<void(const TrainOptions&)> check;  ///< UsageError if out of range
};
/// Returns the options of every method, then the options of hyperparameters.
std::vector<TrainField> train_fields();
/// Returns help, rule and defaults for the usual method and for other methods that differ.
std::string help_text(const TrainField& field);

/// Sets the options that are not named in `given` to the method's defaults and the preset's values.
/// Removes the time limit where epochs or max-steps are given. Throws UsageError for a preset that
/// is unknown or of another method. resolve_cameras and resolve_bounds set the options that depend
/// on the recording.
void apply_preset(TrainOptions* options, const std::vector<std::string>& given);
/// Sets the cameras to the preset's where none are given, or to the colour cameras where others are
/// grey; a finding names the grey ones.
void resolve_cameras(TrainOptions* options, Recording* recording);

/// Sets near_m and far_m of a bounded recording, unless they are `given` or set by the preset, so
/// that they enclose its cube as seen from every frame. Where the method contracts space and all
/// frames are inside the cube, far_m is a hundred times the half side.
void resolve_bounds(TrainOptions* options, const std::vector<std::string>& given,
                    const Recording& recording);

/// Sets the model's hyperparameters from the options. Throws UsageError for an unknown name,
/// listing the known ones, or a value out of range.
void apply_hyperparameters(const TrainOptions& options, Trainee* model);
/// Copies the model's values of hyperparameters that have their own option, or were set, to the
/// options, as text for config.json.
void record_hyperparameters(Trainee& model, TrainOptions* options);
PoseRefinement pose_refinement(const TrainOptions& options);

/// Throws UsageError naming option, value and rule for the first field out of range.
void validate(const TrainOptions& options);
/// The part of validate() that does not depend on the method.
void validate_fields(const TrainOptions& options);
SceneOptions scene_options(const TrainOptions& options);
/// Opens the recording with its own poses, or its ground truth with --truth-poses. The run
/// (train/run.h) replaces them by the poses of --poses and --align. Throws InputError as
/// redrive::open_recording.
Recording open_recording(const TrainOptions& options);
/// Whether the poses are not the recording's: --poses or --align.
bool has_external_poses(const TrainOptions& options);
/// Replaces the recording's poses by the poses of `files`; --rolling-shutter overrides their
/// readout times. Throws InputError as apply_pose_files.
void use_external_poses(const PoseFiles& files, const std::filesystem::path& folder,
                        const TrainOptions& options, Recording* recording);

/// Whether training refines poses. Throws UsageError for photographs, where it cannot.
bool refines_poses(const TrainOptions& options, const Scene& scene);

/// Returns the bytes that --memory allows on a machine with `machine` bytes: "6000000000", "6GiB"
/// or "70%". Throws UsageError.
std::uint64_t allowed_memory(const TrainOptions& options, std::uint64_t machine);
/// As allowed_memory, by --gpu-memory of `device` bytes.
std::uint64_t allowed_device_memory(const TrainOptions& options, std::uint64_t device);

/// Returns the steps of the whole run: epochs, or max_steps if that is less.
std::int64_t total_steps(const TrainOptions& options, std::int64_t steps_per_epoch);
/// Key of config.json under which write_config shows the resolved hyperparameters.
constexpr const char* kHyperparametersKey = "hyperparameters";

/// Returns a number, or a list of integers.
nlohmann::json hyperparameter_json(const HyperparameterValue& value);
nlohmann::json options_to_json(const TrainOptions& options);
/// A missing option has its default: the run is older than it. Throws InputError without recording
/// or method, for an unknown key, a value of another type or out of range.
TrainOptions options_from_json(const nlohmann::json& json, const std::filesystem::path& file);

}  // namespace redrive

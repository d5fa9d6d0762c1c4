// SPDX-License-Identifier: Apache-2.0
// Everything a training run depends on. One field list (train_fields) feeds the command line, the
// help text, the resolved config in the run folder and its reading back. Order of flags never
// matters: a preset fills what was not given.
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
#include "redrive/recording/pose_files.h"
#include "redrive/scene/scene.h"
#include "redrive/train/pose_refinement.h"

namespace redrive {

struct TrainOptions {
  std::string recording;  ///< folder
  std::string method = "grid";
  std::string preset;  ///< "", nerf: "report-1", "report-2"; grid: "fast", "best"
  // scene/scene.h SceneOptions
  std::vector<std::string> cameras;
  std::string frames;  ///< "FIRST:LAST[:STEP]", ids inclusive, either may be empty
  int downscale = 1;
  int holdout_every = 0;
  bool undistort = false;
  bool ground_truth_poses = false;  ///< the exact poses and calibration that a made recording ships
  std::string poses;   ///< folder of other poses and another calibration (recording/pose_files.h);
                       ///< "": the recording's own
  bool align = false;  ///< those that redrive align finds
  std::vector<std::string>
      rolling_shutter;  ///< recording/readout_options.h: what the calibration does not say
  std::string refine_poses = "auto";  ///< "auto", "on", "off": while training; auto: of a drive by
                                      ///< grid, but not with ground_truth_poses
  double near_m = 0.5, far_m = 1000;
  std::string background;  ///< "", "white", "black", "random" (black): behind transparent pixels
  std::string masks = "auto";  ///< what is not the static world: "auto" finds it, "none" trains on
                               ///< it, or a folder of CAM.png
  /// Numbers of the method and of pose refinement by name, as text, that are given: by options of
  /// their own, a preset or --set. The others are the model's defaults and what follows from the
  /// scene (Model::configure).
  std::map<std::string, std::string> hyperparameters;
  // optimisation
  int epochs = 10000;          ///< 1..10000
  std::int64_t max_steps = 0;  ///< 0: no limit
  double max_seconds = 300;    ///< of training alone; 0: no limit
  std::uint64_t seed = 1;
  int checkpoint_every = 1000;  ///< steps; also at the end and on Ctrl-C
  // how
  int threads = 0;                 ///< 0: all
  std::string memory = "70%";      ///< that training may take: bytes, or with GiB or % behind it
  std::string gpu_memory = "90%";  ///< likewise of a GPU's, a share of what is free
  std::string backend = "auto", isa = "auto";
  int gpus = 1;  ///< 1..64, each with a batch of its own

  /// Gives a hyperparameter by name.
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

/// One option: its flag without dashes ("near"), JSON key, help with unit, range and default; parse
/// throws UsageError.
struct TrainField {
  std::string name, help;
  bool is_flag = false;        ///< a switch without a value
  bool repeats = false;        ///< may be given several times
  std::string hyperparameter;  ///< the method's that it sets; empty: an option of every method
  std::function<void(TrainOptions&, const std::string&)> parse;    ///< from the command line
  std::function<void(const TrainOptions&, nlohmann::json&)> save;  ///< into json[name]
  std::function<void(TrainOptions&, const nlohmann::json&)>
      load;  ///< from json[name]; UsageError if it is of another type
  std::function<void(const TrainOptions&)> check;  ///< UsageError if out of range
};
/// Those of every method, then hyperparameters that have an option of their own.
std::vector<TrainField> train_fields();

/// Completes options by the defaults of the method and the values of the preset, except those named
/// in `given`; a run whose epochs or max-steps are given has no limit of time. UsageError for a
/// preset that is unknown or of another method. What depends on the recording is left to
/// resolve_cameras and resolve_bounds.
void apply_preset(TrainOptions* options, const std::vector<std::string>& given);
/// The preset's cameras, where none are given.
void resolve_cameras(TrainOptions* options, const Recording& recording);

/// near_m and far_m of a bounded recording, where neither is `given` or the preset's: they hold its
/// cube seen from every frame. Where the method contracts space and every frame is within the cube,
/// far_m is a hundred times the half side.
void resolve_bounds(TrainOptions* options, const std::vector<std::string>& given,
                    const Recording& recording);

/// Sets the given hyperparameters. UsageError for a name that the method has not, which lists those
/// that it has, or a value out of range.
void apply_hyperparameters(const TrainOptions& options, Model* model);
/// Takes the model's values of hyperparameters that have an option of their own, or are given, into
/// the options, in the form in which config.json has them.
void record_hyperparameters(Model& model, TrainOptions* options);
PoseRefinement pose_refinement(const TrainOptions& options);

/// UsageError naming option, value and rule for the first field out of range.
void validate(const TrainOptions& options);
SceneOptions scene_options(const TrainOptions& options);
/// The recording with its own poses, true ones if the options say so; what --poses and --align name
/// is put into it by its run (train/run.h). InputError as redrive::open_recording.
Recording open_recording(const TrainOptions& options);
/// Whether a run keeps poses of its own beside the recording's: --poses or --align.
bool has_external_poses(const TrainOptions& options);
/// Those, put into the recording; readouts that --rolling-shutter gives count before theirs.
/// InputError as apply_pose_files.
void use_external_poses(const PoseFiles& files, const std::filesystem::path& folder,
                        const TrainOptions& options, Recording* recording);

/// Whether poses are refined. UsageError where they cannot be: of photographs.
bool refines_poses(const TrainOptions& options, const Scene& scene);

/// What --memory allows on a machine of so many bytes: bytes ("6000000000"), "6GiB", or a share
/// ("70%"). UsageError.
std::uint64_t allowed_memory(const TrainOptions& options, std::uint64_t machine);
/// The same of --gpu-memory, on a GPU that has so many bytes free.
std::uint64_t allowed_gpu_memory(const TrainOptions& options, std::uint64_t free);

/// Steps of the whole run: epochs, or max_steps if that is less.
std::int64_t total_steps(const TrainOptions& options, std::int64_t steps_per_epoch);
/// Key of config.json under which write_config shows the resolved hyperparameters.
constexpr const char* kHyperparametersKey = "hyperparameters";

/// A number, or a list of whole numbers.
nlohmann::json hyperparameter_json(const HyperparameterValue& value);
nlohmann::json options_to_json(const TrainOptions& options);
/// InputError for an unknown or missing key, a value of another type or out of range.
TrainOptions options_from_json(const nlohmann::json& json, const std::filesystem::path& file);

}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
// Registry of reconstruction methods by name. CONTRIBUTING.md says how to add one.
#pragma once

#include <memory>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "redrive/model/benchmark.h"
#include "redrive/model/trainee.h"

namespace redrive {

/// Options by name with their text, as on the command line: {"near", "1"}.
using OptionValues = std::vector<std::pair<std::string, std::string>>;

/// Values that --preset sets for options that are not given.
struct Preset {
  std::string name;
  std::string help;  ///< empty: the values
  OptionValues values;
  /// Cameras to train on if --cameras is not given: from each entry the first one that the
  /// recording has. Empty: all.
  std::vector<std::vector<std::string>> cameras = {};

  /// Returns the help: "--max-seconds 30".
  std::string text() const;
};

/// The default method: the best after equal time (docs/benchmarks.md).
inline constexpr const char* kDefaultMethod = "splat";

struct Method {
  std::string name;                    ///< --method
  std::string help;                    ///< one line
  std::unique_ptr<Trainee> (*make)();  ///< hyperparameters at their defaults, without parameters
  OptionValues defaults =
      {};  ///< options other than hyperparameters that differ from TrainOptions{}
  std::vector<Preset> presets = {};
  /// Returns defaults that depend on --max-seconds, where it ends the run; may be null. Presets
  /// take precedence.
  OptionValues (*defaults_of_time)(double seconds) = nullptr;
  bool refines_poses = false;      ///< default of --refine-poses for drives
  bool random_background = false;  ///< trains transparent images on random backgrounds
  bool contracts_space = false;    ///< represents space beyond the cube of a bounded recording
  bool rasterises = false;         ///< draws Gaussians instead of marching along rays
  /// Hyperparameter: number of steps between changes of the number of parameters; null: it never
  /// changes.
  const char* change_every = nullptr;
  bench::MethodBenchmarks (*benchmarks)() = nullptr;  ///< null: none
};

/// Returns all methods, in the order of the help text.
const std::vector<Method>& methods();
/// Returns null for an unknown name.
const Method* find_method(std::string_view name);
/// Adds a method, for tests.
void register_method(const Method& method);

/// Returns a model with default hyperparameters and no parameters; null for an unknown method.
std::unique_ptr<Trainee> make_model(std::string_view method);

}  // namespace redrive

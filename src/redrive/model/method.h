// SPDX-License-Identifier: Apache-2.0
// Methods of reconstruction by name. To add one: its files with a function that returns its Method,
// a line in registry.cc, its tests.
#pragma once

#include <memory>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "redrive/model/model.h"

namespace redrive {

/// Options by name with their text, as on the command line: {"near", "1"}.
using OptionValues = std::vector<std::pair<std::string, std::string>>;

/// Values for --preset, of options that are not given.
struct Preset {
  std::string name, help;
  OptionValues values;
  /// Cameras to train on if --cameras is not given; of each entry the first that the recording has.
  /// Empty: all.
  std::vector<std::vector<std::string>> cameras = {};
};

struct Method {
  std::string name;                  ///< --method
  std::string help;                  ///< one line
  std::unique_ptr<Model> (*make)();  ///< hyperparameters at their defaults, without parameters
  OptionValues defaults =
      {};  ///< of options that are no hyperparameters, where they differ from TrainOptions{}
  std::vector<Preset> presets = {};
  bool refines_poses = false;      ///< --refine-poses auto, of a drive
  bool random_background = false;  ///< trains transparent images on random backgrounds
  bool contracts_space = false;    ///< represents what lies beyond the cube of a bounded recording
};

/// In the order of the help text.
const std::vector<Method>& methods();
/// Null if there is none of that name.
const Method* find_method(std::string_view name);
/// Adds a method that the program does not ship: for tests.
void register_method(const Method& method);

/// A model with hyperparameters at their defaults and no parameters. Null for an unknown method.
std::unique_ptr<Model> make_model(std::string_view method);

}  // namespace redrive

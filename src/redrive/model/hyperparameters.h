// SPDX-License-Identifier: Apache-2.0
// Hyperparameters of a method by name. One list per struct (visit_hyperparameters) feeds the
// command line, --set NAME=VALUE, config.json and the metadata of checkpoints.
#pragma once

#include <cstdint>
#include <functional>
#include <limits>
#include <string>
#include <string_view>
#include <vector>

namespace redrive {

/// Name, meaning and range of a hyperparameter.
struct Hyperparameter {
  std::string name;  ///< in --set, config.json and checkpoints, such as "grid.n_levels"
  std::string help;  ///< meaning and unit
  double low = std::numeric_limits<double>::lowest(), high = std::numeric_limits<double>::max();
  bool above_low = false;  ///< low itself is out of range
  int multiple = 1;        ///< integer multiples of this only
  std::string option =
      {};  ///< name of a command-line option of its own, without dashes; empty: --set only
  bool derived = false;  ///< follows from the recording or --near and --far; cannot be set
  bool repeats = false;  ///< a list whose values may repeat

  Hyperparameter exclusive() const;                      ///< with above_low
  Hyperparameter multiple_of(int n) const;               ///< with multiple
  Hyperparameter as_option(const std::string& o) const;  ///< with an option of its own
  Hyperparameter from_recording() const;                 ///< derived
  Hyperparameter repeating() const;                      ///< with repeats

  std::string flag() const { return option.empty() ? "--set " + name : "--" + option; }
  std::string rule() const;           ///< "a multiple of 16 in 16..128"
  bool contains(double value) const;  ///< false for NaN
};

/// Visits hyperparameters by reference, so it may read or write them.
class HyperparameterVisitor {
 public:
  virtual ~HyperparameterVisitor() = default;
  virtual void operator()(const Hyperparameter& what, int& value) = 0;
  virtual void operator()(const Hyperparameter& what, float& value) = 0;
  virtual void operator()(const Hyperparameter& what, double& value) = 0;
  /// In range and ascending, strictly unless it repeats; may be empty.
  virtual void operator()(const Hyperparameter& what, std::vector<std::int64_t>& values) = 0;
};

/// Base of structs whose hyperparameters can be listed, read and set by name.
class Configurable {
 public:
  virtual ~Configurable() = default;
  /// Visits every hyperparameter once, always in the same order.
  virtual void visit_hyperparameters(HyperparameterVisitor& visit) = 0;
};

/// A hyperparameter as text, in the shortest form that parses to the same bits; a list as "10,20".
struct HyperparameterValue {
  Hyperparameter what;
  std::string text;
  bool whole = false;    ///< an integer
  bool is_list = false;  ///< a list of integers
};
std::vector<HyperparameterValue> hyperparameter_values(Configurable& numbers);

/// Sets hyperparameter `name` from text. Returns false for an unknown name. Throws UsageError
/// naming option, value and rule if the text is no number or out of range.
bool set_hyperparameter(Configurable& numbers, std::string_view name, const std::string& text);

/// Throws an error about a hyperparameter that violates a rule.
using HyperparameterFailure = std::function<void(
    const Hyperparameter& what, const std::string& value, const std::string& rule)>;
/// Calls `fail` for the first hyperparameter out of range. visit: passes them to a visitor.
void check_ranges(const std::function<void(HyperparameterVisitor&)>& visit,
                  const HyperparameterFailure& fail);

/// Convert a list to "10,20" and back. steps_from_text returns false if `text` is no such list.
std::string text_from_steps(const std::vector<std::int64_t>& steps);
bool steps_from_text(std::string_view text, std::vector<std::int64_t>* steps);

}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/files/given_options.h"

#include <filesystem>
#include <stdexcept>

#include "redrive/base/error.h"

namespace redrive {

std::vector<std::string> given_names(const GivenFields& given) {
  std::vector<std::string> names;
  for (const auto& [name, values] : given) names.push_back(name);
  return names;
}

TrainField field_named(const std::string& name) {
  for (const TrainField& field : train_fields())
    if (field.name == name) return field;
  throw std::logic_error("no training option " + name);
}

void parse_given(const GivenFields& given, TrainOptions* options) {
  for (const auto& [name, values] : given) {
    const TrainField field = field_named(name);
    for (const std::string& value : values) field.parse(*options, value);
  }
}

TrainOptions options_of_new_run(const GivenFields& given) {
  TrainOptions options;
  parse_given(given, &options);
  validate_fields(options);
  apply_preset(&options, given_names(given));
  if (options.recording.empty()) throw UsageError("RECORDING", "", "must name a folder");
  std::error_code error;
  const std::filesystem::path recording = std::filesystem::absolute(options.recording, error);
  if (error) throw UsageError("RECORDING", options.recording, error.message());
  options.recording = recording.lexically_normal().string();
  validate(options);
  return options;
}

}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/train_command.h"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <string_view>
#include <vector>

#include <nlohmann/json.hpp>

namespace redrive {
namespace {

/// Returns an option's value as on the command line; lists are separated by commas.
std::string word_of(const nlohmann::json& value) {
  if (value.is_string()) return value.get<std::string>();
  std::string text;
  if (value.is_array()) {
    for (const nlohmann::json& element : value)
      text += (text.empty() ? "" : ",") + word_of(element);
    return text;
  }
  text = value.dump();
  return text.ends_with(".0") ? text.substr(0, text.size() - 2) : text;
}

std::string words_of(const std::string& name, const nlohmann::json& value) {
  const std::string flag = " --" + name;
  if (value.is_boolean()) return flag;
  if (!value.is_object()) return flag + " " + shell_word(word_of(value));
  std::string words;
  for (const auto& [key, set] : value.items())
    words += flag + " " + shell_word(key + "=" + word_of(set));
  return words;
}

/// Returns the options that training chooses where those named `given` have the values in `json`.
nlohmann::json chosen_options(const Run& run, Recording* recording, const nlohmann::json& json,
                              const std::vector<std::string>& given) {
  TrainOptions options;
  for (const TrainField& field : train_fields())
    if (std::ranges::find(given, field.name) != given.end()) field.load(options, json);
  apply_preset(&options, given);
  resolve_cameras(&options, recording);
  resolve_bounds(&options, given, *recording);
  const std::unique_ptr<Trainee> model = make_run_model(options, run.scene);
  record_hyperparameters(*model, &options);
  return options_to_json(options);
}

}  // namespace

std::string shell_word(const std::string& word) {
  const auto is_plain = [](char c) {
    return std::isalnum(static_cast<unsigned char>(c)) ||
           std::string_view("_./:=,%+-@").find(c) != std::string_view::npos;
  };
  if (!word.empty() && std::ranges::all_of(word, is_plain)) return word;
  std::string quoted = "'";
  for (const char c : word) quoted += c == '\'' ? std::string("'\\''") : std::string(1, c);
  return quoted + "'";
}

std::string train_command(const Run& run, const TrainOptions& options,
                          const std::filesystem::path& out) {
  const nlohmann::json wanted = options_to_json(options);
  Recording recording = run.recording;  // resolve_cameras adds findings
  std::vector<std::string> given = {"recording", "method"};
  constexpr std::size_t kAlwaysGiven = 2;
  // An option may change the defaults of others, so each that differs is given before the next one
  // is compared, all are compared again, and those go that others imply.
  for (std::size_t before = 0; before != given.size();) {
    before = given.size();
    nlohmann::json chosen = chosen_options(run, &recording, wanted, given);
    for (const auto& [name, value] : wanted.items()) {
      if (chosen.value(name, nlohmann::json()) == value ||
          std::ranges::find(given, name) != given.end())
        continue;
      given.push_back(name);
      chosen = chosen_options(run, &recording, wanted, given);
    }
  }
  for (std::size_t i = kAlwaysGiven; i < given.size();) {
    std::vector<std::string> others = given;
    others.erase(others.begin() + static_cast<std::ptrdiff_t>(i));
    if (chosen_options(run, &recording, wanted, others) == wanted)
      given = others;
    else
      ++i;
  }
  std::string command = "redrive train " + shell_word(options.recording);
  for (std::size_t i = 1; i < given.size(); ++i) command += words_of(given[i], wanted.at(given[i]));
  double longest_m = 0;
  for (const Block& block : run.blocks)
    longest_m = std::max(longest_m, block.end_m - block.start_m);
  // Rounded up: shorter blocks would be more of them.
  if (longest_m > 0) command += " --blocks " + word_of(std::ceil(100 * longest_m) / 100);
  return command + " --out " + shell_word(out.string());
}

}  // namespace redrive

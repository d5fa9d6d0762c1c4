// SPDX-License-Identifier: Apache-2.0
// The one list of training options: name, help, range; default values come from TrainOptions
// itself.
#include <algorithm>
#include <charconv>
#include <cmath>
#include <iterator>
#include <limits>

#include <nlohmann/json.hpp>

#include "redrive/base/did_you_mean.h"
#include "redrive/base/error.h"
#include "redrive/train/files/options.h"

namespace redrive {
namespace {

constexpr double kInfinite = 1e9;  // seconds and metres that no run reaches

template <class T>
std::string text_of(T value) {
  char buffer[64];
  const auto result = std::to_chars(buffer, buffer + sizeof buffer, value);
  return {buffer, result.ptr};
}

template <class T>
T number_of(const std::string& flag, const std::string& text) {
  T value{};
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size())
    throw UsageError(
        flag, text,
        std::is_floating_point_v<T> ? "must be a number" : "must be a whole number in range");
  return value;
}

template <class T>
T number_of(const std::string& flag, const nlohmann::json& json) {
  if constexpr (std::is_floating_point_v<T>) {
    if (json.is_number()) return json.get<T>();
  } else if constexpr (std::is_unsigned_v<T>) {
    if (json.is_number_unsigned()) return json.get<T>();
  } else {
    const bool fits =
        json.is_number_unsigned()
            ? json.get<std::uint64_t>() <= static_cast<std::uint64_t>(std::numeric_limits<T>::max())
            : json.is_number_integer() && json.get<std::int64_t>() >= std::numeric_limits<T>::min();
    if (fits) return json.get<T>();
  }
  throw UsageError(flag, json.dump().substr(0, 80), "must be a number in range");
}

/// low <= value <= high, or low < value with `above`; integer multiples of `multiple`.
template <class T>
struct Range {
  T low, high;
  bool above = false;
  int multiple = 1;

  std::string rule() const {
    if (low == std::numeric_limits<T>::lowest() && high == std::numeric_limits<T>::max())
      return "any whole number";
    const std::string from = above ? "above " + text_of(low) + ", at most " + text_of(high)
                                   : text_of(low) + ".." + text_of(high);
    return multiple > 1 ? "a multiple of " + std::to_string(multiple) + " in " + from : from;
  }
  bool holds(T value) const {
    if constexpr (std::is_integral_v<T>)
      if (value % static_cast<T>(multiple) != 0) return false;
    return (above ? value > low : value >= low) && value <= high;  // false for NaN
  }
};

template <class T>
TrainField number(const std::string& name, T TrainOptions::*member, const Range<T>& range,
                  const std::string& help, const std::string& value = "N") {
  const std::string flag = "--" + name;
  TrainField field;
  field.name = name;
  field.value = value;
  field.help = help;
  field.rule = range.rule();
  field.parse = [=](TrainOptions& o, const std::string& text) {
    o.*member = number_of<T>(flag, text);
  };
  field.save = [=](const TrainOptions& o, nlohmann::json& json) { json[name] = o.*member; };
  field.load = [=](TrainOptions& o, const nlohmann::json& json) {
    o.*member = number_of<T>(flag, json.at(name));
  };
  field.check = [=](const TrainOptions& o) {
    if (!range.holds(o.*member))
      throw UsageError(flag, text_of(o.*member), "must be " + range.rule());
  };
  return field;
}

TrainField text(const std::string& name, const std::string& value,
                std::string TrainOptions::*member, const std::vector<std::string>& choices,
                const std::string& help) {
  TrainField field;
  field.name = name;
  field.value = value;
  field.choices = choices;
  field.help = help;
  for (const std::string& choice : choices)
    if (!choice.empty()) field.rule += (field.rule.empty() ? "" : ", ") + choice;
  field.parse = [=](TrainOptions& o, const std::string& value) { o.*member = value; };
  field.save = [=](const TrainOptions& o, nlohmann::json& json) { json[name] = o.*member; };
  field.load = [=](TrainOptions& o, const nlohmann::json& json) {
    if (!json.at(name).is_string())
      throw UsageError("--" + name, json.at(name).dump().substr(0, 80), "must be a text");
    o.*member = json.at(name).get<std::string>();
  };
  field.check = [=](const TrainOptions& o) {
    for (const std::string& choice : choices)
      if (o.*member == choice) return;
    if (!choices.empty())
      throw UsageError("--" + name, o.*member, unknown_name(o.*member, choices));
  };
  return field;
}

TrainField flag(const std::string& name, bool TrainOptions::*member, const std::string& help) {
  TrainField field;
  field.name = name;
  field.help = help;
  field.is_flag = true;
  field.parse = [=](TrainOptions& o, const std::string&) { o.*member = true; };
  field.save = [=](const TrainOptions& o, nlohmann::json& json) { json[name] = o.*member; };
  field.load = [=](TrainOptions& o, const nlohmann::json& json) {
    if (!json.at(name).is_boolean())
      throw UsageError("--" + name, json.at(name).dump().substr(0, 80), "must be true or false");
    o.*member = json.at(name).get<bool>();
  };
  field.check = [](const TrainOptions&) {};
  return field;
}

/// A,B,C on the command line, an array in JSON; validate() checks the elements.
TrainField list(const std::string& name, const std::string& value,
                std::vector<std::string> TrainOptions::*member, const std::string& help) {
  const std::string flag = "--" + name;
  TrainField field;
  field.name = name;
  field.value = value;
  field.help = help;
  field.parse = [=](TrainOptions& o, const std::string& value) {
    (o.*member).clear();
    for (std::size_t begin = 0; begin <= value.size();) {
      const std::size_t end = std::min(value.find(',', begin), value.size());
      (o.*member).push_back(value.substr(begin, end - begin));
      begin = end + 1;
    }
  };
  field.save = [=](const TrainOptions& o, nlohmann::json& json) { json[name] = o.*member; };
  field.load = [=](TrainOptions& o, const nlohmann::json& json) {
    if (!json.at(name).is_array())
      throw UsageError(flag, json.at(name).dump().substr(0, 80), "must be a list");
    (o.*member).clear();
    for (const nlohmann::json& element : json.at(name)) {
      if (!element.is_string())
        throw UsageError(flag, element.dump().substr(0, 80), "must be a list of texts");
      (o.*member).push_back(element.get<std::string>());
    }
  };
  field.check = [](const TrainOptions&) {};
  return field;
}

/// Returns the names of all methods, the default first.
std::vector<std::string> method_names() {
  std::vector<std::string> names = {kDefaultMethod};
  for (const Method& method : methods())
    if (method.name != kDefaultMethod) names.push_back(method.name);
  return names;
}

std::vector<std::string> preset_names() {
  std::vector<std::string> names = {""};
  for (const Method& method : methods())
    for (const Preset& preset : method.presets)
      if (std::ranges::find(names, preset.name) == names.end()) names.push_back(preset.name);
  return names;
}

std::string preset_help() {
  std::string text;
  for (const std::string& name : method_names()) {
    std::string presets;
    for (const Preset& preset : find_method(name)->presets)
      presets += (presets.empty() ? name + ": " : ", ") + preset.name + " = " + preset.text();
    if (!presets.empty()) text += (text.empty() ? " (" : "; ") + presets;
  }
  return text + ")";
}

/// Returns the names of the methods whose `flag` has this value: "splat and grid".
std::string methods_where(bool Method::*flag, bool value = true) {
  std::string text;
  for (const std::string& name : method_names())
    if (find_method(name)->*flag == value) text += (text.empty() ? "" : " and ") + name;
  return text;
}

/// Returns a number; text that is no number stays text, which loading rejects.
nlohmann::json number_json(const std::string& text) {
  const nlohmann::json json = nlohmann::json::parse(text, nullptr, /*allow_exceptions=*/false);
  return json.is_number() ? json : nlohmann::json(text);
}

/// Returns the text of a number, or of a list of integers.
std::string hyperparameter_text(const std::string& flag, const nlohmann::json& json) {
  if (json.is_number()) return json.dump();
  std::vector<std::int64_t> steps;
  if (!json.is_array()) throw UsageError(flag, json.dump().substr(0, 80), "must be a number");
  for (const nlohmann::json& step : json) steps.push_back(number_of<std::int64_t>(flag, step));
  return text_from_steps(steps);
}

/// Returns a value of config.json as text; empty if there is none.
std::string text_of_json(const nlohmann::json& json) {
  if (json.is_string()) return json.get<std::string>();
  if (json.is_number_float()) return text_of(json.get<double>());
  if (json.is_number()) return json.dump();
  return "";
}

/// Returns the options of each method with their defaults, the default method first.
const std::vector<TrainOptions>& defaults_of_methods() {
  static const std::vector<TrainOptions> all = [] {
    std::vector<TrainOptions> defaults;
    for (const std::string& name : method_names()) {
      TrainOptions& options = defaults.emplace_back();
      options.method = name;
      apply_preset(&options, {});
    }
    return defaults;
  }();
  return all;
}

/// Options of the methods' hyperparameters, each once; the help says which methods have it.
std::vector<TrainField> hyperparameter_fields() {
  std::vector<TrainField> fields;
  for (const std::string& name_of_method : method_names()) {
    const Method& method = *find_method(name_of_method);
    const auto model = method.make();
    for (const HyperparameterValue& value : hyperparameter_values(*model)) {
      const std::string &name = value.what.name, &option = value.what.option;
      if (option.empty()) continue;
      const std::string help = method.name + ": " + value.what.help + " (" +
                               (value.is_list ? "steps" : value.what.rule()) +
                               (value.text.empty() ? "" : "; default: " + value.text) + ")";
      const auto known = std::ranges::find(fields, option, &TrainField::name);
      if (known != fields.end()) {
        known->help += "; " + help;
        continue;
      }
      const std::string flag = "--" + option;
      TrainField field;
      field.name = option;
      field.value = value.is_list ? "A,B" : "N";
      field.group = "Model";
      field.help = help;
      field.hyperparameter = name;
      field.parse = [=](TrainOptions& o, const std::string& text) {
        o.hyperparameters[name] = text;
      };
      field.save = [=](const TrainOptions& o, nlohmann::json& json) {
        const auto given = o.hyperparameters.find(name);
        if (given != o.hyperparameters.end())
          json[option] =
              hyperparameter_json({value.what, given->second, value.whole, value.is_list});
      };
      field.load = [=](TrainOptions& o, const nlohmann::json& json) {
        if (json.contains(option))
          o.hyperparameters[name] = hyperparameter_text(flag, json.at(option));
      };
      field.check = [](const TrainOptions&) {};
      fields.push_back(field);
    }
  }
  return fields;
}

/// Whether a hyperparameter has an option of its own.
bool has_option(const std::string& name) {
  return std::ranges::any_of(hyperparameter_fields(),
                             [&](const TrainField& field) { return field.hyperparameter == name; });
}

/// --set NAME=VALUE; {"NAME": VALUE, ...} in JSON.
TrainField set_field() {
  TrainField field;
  field.name = "set";
  field.value = "NAME=VALUE";
  field.group = "Model";
  field.repeats = true;
  field.help =
      "sets any hyperparameter of the method or of pose refinement; names are listed "
      "under \"hyperparameters\" in the run's config.json, and by the message for an unknown name; "
      "may be given several times";
  field.parse = [](TrainOptions& o, const std::string& text) {
    const std::size_t equals = text.find('=');
    if (equals == std::string::npos || equals == 0)
      throw UsageError("--set", text, "must be NAME=VALUE");
    o.hyperparameters[text.substr(0, equals)] = text.substr(equals + 1);
  };
  field.save = [](const TrainOptions& o, nlohmann::json& json) {
    nlohmann::json& set = json["set"] = nlohmann::json::object();
    for (const auto& [name, text] : o.hyperparameters)
      if (!has_option(name)) set[name] = number_json(text);
  };
  field.load = [](TrainOptions& o, const nlohmann::json& json) {
    if (!json.at("set").is_object())
      throw UsageError("--set", json.at("set").dump().substr(0, 80), "must be an object");
    for (const auto& [name, value] : json.at("set").items())
      o.hyperparameters[name] = hyperparameter_text("--set " + name, value);
  };
  field.check = [](const TrainOptions&) {};
  return field;
}

/// Puts fields into a group of the help.
std::vector<TrainField> group(const char* name, std::vector<TrainField> fields) {
  for (TrainField& field : fields) field.group = name;
  return fields;
}

std::vector<TrainField> data_fields() {
  using O = TrainOptions;
  return group(
      "Data",
      {text("recording", "", &O::recording, {}, "folder of the recording"),
       list("cameras", "A,B", &O::cameras,
            "takes these cameras alone (default: all that have images)"),
       text("frames", "FIRST:LAST[:STEP]", &O::frames, {},
            "frame ids, both included, either may be empty (default: all)"),
       number("downscale", &O::downscale, Range<int>{1, 64},
              "train on images this many times smaller"),
       number("holdout-every", &O::holdout_every, Range<int>{0, 1'000'000},
              "keep every n-th frame for eval; 0: none, not 1"),
       number("train-every", &O::train_every, Range<int>{0, 1'000'000},
              "train on every n-th frame alone and keep the others for eval; 0: on all, not 1"),
       flag("undistort", &O::undistort,
            "resample the images without distortion first, as the report did (pinhole cameras)"),
       flag("outside-files", &O::outside_files,
            "also read images, masks and points that transforms.json names outside of its folder"),
       number("max-damaged", &O::max_damaged, Range<double>{0, 100},
              "percentage of a sensor's images, scans, poses or times that may be damaged or "
              "impossible and are left out; one always may, unless it is 0",
              "PERCENT"),
       text("masks", "WHICH", &O::masks, {},
            "auto: mask the ego vehicle, broken rows and moving objects that the method does not "
            "draw; none: mask nothing; or a folder with CAM.png as in RUN/masks, in place of "
            "computed masks"),
       text("background", "COLOUR", &O::background, {"", "white", "black", "random"},
            "background of transparent pixels in rendering and scoring, which they need; random: "
            "black, on random backgrounds in training, which " +
                methods_where(&Method::random_background) + " can")});
}

std::vector<TrainField> pose_fields() {
  using O = TrainOptions;
  return group(
      "Poses",
      {flag("truth-poses", &O::ground_truth_poses,
            "use the ground-truth poses and calibration of a synthetic recording, to separate "
            "errors of poses from errors of the field"),
       text("poses", "DIR", &O::poses, {},
            "folder that redrive align wrote: use its poses and calibration, of which the run "
            "keeps a copy (default: those of the recording)"),
       flag("align", &O::align,
            "run redrive align first; the run keeps its result and report in RUN/poses"),
       list("rolling-shutter", "MS", &O::rolling_shutter,
            "MS or CAM:MS,CAM:MS: readout time of the rows in ms, the middle one at the image's "
            "time; negative: from the lowest row up; estimate or CAM:estimate: --align estimates "
            "it (default: readout_s of the calibration)"),
       text("refine-poses", "WHEN", &O::refine_poses, {"auto", "on", "off"},
            "refine each frame's pose and each camera's extrinsics and time offset while training; "
            "auto: on for drives with " +
                methods_where(&Method::refines_poses) + ", off for " +
                methods_where(&Method::refines_poses, false) + " and with --truth-poses")});
}

std::vector<TrainField> length_fields() {
  using O = TrainOptions;
  return group(
      "Length",
      {number("max-seconds", &O::max_seconds, Range<double>{0, kInfinite},
              "stop after so many seconds of training, which count from the first step; 0: no "
              "limit; rates of splat and grid follow this time, those of nerf steps",
              "S"),
       number("max-steps", &O::max_steps, Range<std::int64_t>{0, 1'000'000'000'000},
              "stop after so many steps; 0: no limit"),
       number("epochs", &O::epochs, Range<int>{1, 10000}, "passes over all training pixels"),
       number("seed", &O::seed, Range<std::uint64_t>{0, std::numeric_limits<std::uint64_t>::max()},
              "seed of all random numbers"),
       number("checkpoint-every", &O::checkpoint_every, Range<int>{1, 1'000'000'000},
              "steps between checkpoints; at least one in " + text_of(kSecondsPerCheckpoint) +
                  " s is written")});
}

std::vector<TrainField> method_fields() {
  using O = TrainOptions;
  return group("Method",
               {text("method", "M", &O::method, method_names(), "kind of radiance field to train"),
                text("preset", "NAME", &O::preset, preset_names(),
                     "defaults for options that are not given" + preset_help()),
                number("near", &O::near_m, Range<double>{0, kInfinite, true},
                       "first sample of a ray, metres", "M"),
                number("far", &O::far_m, Range<double>{0, kInfinite, true},
                       "last sample of a ray, metres", "M")});
}

std::vector<TrainField> resource_fields() {
  using O = TrainOptions;
  return group(
      "Resources",
      {number("threads", &O::threads, Range<int>{0, 1024}, "0: all that this process may use"),
       text("memory", "BYTES", &O::memory, {},
            "memory that training may use; a run that needs more is rejected before it begins: "
            "bytes, a number of GiB such as 6GiB, or a percentage of the machine's or control "
            "group's"),
       text("gpu-memory", "BYTES", &O::gpu_memory, {},
            "memory of a GPU that training may use, as --memory: a run that needs more is rejected "
            "before it begins; a percentage is that of what the driver leaves to the program"),
       text("backend", "NAME", &O::backend, {"auto", "ref", "cpu", "vulkan"},
            "backend that computes: vulkan is a GPU, for method splat; auto: the first GPU that "
            "passes a self-test, for splat, else the processor"),
       text("isa", "NAME", &O::isa, {"auto", "avx2", "avx512", "avx512-bf16"},
            "instruction set of the cpu backend"),
       text("device", "NAME", &O::device, {},
            "GPU to compute on: its number or a part of its name, as `redrive doctor` lists them; "
            "otherwise the first one; 0,1: of processes that train together, one for each")});
}

}  // namespace

nlohmann::json hyperparameter_json(const HyperparameterValue& value) {
  if (!value.is_list) return number_json(value.text);
  nlohmann::json list = nlohmann::json::array();
  std::vector<std::int64_t> steps;
  steps_from_text(value.text, &steps);
  for (const std::int64_t step : steps) list.push_back(step);
  return list;
}

std::vector<TrainField> train_fields() {
  std::vector<TrainField> fields;
  for (auto make : {data_fields, pose_fields, length_fields, method_fields, hyperparameter_fields,
                    resource_fields})
    std::ranges::move(make(), std::back_inserter(fields));
  fields.push_back(set_field());
  return fields;
}

std::string help_text(const TrainField& field) {
  std::string text = field.help, notes = field.rule;
  const auto add = [&](const std::string& note) { notes += (notes.empty() ? "" : "; ") + note; };
  std::string usual;
  if (field.hyperparameter.empty() && !field.is_flag && !field.repeats)
    for (const TrainOptions& options : defaults_of_methods()) {
      nlohmann::json json;
      field.save(options, json);
      const std::string value = text_of_json(json.value(field.name, nlohmann::json()));
      const bool is_usual = &options == &defaults_of_methods().front();
      if (is_usual && !value.empty()) add("default: " + value);
      if (!is_usual && value != usual && field.name != "method") add(options.method + ": " + value);
      if (is_usual) usual = value;
    }
  return notes.empty() ? text : text + " (" + notes + ")";
}

}  // namespace redrive

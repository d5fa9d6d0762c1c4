// SPDX-License-Identifier: Apache-2.0
// TrainState as a safetensors file and back. Numbers stand in __metadata__ in their shortest exact form (std::to_chars).
#include <charconv>
#include <cmath>

#include "redrive/base/error.h"
#include "redrive/base/files.h"
#include "redrive/train/model.h"
#include "redrive/train/safetensors.h"

namespace redrive {
namespace {

constexpr const char* kFormat = "redrive-nerf-1";

/// The numbers of a state by name, each visited once: the one list that writing and reading share.
template <class State, class Visit>
void visit_numbers(State& state, const Visit& visit) {
  visit("width", state.model.config.width);
  visit("position_octaves", state.model.config.position_octaves);
  visit("direction_octaves", state.model.config.direction_octaves);
  visit("samples", state.model.samples);
  visit("fine_samples", state.model.fine_samples);
  visit("near_m", state.model.near_m);
  visit("far_m", state.model.far_m);
  visit("unit_from_world.center_x", state.model.unit_from_world.center[0]);
  visit("unit_from_world.center_y", state.model.unit_from_world.center[1]);
  visit("unit_from_world.center_z", state.model.unit_from_world.center[2]);
  visit("unit_from_world.scale", state.model.unit_from_world.scale);
  visit("step", state.step);
  visit("seconds", state.seconds);
  visit("seed", state.seed);
  visit("restarts", state.restarts);
  visit("bad_steps", state.bad_steps);
  visit("skipped_steps", state.skipped_steps);
  visit("watch.dead_steps", state.watch.dead_steps);
  visit("watch.first_mse", state.watch.first_mse);
  visit("watch.late_mse", state.watch.late_mse);
  visit("watch.late_variance", state.watch.late_variance);
  visit("window.steps", state.window.steps);
  visit("window.rays", state.window.rays);
  visit("window.loss", state.window.loss);
  visit("window.mse", state.window.mse);
  visit("window.seconds", state.window.seconds);
}

std::string network_prefix(int index) { return index == 0 ? "coarse." : "fine."; }

std::vector<std::int64_t> tensor_shape(const NerfTensor& tensor) {
  if (tensor.columns == 1) return {tensor.rows};  // a bias, as Python expects it
  return {tensor.rows, tensor.columns};
}

void check_model(const TrainState& state, const std::filesystem::path& file) {
  const NerfModel& model = state.model;
  const auto require = [&](bool holds, const char* field, auto value, const char* rule) {
    if (!holds) throw InputError(file, std::string("__metadata__.") + field, std::to_string(value), rule);
  };
  const NerfConfig& config = model.config;
  require(config.width >= 32 && config.width <= 512 && config.width % 32 == 0, "width", config.width,
          "must be a multiple of 32 in 32..512");
  require(config.position_octaves >= 1 && config.position_octaves <= 10, "position_octaves", config.position_octaves,
          "must be in 1..10");
  require(config.direction_octaves >= 1 && config.direction_octaves <= 4, "direction_octaves", config.direction_octaves,
          "must be in 1..4");
  require(model.samples >= 3 && model.samples <= 1024, "samples", model.samples, "must be in 3..1024");
  require(model.fine_samples >= 0 && model.fine_samples <= 1024, "fine_samples", model.fine_samples,
          "must be in 0..1024");
  require(model.near_m > 0, "near_m", model.near_m, "must be above 0");
  require(model.far_m > model.near_m, "far_m", model.far_m, "must be above near_m");
  require(model.unit_from_world.scale > 0, "unit_from_world.scale", model.unit_from_world.scale, "must be above 0");
  require(state.step >= 0, "step", state.step, "must not be negative");
  require(state.seconds >= 0, "seconds", state.seconds, "must not be negative");
  require(state.restarts >= 0, "restarts", state.restarts, "must not be negative");
  require(state.window.steps >= 0, "window.steps", state.window.steps, "must not be negative");
}

const Safetensors::Tensor& take(const Safetensors& parsed, const std::string& name,
                                const std::vector<std::int64_t>& shape, const std::filesystem::path& file) {
  const auto found = parsed.tensors.find(name);
  if (found == parsed.tensors.end()) throw InputError(file, name, "", "missing");
  if (found->second.shape != shape) {
    std::string text;
    for (const std::int64_t size : found->second.shape) text += (text.empty() ? "" : " x ") + std::to_string(size);
    throw InputError(file, name + ".shape", text, "does not match the network's width");
  }
  return found->second;
}

}  // namespace

std::string checkpoint_bytes(const TrainState& state) {
  std::map<std::string, std::string> metadata = {{"format", kFormat}};
  visit_numbers(state, [&](const char* name, const auto& value) {
    char buffer[64];
    metadata[name] = std::string(buffer, std::to_chars(buffer, buffer + sizeof buffer, value).ptr);
  });
  const std::vector<NerfTensor> tensors = nerf_tensors(state.model.config);
  std::vector<SafetensorsEntry> entries;
  for (int network = 0; network < state.model.networks(); ++network)
    for (const NerfTensor& tensor : tensors)
      entries.push_back(
          {network_prefix(network) + tensor.name, tensor_shape(tensor),
           state.model.network(network).subspan(tensor.offset, std::size_t(tensor.rows) * tensor.columns)});
  const std::vector<std::int64_t> all = {static_cast<std::int64_t>(state.model.parameters.size())};
  entries.push_back({"adam.first_moment", all, state.first_moment.span()});
  entries.push_back({"adam.second_moment", all, state.second_moment.span()});
  return safetensors_bytes(metadata, entries);
}

TrainState parse_checkpoint(std::string_view bytes, const std::filesystem::path& file) {
  const Safetensors parsed = parse_safetensors(bytes, file);
  const auto text_of = [&](const std::string& name) {
    const auto found = parsed.metadata.find(name);
    if (found == parsed.metadata.end()) throw InputError(file, "__metadata__." + name, "", "missing");
    return found->second;
  };
  if (text_of("format") != kFormat)
    throw InputError(file, "__metadata__.format", text_of("format"), std::string("must be ") + kFormat);
  TrainState state;
  visit_numbers(state, [&](const char* name, auto& value) {
    const std::string text = text_of(name);
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error != std::errc() || end != text.data() + text.size() || !std::isfinite(static_cast<double>(value)))
      throw InputError(file, std::string("__metadata__.") + name, text.substr(0, 80),
                       "must be a finite number in range");
  });
  check_model(state, file);

  const std::vector<NerfTensor> tensors = nerf_tensors(state.model.config);
  const std::size_t per_network = nerf_parameter_count(state.model.config);
  const std::size_t total = state.model.networks() * per_network;
  const std::vector<std::int64_t> all = {static_cast<std::int64_t>(total)};
  const auto copy = [](const Safetensors::Tensor& from, float* to) {
    std::copy(from.values.begin(), from.values.end(), to);
  };
  // The largest tensor is looked at first: nothing is allocated for a width that the file does not back.
  const Safetensors::Tensor& first = take(parsed, "adam.first_moment", all, file);
  const Safetensors::Tensor& second = take(parsed, "adam.second_moment", all, file);
  state.first_moment = Buffer<float>(total);
  state.second_moment = Buffer<float>(total);
  state.model.parameters = Buffer<float>(total);
  copy(first, state.first_moment.data());
  copy(second, state.second_moment.data());
  for (std::size_t i = 0; i < total; ++i)
    if (state.second_moment[i] < 0)
      throw InputError(file, "adam.second_moment[" + std::to_string(i) + "]", std::to_string(state.second_moment[i]),
                       "must not be negative");
  for (int network = 0; network < state.model.networks(); ++network)
    for (const NerfTensor& tensor : tensors)
      copy(take(parsed, network_prefix(network) + tensor.name, tensor_shape(tensor), file),
           state.model.parameters.data() + network * per_network + tensor.offset);
  const std::size_t expected = state.model.networks() * tensors.size() + 2;
  if (parsed.tensors.size() != expected)
    throw InputError(file, "", std::to_string(parsed.tensors.size()) + " tensors",
                     "must be " + std::to_string(expected));
  return state;
}

void save_checkpoint(const std::filesystem::path& file, const TrainState& state) {
  write_file(file, checkpoint_bytes(state));
}

TrainState load_checkpoint(const std::filesystem::path& file) { return parse_checkpoint(read_file(file), file); }

}  // namespace redrive

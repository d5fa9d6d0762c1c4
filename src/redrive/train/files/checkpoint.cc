// SPDX-License-Identifier: Apache-2.0
// Writes TrainState as a safetensors file and reads it. Numbers are in __metadata__ in their
// shortest exact form (std::to_chars).
#include <algorithm>
#include <charconv>
#include <cmath>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/model/method.h"
#include "redrive/train/files/gains_json.h"
#include "redrive/train/files/safetensors.h"
#include "redrive/train/files/state.h"

namespace redrive {
namespace {

constexpr const char* kCellErrors = "cell_errors";
constexpr const char* kMoments[] = {"adam.first_moment", "adam.second_moment"};
constexpr const char* kPoses[] = {"poses", "poses.first_moment", "poses.second_moment"};
constexpr const char *kPacked = "adam.packed", *kErrors = "adam.errors", *kMean = "parameter_mean";
constexpr const char *kDevice = "device", *kLidarGains = "lidar_gains";
constexpr const char* kFormat = "redrive-22";

/// Visits the scalars of a state, without its model's, once each by name; writing and reading share
/// this list.
template <class State, class Visit>
void visit_numbers(State& state, const Visit& visit) {
  visit("step", state.step);
  visit("pixels_drawn", state.pixels_drawn);
  visit("pixels", state.pixels);
  visit("seconds", state.seconds);
  visit("seed", state.seed);
  visit("restarts", state.restarts);
  visit("rollbacks", state.rollbacks);
  visit("rate_factor", state.rate_factor);
  visit("bad_steps", state.bad_steps);
  visit("skipped_steps", state.skipped_steps);
  visit("mean.steps", state.mean.steps);
  visit("watch.dead_steps", state.watch.dead_steps);
  visit("watch.first_mse", state.watch.first_mse);
  visit("watch.late_mse", state.watch.late_mse);
  visit("watch.late_variance", state.watch.late_variance);
  visit("loss_watch.conditions", state.loss_watch.conditions);
  visit("loss_watch.rays", state.loss_watch.rays);
  visit("loss_watch.smoothed", state.loss_watch.smoothed);
  visit("loss_watch.best", state.loss_watch.best);
  visit("loss_watch.high", state.loss_watch.high);
  visit("window.steps", state.window.steps);
  visit("window.rays", state.window.rays);
  visit("window.loss", state.window.loss);
  visit("window.mse", state.window.mse);
  visit("window.seconds", state.window.seconds);
  visit("poses.frames", state.poses.corrections.frames);
  visit("poses.cameras", state.poses.corrections.cameras);
  visit("poses.updates", state.poses.moments.updates);
}

/// Calls a function of (name, number) for a model's numbers of any type.
template <class Visit>
class ModelVisitor final : public HyperparameterVisitor {
 public:
  explicit ModelVisitor(const Visit& visit) : visit_(visit) {}
  void operator()(const Hyperparameter& what, int& value) override { visit_(what.name, value); }
  void operator()(const Hyperparameter& what, float& value) override { visit_(what.name, value); }
  void operator()(const Hyperparameter& what, double& value) override { visit_(what.name, value); }
  void operator()(const Hyperparameter& what, std::vector<std::int64_t>& steps) override {
    visit_(what.name, steps);
  }

 private:
  const Visit& visit_;
};

/// Visits hyperparameters and state of the model, and the window's sums of its loss terms.
template <class State, class Visit>
void visit_model(State& state, const Visit& visit) {
  ModelVisitor<Visit> visitor(visit);
  state.model->visit_hyperparameters(visitor);
  state.model->visit_state(visitor);
  std::size_t i = 0;
  for (const LossTerm& term : state.model->loss_terms({}))
    visit(std::string("window.") + term.name, state.window.terms[i++]);
}

void check_state(const TrainState& state, const std::filesystem::path& file) {
  const auto require = [&](bool holds, const char* field, auto value, const char* rule) {
    if (!holds)
      throw InputError(file, std::string("__metadata__.") + field, std::to_string(value), rule);
  };
  require(state.step >= 0, "step", state.step, "must not be negative");
  require(state.seconds >= 0, "seconds", state.seconds, "must not be negative");
  require(state.restarts >= 0, "restarts", state.restarts, "must not be negative");
  require(state.rollbacks >= 0, "rollbacks", state.rollbacks, "must not be negative");
  require(state.mean.steps >= 0, "mean.steps", state.mean.steps, "must not be negative");
  require(state.rate_factor > 0 && state.rate_factor <= 1, "rate_factor", state.rate_factor,
          "must be above 0, at most 1");
  require(state.poses.corrections.frames >= 0 && state.poses.corrections.frames <= 10'000'000,
          "poses.frames", state.poses.corrections.frames, "must be in 0..10000000");
  require(state.poses.corrections.cameras >= 0 && state.poses.corrections.cameras <= 100'000,
          "poses.cameras", state.poses.corrections.cameras, "must be in 0..100000");
  require(state.poses.moments.updates >= 0, "poses.updates", state.poses.moments.updates,
          "must not be negative");
  require(state.window.steps >= 0, "window.steps", state.window.steps, "must not be negative");
}

std::size_t product(const std::vector<std::int64_t>& shape) {
  std::size_t size = 1;
  for (const std::int64_t n : shape) size *= static_cast<std::size_t>(n);
  return size;
}

const Safetensors::Tensor& take(const Safetensors& parsed, const std::string& name,
                                const std::vector<std::int64_t>& shape,
                                const std::filesystem::path& file, bool is_float = true) {
  const auto found = parsed.tensors.find(name);
  if (found == parsed.tensors.end()) throw InputError(file, name, "", "missing");
  if (found->second.shape != shape) {
    std::string text;
    for (const std::int64_t size : found->second.shape)
      text += (text.empty() ? "" : " x ") + std::to_string(size);
    throw InputError(file, name + ".shape", text, "does not match the model's numbers");
  }
  if (found->second.is_float != is_float)
    throw InputError(file, name + ".dtype", found->second.is_float ? "F32" : "U32",
                     is_float ? "must be F32" : "must be U32");
  return found->second;
}

/// Returns the numbers of a tensor.
template <class T = float>
Buffer<T> read(const Safetensors& parsed, const std::string& name, std::size_t size,
               const std::filesystem::path& file) {
  const Safetensors::Tensor& tensor =
      take(parsed, name, {static_cast<std::int64_t>(size)}, file, std::is_same_v<T, float>);
  Buffer<T> out(size);
  if (size > 0) tensor.copy_to(out.data());
  return out;
}

std::vector<LidarGains> parse_gains(const std::string& text, const std::filesystem::path& file) {
  nlohmann::json root;
  nlohmann::json& gains = root["__metadata__"][kLidarGains];
  gains = nlohmann::json::parse(text, nullptr, /*allow_exceptions=*/false);
  if (gains.is_discarded())
    throw InputError(file, std::string("__metadata__.") + kLidarGains, text.substr(0, 80),
                     "must be JSON");
  return gains_from_json(JsonField(root, file).at("__metadata__").at(kLidarGains));
}

SafetensorsFile checkpoint_file(const TrainState& state) {
  const Trainee& model = *state.model;
  std::map<std::string, std::string> metadata = {{"format", kFormat}, {"method", model.method()}};
  const auto note = [&]<class T>(const std::string& name, const T& value) {
    if constexpr (std::is_arithmetic_v<T>) {
      char buffer[64];
      metadata[name] =
          std::string(buffer, std::to_chars(buffer, buffer + sizeof buffer, value).ptr);
    } else {
      metadata[name] = text_from_steps(value);
    }
  };
  visit_numbers(state, note);
  visit_model(state, note);
  if (!state.device.empty()) metadata[kDevice] = state.device;
  if (!state.lidar_gains.empty()) metadata[kLidarGains] = gains_to_json(state.lidar_gains).dump();
  std::vector<SafetensorsEntry> entries;
  for (const ModelTensor& tensor : model.tensors())
    entries.push_back({tensor.name,
                       tensor.shape,
                       model.parameters.span().subspan(tensor.offset, product(tensor.shape)),
                       {}});
  const std::vector<std::int64_t> all = {static_cast<std::int64_t>(state.adam.first_moment.size())};
  entries.push_back({kMoments[0], all, state.adam.first_moment.span(), {}});
  entries.push_back({kMoments[1], all, state.adam.second_moment.span(), {}});
  if (const std::span<const std::uint32_t> packed = state.adam.packed; !packed.empty())
    entries.push_back({kPacked, {static_cast<std::int64_t>(packed.size())}, {}, packed});
  if (const std::span<const float> errors = state.adam.errors; !errors.empty())
    entries.push_back({kErrors, {static_cast<std::int64_t>(errors.size())}, errors, {}});
  if (const std::span<const float> mean = state.mean.values; !mean.empty())
    entries.push_back({kMean, {static_cast<std::int64_t>(mean.size())}, mean, {}});
  if (const std::span<const float> errors = state.cell_errors; !errors.empty())
    entries.push_back({kCellErrors, {static_cast<std::int64_t>(errors.size())}, errors, {}});
  if (state.poses.refines()) {
    const std::vector<std::int64_t> of_poses = {
        static_cast<std::int64_t>(state.poses.corrections.size())};
    entries.push_back({kPoses[0], of_poses, state.poses.corrections.values, {}});
    entries.push_back({kPoses[1], of_poses, state.poses.moments.first, {}});
    entries.push_back({kPoses[2], of_poses, state.poses.moments.second, {}});
  }
  return make_safetensors(metadata, std::move(entries));
}

/// Reads Adam's state and errors, which the model's size needs, before the parameters: so that no
/// more is allocated than the file contains.
void read_adam(const Safetensors& parsed, const std::filesystem::path& file, const Trainee& model,
               AdamState* out) {
  const std::size_t packed = model.updated_in_step(), others = model.size() - packed;
  AdamState& adam = *out;
  if (packed > 0) adam.packed = read<std::uint32_t>(parsed, kPacked, packed, file);
  if (const auto i = model.bad_moment(adam.packed))
    throw InputError(file, kPacked + ("[" + std::to_string(*i) + "]"),
                     std::to_string(adam.packed[*i]), "must be of finite moments");
  const std::size_t errors = model.errors();
  if (errors > 0) adam.errors = read(parsed, kErrors, errors, file);
  adam.first_moment = read(parsed, kMoments[0], others, file);
  adam.second_moment = read(parsed, kMoments[1], others, file);
  for (std::size_t i = 0; i < others; ++i)
    if (adam.second_moment[i] < 0)
      throw InputError(file, kMoments[1] + ("[" + std::to_string(i) + "]"),
                       std::to_string(adam.second_moment[i]), "must not be negative");
}

/// Returns the errors of the error map's cells; empty where the file has none.
Buffer<float> read_cell_errors(const Safetensors& parsed, const std::filesystem::path& file) {
  const auto cells = parsed.tensors.find(kCellErrors);
  if (cells == parsed.tensors.end()) return {};
  Buffer<float> errors = read(parsed, kCellErrors, cells->second.size(), file);
  for (std::size_t i = 0; i < errors.size(); ++i)
    if (errors[i] < 0 || errors[i] > kInitialError)
      throw InputError(file, kCellErrors + ("[" + std::to_string(i) + "]"),
                       std::to_string(errors[i]), "must be in 0..1");
  return errors;
}

void read_poses(const Safetensors& parsed, const std::filesystem::path& file, PoseState* poses) {
  const std::size_t of_poses = poses->corrections.size();
  if (of_poses == 0) return;
  const auto values = [&](int i) {
    const Buffer<float> numbers = read(parsed, kPoses[i], of_poses, file);
    return std::vector<float>(numbers.data(), numbers.data() + of_poses);
  };
  poses->corrections.values = values(0);
  poses->moments.first = values(1);
  poses->moments.second = values(2);
  for (const float v : poses->moments.second)
    if (v < 0) throw InputError(file, kPoses[2], std::to_string(v), "must not be negative");
}

}  // namespace

std::string checkpoint_bytes(const TrainState& state) {
  const SafetensorsFile file = checkpoint_file(state);
  std::string bytes;
  for (const std::string_view part : file.parts()) bytes += part;
  return bytes;
}

TrainState parse_checkpoint(std::string_view bytes, const std::filesystem::path& file) {
  const Safetensors parsed = parse_safetensors(bytes, file);
  const auto text_of = [&](const std::string& name) {
    const auto found = parsed.metadata.find(name);
    if (found == parsed.metadata.end())
      throw InputError(file, "__metadata__." + name, "", "missing");
    return found->second;
  };
  if (text_of("format") != kFormat)
    throw InputError(file, "__metadata__.format", text_of("format"),
                     std::string("must be ") + kFormat);
  TrainState state;
  state.model = make_model(text_of("method"));
  if (!state.model) throw InputError(file, "__metadata__.method", text_of("method"), "unknown");
  Trainee& model = *state.model;
  const auto read_number = [&]<class T>(const std::string& name, T& value) {
    const std::string text = text_of(name);
    bool valid = false;
    if constexpr (std::is_arithmetic_v<T>) {
      const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
      valid = error == std::errc() && end == text.data() + text.size() &&
              std::isfinite(static_cast<double>(value));
    } else {
      valid = steps_from_text(text, &value);
    }
    if (!valid)
      throw InputError(file, "__metadata__." + name, text.substr(0, 80),
                       "must be a finite number in range");
  };
  visit_numbers(state, read_number);
  visit_model(state, read_number);
  check_state(state, file);
  const auto fail = [&](const Hyperparameter& what, const std::string& value,
                        const std::string& rule) {
    throw InputError(file, "__metadata__." + what.name, value, rule);
  };
  check_ranges([&](HyperparameterVisitor& visit) { model.visit_hyperparameters(visit); }, fail);
  check_ranges([&](HyperparameterVisitor& visit) { model.visit_state(visit); }, fail);
  model.check(fail);

  if (const auto device = parsed.metadata.find(kDevice); device != parsed.metadata.end())
    state.device = device->second.substr(0, 200);
  if (const auto gains = parsed.metadata.find(kLidarGains); gains != parsed.metadata.end())
    state.lidar_gains = parse_gains(gains->second, file);
  read_adam(parsed, file, model, &state.adam);
  const std::vector<ModelTensor> tensors = model.tensors();
  model.parameters = Buffer<float>(model.size());
  for (const ModelTensor& tensor : tensors)
    take(parsed, tensor.name, tensor.shape, file).copy_to(model.parameters.data() + tensor.offset);
  if (state.mean.steps > 0) state.mean.values = read(parsed, kMean, model.size(), file);
  state.cell_errors = read_cell_errors(parsed, file);
  read_poses(parsed, file, &state.poses);
  const std::size_t expected = tensors.size() + 2 + (model.updated_in_step() > 0) +
                               (model.errors() > 0) + (state.mean.steps > 0) +
                               parsed.tensors.contains(kCellErrors) +
                               3 * (state.poses.corrections.size() > 0);
  if (parsed.tensors.size() != expected)
    throw InputError(file, "", std::to_string(parsed.tensors.size()) + " tensors",
                     "must be " + std::to_string(expected));
  return state;
}

void save_checkpoint(const std::filesystem::path& file, const TrainState& state) {
  write_file(file, checkpoint_file(state).parts());
}

TrainState load_checkpoint(const std::filesystem::path& file) {
  return parse_checkpoint(read_file(file, kMaxDataBytes), file);
}

}  // namespace redrive

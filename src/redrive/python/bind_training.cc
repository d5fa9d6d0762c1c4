// SPDX-License-Identifier: Apache-2.0
// redrive.train: what `redrive train` does for one run.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <exception>
#include <filesystem>

#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include "redrive/base/did_you_mean.h"
#include "redrive/base/error.h"
#include "redrive/python/bindings.h"
#include "redrive/python/calls.h"
#include "redrive/recording/formats/pose_files.h"
#include "redrive/train/files/given_options.h"
#include "redrive/train/files/run_lock.h"
#include "redrive/train/memory.h"
#include "redrive/train/trainer.h"

namespace redrive::python {
namespace {

namespace fs = std::filesystem;
namespace py = pybind11;

/// Returns the text of an option's value, as on the command line: lists joined by commas.
std::string text_of(const py::handle& value) {
  if (!py::isinstance<py::list>(value) && !py::isinstance<py::tuple>(value))
    return py::str(value).cast<std::string>();
  std::string text;
  for (const py::handle& element : value)
    text += (text.empty() ? "" : ",") + py::str(element).cast<std::string>();
  return text;
}

/// Returns the options by the command line's names, in which _ stands for -. UsageError for unknown
/// ones.
GivenFields given_of(const fs::path& recording, const py::kwargs& options) {
  std::map<std::string, TrainField> fields;
  std::vector<std::string> names;
  for (TrainField& field : train_fields()) {
    std::string name = field.name;
    std::ranges::replace(name, '-', '_');
    // --align prints and draws as it goes; poses takes what `redrive align` wrote.
    if (name == "recording" || name == "align") continue;
    names.push_back(name);
    fields.emplace(name, std::move(field));
  }
  GivenFields given{{"recording", {recording.string()}}};
  for (const auto& [key, value] : options) {
    const auto name = py::str(key).cast<std::string>();
    const auto found = fields.find(name);
    if (found == fields.end()) throw UsageError(name, "", unknown_name(name, names));
    const TrainField& field = found->second;
    if (field.is_flag) {
      if (!py::isinstance<py::bool_>(value))
        throw UsageError(name, text_of(value), "must be True or False");
      if (value.cast<bool>()) given[field.name] = {""};
    } else if (field.repeats && py::isinstance<py::dict>(value)) {
      for (const auto& [what, set] : value.cast<py::dict>())
        given[field.name].push_back(text_of(what) + "=" + text_of(set));
    } else {
      given[field.name] = {text_of(value)};
    }
  }
  return given;
}

/// Tells Python's callback between two steps, at most ten times a second.
class Callback : public StepObserver {
 public:
  explicit Callback(py::object function) : function_(std::move(function)) {}

  void between_steps(Run& run) override {
    if (InterruptibleCall::came()) stop_ = true;
    const auto now = std::chrono::steady_clock::now();
    if (stop_ || function_.is_none() || now < due_) return;
    due_ = now + std::chrono::milliseconds(100);
    const TrainState& state = run.state;
    if (const double steps = state.window.steps; steps > 0) {
      loss_ = state.window.loss / steps;
      psnr_db_ = -10 * std::log10(std::max(state.window.mse / steps, 1e-10));
    }
    const py::gil_scoped_acquire locked;
    try {
      py::dict news;
      news["step"] = state.step;
      news["seconds"] = state.seconds;
      news["progress"] = std::min(1.0, run_progress(run.options, state));
      news["loss"] = loss_;
      news["psnr_db"] = psnr_db_;
      const py::object answer = function_(news);
      stop_ = answer.is(py::bool_(false));
    } catch (...) {
      thrown_ = std::current_exception();
      stop_ = true;
    }
  }

  const std::atomic<bool>& stop() const { return stop_; }
  /// With the interpreter's lock.
  void rethrow() {
    if (thrown_) std::rethrow_exception(std::exchange(thrown_, nullptr));
  }

 private:
  const py::object function_;
  std::chrono::steady_clock::time_point due_{};
  double loss_ = 0, psnr_db_ = 0;  ///< means since the last row of metrics.jsonl
  std::atomic<bool> stop_{false};
  std::exception_ptr thrown_;
};

/// A new run before its first step.
struct Prepared {
  Run run;
  std::unique_ptr<kernels::Backend> backend;
  TrainingData data;
  std::optional<RunLock> lock;
};

/// As lead_training of cli/cmd_train.cc.
void prepare(const GivenFields& given, const fs::path& out, Prepared* made) {
  Run& run = made->run;
  run.options = options_of_new_run(given);
  check_run_is_new(out);
  made->backend = make_backend(run.options);
  run.recording = open_recording(run.options);
  std::optional<PoseFiles> poses;
  if (!run.options.poses.empty()) {
    poses = read_pose_files(run.recording, run.options.poses);
    use_external_poses(*poses, run.options.poses, run.options, &run.recording);
  }
  make_run_scene(&run, given_names(given));
  run.state = make_initial_state(run.options, run.scene);
  record_hyperparameters(*run.state.model, &run.options);
  const RunMemory memory = reserve_memory(run, *made->backend);
  made->data = prepare_training_data(&run, made->backend->pool(), memory.cache_bytes);
  run.paths = create_run(
      out, run.options,
      [&](const RunPaths& paths) {
        write_run_masks(paths, made->data, run);
        if (poses) write_pose_files(paths.poses(), *poses);
      },
      run.state.model.get());
  made->lock.emplace(run.paths.root);
}

bool train_run(const fs::path& recording, const fs::path& out, const py::object& progress,
               const py::kwargs& options) {
  const GivenFields given = given_of(recording, options);
  Callback callback(progress);
  Prepared made;
  without_lock([&] { prepare(given, out, &made); });
  const TrainEnd end = without_lock(
      [&] { return train(&made.run, made.data, *made.backend, callback.stop(), &callback); },
      /*looks=*/true);
  callback.rethrow();
  return end == TrainEnd::kFinished;
}

}  // namespace

void bind_training(py::module_& module) {
  module.def(
      "train", &train_run, py::arg("recording"), py::arg("out"), py::kw_only(),
      py::arg("progress") = py::none(),
      "Trains a run on a recording, as `redrive train RECORDING --out OUT`, whose options it takes "
      "by name with _ for -: max_steps=1500, downscale=2, truth_poses=True, cameras=[\"A\", "
      "\"B\"], set={\"NAME\": VALUE}. align is left out: run `redrive align` and give poses.\n\n"
      "progress is called at most ten times a second with a dict: step, seconds of training, "
      "progress 0..1, mean loss and psnr_db of the last steps. Where it returns False or raises, "
      "and at Ctrl-C, training stops with its state saved; `redrive resume` goes on.\n\n"
      "Returns whether training came to its end. Two cores train samples/street in a minute.");
}

}  // namespace redrive::python

// SPDX-License-Identifier: Apache-2.0
#include "redrive/cli/train/training.h"

#include <algorithm>
#include <cstdio>

#include "redrive/base/error.h"
#include "redrive/camera/ray_share.h"
#include "redrive/cli/backend_options.h"
#include "redrive/cli/help.h"
#include "redrive/kernels/device_info.h"
#include "redrive/perception/find_moving.h"
#include "redrive/train/memory.h"
#include "redrive/train/poses/pose_changes.h"
#include "redrive/view/live_view.h"

namespace redrive {

void add_field(CLI::App& command, const TrainField& field, GivenFields* given) {
  const std::string name = field.name;
  CLI::Option* option = nullptr;
  if (field.is_flag) {
    option = command.add_flag_callback("--" + name, [given, name] { (*given)[name] = {""}; });
  } else {
    option = command.add_option_function<std::vector<std::string>>(
        name == "recording" ? "RECORDING" : "--" + name,
        [given, name](const std::vector<std::string>& values) { (*given)[name] = values; });
    option->expected(1)->type_name(field.value)->required(name == "recording");
    option->multi_option_policy(field.repeats ? CLI::MultiOptionPolicy::TakeAll
                                              : CLI::MultiOptionPolicy::Throw);
    if (!field.choices.empty()) option->check(offering(field.choices));
  }
  option->description(help_text(field));
  if (!field.group.empty()) option->group(field.group);
}

std::vector<std::string> devices_of_processes(const TrainOptions& options,
                                              const ProcessGroup& group) {
  const bool is_auto = options.backend == "auto" && options.device.empty() &&
                       options.isa == "auto" && find_method(options.method)->rasterises;
  std::vector<kernels::DeviceInfo> devices;
  std::string reason;
  if (group.on_machine() > 1 && (is_auto || options.backend == "vulkan"))
    devices = kernels::list_devices(&reason);
  for (std::size_t i = 0; is_auto && i < devices.size(); ++i)
    if (!devices[i].is_cpu && devices[i].missing.empty())
      if (std::string fault = kernels::device_fault(devices[i], i); !fault.empty())
        devices[i].missing.push_back(std::move(fault));
  return kernels::devices_of_processes(devices, options.device, group.on_machine());
}

std::optional<std::uint64_t> check_run_memory(const Run& run, kernels::Backend& backend,
                                              const ProcessGroup& group, bool data_parallel) {
  const std::vector<std::string> devices = devices_of_processes(run.options, group);
  const auto device_shares =
      std::ranges::count(devices, devices[static_cast<std::size_t>(group.rank_on_machine())]);
  const RunMemory memory =
      reserve_memory(run, backend, data_parallel, static_cast<std::uint64_t>(group.on_machine()),
                     static_cast<std::uint64_t>(device_shares));
  std::printf("%s\n", describe_memory(memory.need, memory.allowed).c_str());
  if (memory.of_device > 0)
    std::printf(
        "gpu: %s\n",
        memory_text(memory.of_device + memory.images_of_device, memory.allowed_of_device).c_str());
  std::printf("preparing %zu images; seconds of training count from the first step\n",
              run.scene.views.size());
  std::fflush(stdout);
  return memory.cache_bytes;
}

void print_summary(const Run& run, const TrainingData& training, const kernels::Backend& backend) {
  std::printf("%s\n", kernels::describe(backend).c_str());
  if (const std::string now = kernels::identity(backend);
      !run.state.device.empty() && run.state.device != now)
    std::printf("note: step %lld was reached on %s; %s goes on with other last bits\n",
                static_cast<long long>(run.state.step), run.state.device.c_str(), now.c_str());
  const char* unit = run.recording.metric ? " m" : "";
  std::size_t held_out = 0, bytes = 0;
  for (const View& view : run.scene.views) held_out += view.held_out;
  for (const Image8& image : training.images) bytes += image_bytes(image);
  constexpr std::size_t kCamerasShown = 8;  // photographs may have a camera each
  for (std::size_t c = 0; c < std::min(run.scene.rig.size(), kCamerasShown); ++c) {
    const RigCamera& camera = run.scene.rig[c];
    const Mask& mask = training.left_out.masks[c];
    std::printf("camera %s: %s, %d x %d", camera.name.c_str(),
                std::string(camera.camera.info().name).c_str(), camera.camera.width,
                camera.camera.height);
    if (mask.left_out() > 0)
      std::printf(", %.1f %% masked", 100.0 * static_cast<double>(mask.left_out()) /
                                          static_cast<double>(mask.used.size()));
    std::printf("\n");
    if (const double percent = percent_without_ray(camera.recorded); percent > kMuchWithoutRay)
      std::printf("WARNING: camera %s: %s; they are not used\n", camera.name.c_str(),
                  without_ray_text(percent).c_str());
  }
  const auto count_moving = [](const char* what, const MovingObjects& objects) {
    if (const std::size_t n = objects.objects().size(); n > 0)
      std::printf("moving objects %s: %zu, %zu of them found in the LiDAR\n", what, n,
                  found_objects(objects).size());
  };
  count_moving("drawn", MovingObjects(run.scene.actors));
  count_moving("masked", training.left_out.moving);
  if (const LidarReturns& lidar = training.lidar; lidar.n > 0 && run.recording.lidar_files.empty())
    std::printf("%zu points of %s; dropped: %zu that may be occluded\n", lidar.n,
                run.recording.points_file.c_str(), lidar.hidden);
  else if (lidar.n > 0)
    std::printf(
        "%zu LiDAR returns; dropped: %zu unusable, %zu repeated, %zu beyond the trajectory, %zu on "
        "the vehicle, %zu on moving objects\n",
        lidar.n, lidar.unusable, lidar.repeated, lidar.beyond_trajectory, lidar.on_ego,
        lidar.on_moving);
  for (std::size_t k = 1; k < training.lidar.sensors.size(); ++k)
    std::printf("intensities of %s: %.3f of %s's\n", run.recording.lidars[k].name.c_str(),
                double(training.lidar.sensors[k].gain), run.recording.lidars[0].name.c_str());
  for (std::size_t k = 0; k < training.lidar.sensors.size(); ++k)
    if (const auto& beams = training.lidar.sensors[k].beam_gains; !beams.empty()) {
      const auto [least, most] = std::ranges::minmax(beams, {}, &BeamGain::gain);
      std::printf("intensities of %s's beams: %.2f to %.2f of their mean\n",
                  run.recording.lidars[k].name.c_str(), double(least.gain), double(most.gain));
    }
  for (std::size_t k = 0; k < training.lidar.sensors.size(); ++k)
    if (const std::size_t cells = training.lidar.sensors[k].blind.cells(); cells > 0)
      std::printf("the vehicle is in the way of %s in %zu cells of 0.5 x 1 degree\n",
                  run.recording.lidars[k].name.c_str(), cells);
  for (const Finding& damaged : training.damaged)
    std::printf("note: %s: %s\n", damaged.subject.c_str(), damaged.what.c_str());
  if (const auto& damaged = training.lidar.damaged)
    std::printf("note: %s: %s\n", damaged->subject.c_str(), damaged->what.c_str());
  if (run.recording.points_file.empty() || !run.recording.lidar_files.empty())
    if (const std::optional<Finding> lost = lost_returns(training.lidar))
      std::printf("note: %s: %s\n", lost->subject.c_str(), lost->what.c_str());
  if (run.scene.rig.size() > kCamerasShown)
    std::printf("%zu cameras in all\n", run.scene.rig.size());
  char pixels[40] = "decoded when needed";
  if (!training.cache)
    std::snprintf(pixels, sizeof pixels, "%.1f MB of pixels", static_cast<double>(bytes) / 1e6);
  std::printf("%zu frames, %zu images for training, %zu held out, %s; near %g%s, far %g%s\n",
              run.scene.frames.size(), run.scene.views.size() - held_out, held_out, pixels,
              run.scene.near_m, unit, run.scene.far_m, unit);
  std::fflush(stdout);
}

namespace {

int report_end(const Run& run, TrainEnd end) {
  const std::string root = run.paths.root.string();
  if (end == TrainEnd::kInterrupted) {
    std::fprintf(stderr, "redrive: stopped at step %lld, saved; resume with: redrive resume %s\n",
                 static_cast<long long>(run.state.step), root.c_str());
    return kExitInterrupted;
  }
  if (run.state.poses.refines())
    std::printf("%s", describe_changes(pose_changes(run.scene, run.state.poses.corrections,
                                                    pose_refinement(run.options).bounds))
                          .c_str());
  std::printf("finished: step %lld after %.1f s of training; %s\n",
              static_cast<long long>(run.state.step), run.state.seconds,
              run.paths.checkpoint().c_str());
  return kExitOk;
}

}  // namespace

void add_live_view_options(CLI::App& command, LiveViewOptions* options) {
  CLI::Option* const view = command.add_flag(
      "--view", options->view,
      "shows the run in a browser while it trains, as `redrive view`, and afterwards until Ctrl-C");
  add_view_server_options(command, &options->server, view);
}

void check_live_view(const LiveViewOptions& options) {
  if (!options.view) return;
  check_page("--view", "");
  check_address(options.server);
}

LivePage::LivePage(const ViewServerOptions& options)
    : started(start_view_server(options, &preparation)) {
  preparation.begin(*started.server);
}

std::unique_ptr<LivePage> start_live_page(const LiveViewOptions& options) {
  return options.view ? std::make_unique<LivePage>(options.server) : nullptr;
}

int train_to_end(Run* run, const TrainingData& training, kernels::Backend& backend,
                 const std::atomic<bool>& stop, std::unique_ptr<LivePage> page,
                 ProcessGroup* processes) {
  const auto train_with = [&](StepObserver* observer) {
    return report_end(*run, train(run, training, backend, stop, observer, processes));
  };
  if (!page) return train_with(nullptr);
  view::LiveView live(run, backend, stop);
  const std::unique_ptr<LivePage> shown = std::move(page);  // ends before what it shows
  live.use(*shown->started.server, &shown->preparation);
  const int code = train_with(&live);
  live.serve(*run);
  return code;
}

}  // namespace redrive

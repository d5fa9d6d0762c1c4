// SPDX-License-Identifier: Apache-2.0
#include <exception>
#include <filesystem>
#include <variant>

#include <pybind11/functional.h>
#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <nlohmann/json.hpp>

#include "redrive/base/did_you_mean.h"
#include "redrive/base/error.h"
#include "redrive/eval/evaluate.h"
#include "redrive/export/field_file.h"
#include "redrive/python/arrays.h"
#include "redrive/python/bindings.h"
#include "redrive/python/calls.h"
#include "redrive/render/lidar_request.h"
#include "redrive/render/normals.h"
#include "redrive/render/open_to_render.h"
#include "redrive/render/run_renderer.h"

namespace redrive::python {
namespace {

namespace fs = std::filesystem;

/// A run that renders.
class OpenedRun : public Opened {
 public:
  OpenedRun(std::shared_ptr<const Run> run, const kernels::BackendChoice& backend)
      : Opened(run, backend.threads), renderer_(std::move(run), backend) {}

  /// Calls use(renderer), one call at a time.
  template <class Use>
  auto rendering(const Use& use) {
    const std::lock_guard lock(rendering_);
    return use(renderer_);
  }

 private:
  std::mutex rendering_;
  RunRenderer renderer_;
};

/// A rendered image.
struct PyImage {
  RenderedImage image;
  std::shared_ptr<const RayTable> rays;
  std::vector<std::int32_t> id_of;  ///< ids of objects by RenderedImage::ids; empty: not asked for
};

/// Returns the ids by number; kNoActor first.
std::vector<std::int32_t> ids_by_number(const Scene& scene) {
  std::vector<std::int32_t> ids{kNoActor};
  for (const MovingObject& object : scene.actors)
    ids.push_back(static_cast<std::int32_t>(object.id));
  return ids;
}

/// Changes to moving objects, as Python gives them.
struct Traffic {
  std::optional<TrafficEdit> edit;
  std::string actors;

  /// `edit`: None, a dict, or the path of an EDIT.json.
  Traffic(const py::object& edit, std::string actors) : actors(std::move(actors)) {
    if (edit.is_none()) return;
    if (py::isinstance<py::dict>(edit)) {
      const auto text = py::module_::import("json").attr("dumps")(edit).cast<std::string>();
      this->edit = parse_traffic_edit(text, "edit");
    } else {
      fs::path file;
      try {
        file = edit.cast<fs::path>();
      } catch (const py::cast_error&) {
        throw UsageError("edit", std::string(py::str(edit)), "must be None, a dict or a path");
      }
      this->edit = read_traffic_edit(file);
    }
  }
  bool is_recorded() const { return !edit && actors == "all"; }

  /// Calls use(scene) with the changed scene.
  template <class Use>
  auto apply(RunRenderer& renderer, const Use& use) const {
    if (is_recorded()) return use(renderer.run().scene);
    std::vector<std::string> remarks;
    return use(renderer.with_traffic(edit, actors, &remarks));
  }
};

constexpr double kMaxTurn_deg = 360;

/// How a sensor is moved from its place.
SensorShift shift_of(const std::array<double, 3>& translate, const std::string& axes,
                     double yaw_deg, double pitch_deg, const Run& run) {
  for (const double x : translate)
    if (!(std::abs(x) <= kMaxShift_m))
      throw UsageError("translate", std::to_string(x), "must be metres, at most 1e4");
  for (const auto& [name, angle_deg] : {std::pair("yaw", yaw_deg), {"pitch", pitch_deg}})
    if (!(std::abs(angle_deg) <= kMaxTurn_deg))
      throw UsageError(name, std::to_string(angle_deg), "must be degrees, at most 360");
  return {Eigen::Vector3d(translate.data()), shift_axes(axes, run.recording), yaw_deg, pitch_deg};
}

using CameraArgument = std::variant<std::string, NamedCamera>;

RigCamera rig_camera_of(const Opened& run, const CameraArgument& camera) {
  if (const auto* named = std::get_if<NamedCamera>(&camera)) return named->rig;
  return run.scene().rig[run.camera_index(std::get<std::string>(camera))];
}

PyImage render(OpenedRun& run, const CameraArgument& camera,
               const std::optional<std::int64_t>& frame, const std::optional<std::int64_t>& time_ns,
               const py::object& world_from_camera, const std::array<double, 3>& translate,
               const std::string& axes, double yaw, double pitch, bool rolling_shutter,
               const py::object& edit, const std::string& actors, const std::string& exposure,
               bool ids) {
  if (frame.has_value() == time_ns.has_value())
    throw UsageError("frame, time_ns", "", "one of them must be given");
  const Traffic traffic(edit, actors);
  ImageRequest request{rig_camera_of(run, camera)};
  request.labelled = ids;
  const RigCamera& rig = request.camera;
  request.exposed_ns =
      frame ? run.frame_ns(*frame) + rig.time_offset_ns : run.checked_time(*time_ns);
  const SensorShift shift = shift_of(translate, axes, yaw, pitch, run.run());
  if (!world_from_camera.is_none())
    request.world_from_camera = rigid_arguments("world_from_camera", world_from_camera);
  else if (rolling_shutter)
    request.world_from_camera = moved_camera_during(run.scene(), rig, request.exposed_ns, shift);
  else
    request.world_from_camera = {
        moved_camera(run.scene(), rig.body_from_sensor, request.exposed_ns, shift)};
  const std::optional<Exposure> chosen = chosen_exposure(exposure, run.scene());
  const int index = run.scene().camera_index(rig.name);
  if (chosen)
    request.exposure = *chosen;
  else if (index >= 0)
    request.exposure = run.scene().exposure(index, request.exposed_ns - rig.time_offset_ns);
  return without_lock([&] {
    return run.rendering([&](RunRenderer& renderer) {
      return traffic.apply(renderer, [&](const Scene& scene) {
        RenderedImage image = renderer.image(request, scene);
        return PyImage{std::move(image), renderer.rays(rig.camera),
                       ids ? ids_by_number(scene) : std::vector<std::int32_t>()};
      });
    });
  });
}

Points points_of(const LidarScan& scan) {
  Points out;
  for (const LidarRecord& point : scan.points) {
    for (int k = 0; k < 3; ++k) out.position_m.push_back(static_cast<float>(point.position_m[k]));
    out.intensity.push_back(point.intensity);
    out.t_ns.push_back(point.t_ns);
    out.ring.push_back(point.ring);
    out.range_m.push_back(point.range_m);
    out.loss.push_back(point.loss);
    out.actor.push_back(point.actor);
  }
  return out;
}

/// Adds the rays without a return among those that were fired.
void add_lost(const LidarFirings& firings, const LidarScan& scan, Points* out) {
  out->knows_lost = true;
  std::size_t point = 0;
  for (std::size_t i = 0; i < firings.size(); ++i) {
    if (point < scan.firing.size() && scan.firing[point] == i) {
      ++point;
      continue;
    }
    for (int k = 0; k < 3; ++k)
      out->lost_direction.push_back(static_cast<float>(firings.direction[i][k]));
    out->lost_t_ns.push_back(firings.t_ns[i]);
    out->lost_ring.push_back(firings.ring[i]);
  }
}

Points render_scan(OpenedRun& run, std::int64_t frame, const LidarOptions& options,
                   const SensorShift& shift, const Traffic& traffic) {
  const std::int64_t frame_ns = run.frame_ns(frame);
  return without_lock([&] {
    LidarRequest request = parse_lidar_request(options);
    return run.rendering([&](RunRenderer& renderer) {
      return traffic.apply(renderer, [&](const Scene& scene) {
        const Recording& recording = run.run().recording;
        const SensorMotion motion = sensor_motion(request, recording, scene, shift);
        complete_sensor(recording, &request);
        kernels::Backend& backend = renderer.backend();
        const auto firings = firings_of(request, recording, scene, frame, frame_ns, backend.pool());
        if (!firings)
          throw UsageError("frame", std::to_string(frame),
                           "the run has no LiDAR revolution of this frame");
        const LidarScan scan =
            redrive::render_scan(backend, *run.run().field(), *firings, motion, request.scan);
        Points points = points_of(scan);
        add_lost(*firings, scan, &points);
        return points;
      });
    });
  });
}

py::object evaluate_run(OpenedRun& run, int max_images, bool all) {
  const std::string json = without_lock([&] {
    return run.rendering([&](RunRenderer& renderer) {
      EvalOptions options;
      options.max_images = max_images;
      options.all = all;
      return evaluation_to_json(evaluate(run.run(), renderer.backend(), options)).dump();
    });
  });
  return py::module_::import("json").attr("loads")(json);
}

std::vector<std::string> export_run(OpenedRun& run, const fs::path& out, const std::string& to,
                                    bool force, int sh_degree) {
  const std::vector<ExportFormat> own = run.run().field()->export_formats();
  if (std::ranges::find(own, to, &ExportFormat::name) == own.end())
    return export_drive(run, out, to, force);
  if (sh_degree != 0 && sh_degree != 1)
    throw UsageError("sh_degree", std::to_string(sh_degree), "must be 0 or 1");
  if (fs::exists(out) && !force) throw UsageError("out", out.string(), "exists; force replaces it");
  ExportOptions options;
  options.sh_degree = sh_degree;
  without_lock([&] { write_field_file(out, *run.run().field(), to, options); });
  return {};
}

std::shared_ptr<OpenedRun> load(const fs::path& path, const std::string& backend,
                                const std::string& isa, const std::string& device, int threads,
                                const std::optional<double>& max_damaged) {
  return without_lock([&] {
    return std::make_shared<OpenedRun>(
        std::make_shared<const Run>(open_to_render(path, max_damaged)),
        kernels::BackendChoice{backend, isa, threads, device});
  });
}

void bind_image(py::module_& module) {
  using Self = const py::object&;
  const auto of = [](Self self) -> const RenderedImage& {
    return self.cast<const PyImage&>().image;
  };
  py::class_<PyImage>(module, "Image", "A rendered image. The arrays of its layers are read-only.")
      .def_property_readonly(
          "colour",
          [](const PyImage& i) {
            return taken(to_image8(i.image).rgb, {i.image.height, i.image.width, 3});
          },
          "[height, width, 3] uint8: the pixels that `redrive render` writes")
      .def_property_readonly(
          "rgb",
          [of](Self self) {
            return shown(of(self).rgb, {of(self).height, of(self).width, 3}, self);
          },
          "[height, width, 3] float32 in 0..1")
      .def_property_readonly(
          "depth",
          [of](Self self) {
            return shown(of(self).depth, {of(self).height, of(self).width}, self);
          },
          "[height, width] float32: metres along the ray")
      .def_property_readonly(
          "opacity",
          [of](Self self) {
            return shown(of(self).opacity, {of(self).height, of(self).width}, self);
          },
          "[height, width] float32 in 0..1")
      .def_property_readonly(
          "valid",
          [of](Self self) {
            return shown(of(self).valid, {of(self).height, of(self).width}, self)
                .attr("view")("bool");
          },
          "[height, width] bool: where the lens has a ray")
      .def_property_readonly(
          "actor_ids",
          [](const PyImage& i) -> py::object {
            if (i.id_of.empty()) return py::none();
            std::vector<std::int32_t> ids;
            ids.reserve(i.image.ids.size());
            for (const std::uint16_t number : i.image.ids) ids.push_back(i.id_of[number]);
            return taken(std::move(ids), {i.image.height, i.image.width});
          },
          "[height, width] int32: id of the moving object that a pixel shows, -2**31: none; None "
          "unless rendered with ids=True")
      .def_property_readonly(
          "normals",
          [](const PyImage& i) {
            return taken(without_lock([&] { return surface_normals(i.image, *i.rays); }),
                         {i.image.height, i.image.width, 3});
          },
          "[height, width, 3] float32: unit normals, from depth, in camera axes, turned to the "
          "camera; 0 where nothing is seen")
      .def("__repr__", [](const PyImage& i) {
        return "<redrive.Image of " + std::to_string(i.image.width) + " x " +
               std::to_string(i.image.height) + ">";
      });
}

std::map<std::string, std::vector<std::int64_t>> held_out_of(const OpenedRun& opened) {
  const Scene& scene = opened.run().scene;
  std::map<std::string, std::vector<std::int64_t>> frames;
  for (const View& view : scene.views)
    if (view.held_out)
      frames[scene.rig[static_cast<std::size_t>(view.camera)].name].push_back(
          scene.frames[static_cast<std::size_t>(view.frame)].id);
  return frames;
}

}  // namespace

void bind_run(py::module_& module) {
  bind_image(module);
  const auto none = py::none();
  const std::array<double, 3> still{};
  py::class_<OpenedRun, Opened, std::shared_ptr<OpenedRun>>(
      module, "Run",
      "A trained run (redrive.load): also its recording, at the size and with the poses of "
      "training. One image or scan is rendered at a time, by all threads.")
      .def("render", &render, py::arg("camera"), py::arg("frame") = none, py::kw_only(),
           py::arg("time_ns") = none, py::arg("world_from_camera") = none,
           py::arg("translate") = still, py::arg("axes") = "body", py::arg("yaw") = 0.0,
           py::arg("pitch") = 0.0, py::arg("rolling_shutter") = false, py::arg("edit") = none,
           py::arg("actors") = "all", py::arg("exposure") = "own", py::arg("ids") = false,
           "Renders an Image. camera: the name of one of the run, or a Camera. frame: id of the "
           "frame at which it exposes; or time_ns, of its middle row.\n\n"
           "The pose is that of the camera then, translated by metres along axes (body, camera or "
           "local), turned by yaw to the left and pitch upwards, in degrees, with the motion of "
           "the car during a rolling_shutter; or world_from_camera, [4, 4], or [n, 4, 4] at even "
           "times from the upper edge to the lower one.\n\n"
           "edit: a dict as EDIT.json has it, or its path; actors: \"all\", \"none\" or ids "
           "\"3,17\" of moving objects to draw. exposure: own, none or \"CAMERA:FRAME\". ids: "
           "whether the image has actor_ids.")
      .def(
          "render_scan",
          [](OpenedRun& run, std::int64_t frame, const std::string& sensor,
             const std::string& lidar, const std::string& mount, const std::string& range,
             const std::string& points_in, const std::optional<int>& azimuth_steps,
             const std::optional<double>& rate, const std::optional<std::uint64_t>& seed,
             const std::array<double, 3>& translate, const std::string& axes, double yaw,
             double pitch, const py::object& edit, const std::string& actors) {
            return render_scan(
                run, frame, {sensor, lidar, mount, range, points_in, azimuth_steps, rate, seed},
                shift_of(translate, axes, yaw, pitch, run.run()), Traffic(edit, actors));
          },
          py::arg("frame"), py::kw_only(), py::arg("sensor") = "recorded", py::arg("lidar") = "",
          py::arg("mount") = "", py::arg("range") = "", py::arg("points_in") = "sensor",
          py::arg("azimuth_steps") = none, py::arg("rate") = none, py::arg("seed") = none,
          py::arg("translate") = still, py::arg("axes") = "body", py::arg("yaw") = 0.0,
          py::arg("pitch") = 0.0, py::arg("edit") = none, py::arg("actors") = "all",
          "Renders the Scan of a LiDAR's revolution at a frame, by the options of `redrive render "
          "lidar`: sensor recorded, estimated, the name of a known one (\"hdl-64e\"), or beams "
          "\"N\", \"N:MIN:MAX\", \"E1,E2,..\"; lidar the recorded one that is meant; mount "
          "\"X,Y,Z,YAW,PITCH,ROLL\"; range \"MIN:MAX\"; "
          "seed draws which rays return.")
      .def("export", &export_run, py::arg("out"), py::kw_only(), py::arg("to"),
           py::arg("force") = false, py::arg("sh_degree") = ExportOptions().sh_degree,
           "As of a recording, with the run's poses; or writes its Gaussians: to splat-ply, "
           "splat-spz, splat-gltf or splat-usd, with harmonics of degree 0 or 1.")
      .def("evaluate", &evaluate_run, py::kw_only(), py::arg("max_images") = 0,
           py::arg("all") = false,
           "Scores the run as `redrive eval`. Returns a dict as its --json: \"overall\", "
           "\"cameras\", \"lidar\", ...")
      .def_property_readonly(
          "method", [](const OpenedRun& r) { return r.run().options.method; }, "str")
      .def_property_readonly(
          "step", [](const OpenedRun& r) { return r.run().state.step; }, "int: steps trained")
      .def_property_readonly(
          "held_out", &held_out_of,
          "dict of str to list of int: frames of each camera's images that were not trained on");
  module.def(
      "load", &load, py::arg("run"), py::kw_only(), py::arg("backend") = "auto",
      py::arg("isa") = "auto", py::arg("device") = "", py::arg("threads") = 0,
      py::arg("max_damaged") = none,
      "Opens a run, or a drive trained in blocks. Options as of `redrive render`: backend auto, "
      "cpu, vulkan or ref; threads, 0: all.");
}

}  // namespace redrive::python

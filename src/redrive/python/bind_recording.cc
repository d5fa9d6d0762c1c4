// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <filesystem>

#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include "redrive/base/did_you_mean.h"
#include "redrive/base/error.h"
#include "redrive/base/files/output_folder.h"
#include "redrive/base/processes/interruption.h"
#include "redrive/export/drive.h"
#include "redrive/python/arrays.h"
#include "redrive/python/bindings.h"
#include "redrive/python/calls.h"
#include "redrive/recording/formats/recording_reader.h"
#include "redrive/render/open_to_render.h"
#include "redrive/scene/load_views.h"

namespace redrive::python {
namespace {

namespace fs = std::filesystem;

py::ssize_t length(std::size_t n) { return static_cast<py::ssize_t>(n); }

/// Rays as arrays.
struct RayArrays {
  py::array origins, directions, times_ns, valid;
};

RayArrays arrays_of(ImageRays&& rays) {
  const py::ssize_t height = rays.height, width = rays.width, lines = length(rays.t_ns.size());
  // Steps from row to row and from column to column of what the pixels of a line share.
  const auto steps = [&](py::ssize_t line) {
    return rays.by_column ? std::pair<py::ssize_t, py::ssize_t>(0, line)
                          : std::pair<py::ssize_t, py::ssize_t>(line, 0);
  };
  RayArrays out;
  const auto [down, right] = steps(3 * sizeof(float));
  out.origins = repeated(taken(std::move(rays.origin), {lines, 3}), {height, width, 3},
                         {down, right, sizeof(float)});
  out.directions = taken(std::move(rays.direction), {height, width, 3});
  const auto [later_down, later_right] = steps(sizeof(std::int64_t));
  out.times_ns =
      repeated(taken(std::move(rays.t_ns), {lines}), {height, width}, {later_down, later_right});
  out.valid = taken(std::move(rays.is_ray), {height, width}).attr("view")("bool");
  return out;
}

py::array image_of(Opened& opened, const std::string& camera, std::int64_t frame) {
  const View& view = opened.image_of(opened.camera_index(camera), frame);
  Image8 image = without_lock([&] { return load_view(opened.scene(), view); });
  return taken(std::move(image.rgb), {image.height, image.width, 3});
}

py::array mask_of(Opened& opened, const std::string& camera, std::int64_t frame, bool moving) {
  const View view = opened.view_of(opened.camera_index(camera), frame);
  std::vector<std::uint8_t> used = without_lock([&] { return opened.mask(view, moving); });
  const Camera& lens = opened.scene().rig[view.camera].camera;
  return taken(std::move(used), {lens.height, lens.width}).attr("view")("bool");
}

/// Evaluates poses at scalars or arrays of T: [4, 4], or [n, 4, 4].
template <class T, class PoseAt>
py::array poses_at(const py::array_t<T, py::array::c_style | py::array::forcecast>& values,
                   const PoseAt& pose_at) {
  if (values.ndim() > 1) throw UsageError("time_ns, row", "", "must be a number or one axis");
  std::vector<Rigid3d> poses;
  for (py::ssize_t i = 0; i < values.size(); ++i) poses.push_back(pose_at(values.data()[i]));
  return matrices(poses, values.ndim() == 0);
}

using Times = py::array_t<std::int64_t, py::array::c_style | py::array::forcecast>;
using Rows = py::array_t<double, py::array::c_style | py::array::forcecast>;

py::array world_from_camera(const Opened& opened, const std::string& camera,
                            const std::optional<std::int64_t>& frame,
                            const std::optional<std::int64_t>& time_ns,
                            const std::optional<Rows>& row) {
  if (frame.has_value() == time_ns.has_value())
    throw UsageError("frame, time_ns", "", "one of them must be given");
  const int index = opened.camera_index(camera);
  const RigCamera& rig = opened.scene().rig[index];
  const int lines = rig.readout_by_column ? rig.camera.width : rig.camera.height;
  const Rows rows = row ? *row : Rows(py::float_((lines - 1) / 2.0));
  if (frame) {
    const ShutterPoses poses = opened.scene().shutter_poses(opened.view_of(index, *frame), {});
    return poses_at(rows, [&](double y) { return poses.at(row_fraction(y, lines)); });
  }
  return poses_at(rows, [&](double y) {
    const double late = row_fraction(y, lines) - 0.5;
    return opened.scene().world_from_body(
               opened.checked_time(*time_ns) +
               std::llround(late * static_cast<double>(rig.readout_ns))) *
           rig.body_from_sensor;
  });
}

/// A box at a time.
struct PyBox {
  Box box;
  Rigid3d world_from_box;
};

std::vector<PyBox> boxes_of(Opened& opened, std::int64_t frame) {
  opened.frame_ns(frame);
  return without_lock([&] {
    std::vector<PyBox> boxes;
    for (const FrameFile& file : opened.run().recording.box_files) {
      if (file.frame_id != frame) continue;
      for (const Box& box : opened.run().recording.reader->read_boxes(file))
        boxes.push_back({box, opened.scene().world_from_body(box.t_ns) * box.body_from_box});
    }
    return boxes;
  });
}

/// An object over time.
struct Track {
  MovingObject object;
  bool moves = false;
};

std::vector<Track> tracks_of(Opened& opened) {
  return without_lock([&] {
    const MovingObjects& all = opened.objects();
    std::vector<Track> tracks;
    for (const MovingObject& object : all.objects()) tracks.push_back({object, true});
    for (const MovingObject& object : all.parked()) tracks.push_back({object, false});
    std::ranges::stable_sort(tracks, {}, [](const Track& track) { return track.object.id; });
    return tracks;
  });
}

py::array three(const Eigen::Vector3d& v) {
  return taken(std::vector<double>(v.data(), v.data() + 3), {3});
}

template <class Values, class Of>
py::array numbers(const Values& values, const Of& of) {
  std::vector<std::int64_t> out;
  for (const auto& value : values) out.push_back(of(value));
  const py::ssize_t n = length(out.size());
  return taken(std::move(out), {n});
}

std::shared_ptr<Opened> open(const fs::path& path, const std::string& frames,
                             const std::vector<std::string>& cameras, int downscale,
                             const std::string& poses, bool truth_poses, bool outside_files,
                             double max_damaged, int threads) {
  return without_lock([&] {
    return std::make_shared<Opened>(
        std::make_shared<const Run>(open_without_model(
            {.folder = path,
             .downscale = downscale,
             .frames = frames,
             .poses = poses,
             .outside_files = outside_files,
             .max_damaged = max_damaged,
             .cameras = cameras,
             .source = truth_poses ? PoseSource::kGroundTruth : PoseSource::kRecorded})),
        threads);
  });
}

void bind_boxes(py::module_& module) {
  py::class_<PyBox>(module, "Box", "The box of an annotated object in one frame.")
      .def_property_readonly(
          "id", [](const PyBox& b) { return b.box.object_id; },
          "int: the same object in every frame")
      .def_property_readonly(
          "type", [](const PyBox& b) { return b.box.type; }, "str: \"CAR\", ...")
      .def_property_readonly(
          "time_ns", [](const PyBox& b) { return b.box.t_ns; }, "int")
      .def_property_readonly(
          "size", [](const PyBox& b) { return three(b.box.size_m); },
          "[3] float64: length, width, height, metres")
      .def_property_readonly(
          "world_from_box", [](const PyBox& b) { return matrix(b.world_from_box); },
          "[4, 4] float64: box axes x forward, y left, z up at its centre")
      .def_property_readonly(
          "body_from_box", [](const PyBox& b) { return matrix(b.box.body_from_box); },
          "[4, 4] float64, at the box's time")
      .def("__repr__", [](const PyBox& b) {
        return "<redrive.Box " + std::to_string(b.box.object_id) + ": " + b.box.type + ">";
      });
  py::class_<Track>(module, "Track", "An annotated object over time.")
      .def_property_readonly(
          "id", [](const Track& t) { return t.object.id; }, "int")
      .def_property_readonly(
          "type", [](const Track& t) { return t.object.type; }, "str")
      .def_property_readonly(
          "moves", [](const Track& t) { return t.moves; },
          "bool: whether it moves in any frame; parked objects do not")
      .def_property_readonly(
          "size", [](const Track& t) { return three(t.object.size_m); },
          "[3] float64: length, width, height, metres")
      .def_property_readonly(
          "times_ns",
          [](const Track& t) {
            return numbers(t.object.keys, [](const auto& key) { return key.t_ns; });
          },
          "[n] int64: times of its boxes")
      .def_property_readonly(
          "world_from_box",
          [](const Track& t) {
            std::vector<Rigid3d> poses;
            for (const auto& key : t.object.keys) poses.push_back(key.world_from_box);
            return matrices(poses);
          },
          "[n, 4, 4] float64: its boxes then")
      .def(
          "at",
          [](const Track& t, std::int64_t time_ns) -> py::object {
            const auto pose = t.object.world_from_box(time_ns);
            return pose ? py::object(matrix(*pose)) : py::object(py::none());
          },
          py::arg("time_ns"),
          "world_from_box [4, 4] between the boxes, as training has it; None more than 0.1 s away "
          "from them.")
      .def("__repr__", [](const Track& t) {
        return "<redrive.Track " + std::to_string(t.object.id) + ": " + t.object.type + ", " +
               std::to_string(t.object.keys.size()) + " boxes>";
      });
}

/// A property of a scan: an array, or None where it is not known.
template <class T>
auto scan_array(std::vector<T> Points::*member, bool vectors = false, bool is_lost = false) {
  return [=](const py::object& self) -> py::object {
    const auto& points = self.cast<const Points&>();
    const std::vector<T>& values = points.*member;
    const std::size_t n = is_lost ? points.lost_t_ns.size() : points.t_ns.size();
    if (is_lost ? !points.knows_lost : values.empty() && n > 0) return py::none();
    return shown(values, vectors ? Shape{length(n), 3} : Shape{length(n)}, self);
  };
}

void bind_scan(py::module_& module) {
  py::class_<Points>(module, "Scan", "A LiDAR revolution. Its arrays are read-only.")
      .def_property_readonly("points", scan_array(&Points::position_m, true),
                             "[n, 3] float32, metres, in the axes that were asked for")
      .def_property_readonly("intensity", scan_array(&Points::intensity),
                             "[n] float32, 0..1 of full scale")
      .def_property_readonly("times_ns", scan_array(&Points::t_ns), "[n] int64")
      .def_property_readonly("ring", scan_array(&Points::ring),
                             "[n] uint8: number of the beam, 255: not known")
      .def_property_readonly("range", scan_array(&Points::range_m),
                             "[n] float32, metres; None of recorded scans")
      .def_property_readonly("loss", scan_array(&Points::loss),
                             "[n] float32: probability that the ray has no return; None of "
                             "recorded scans")
      .def_property_readonly("actor", scan_array(&Points::actor),
                             "[n] int32: id of the moving object that the point is on, else the "
                             "least int32; None of recorded scans")
      .def_property_readonly("lost_directions", scan_array(&Points::lost_direction, true, true),
                             "[m, 3] float32: unit directions, in the sensor's axes, of rays "
                             "without a return; None where they are not known or asked for")
      .def_property_readonly("lost_times_ns", scan_array(&Points::lost_t_ns, false, true),
                             "[m] int64, or None")
      .def_property_readonly("lost_ring", scan_array(&Points::lost_ring, false, true),
                             "[m] uint8: their beams, counted from the lowest, or None")
      .def_readonly("why_unknown", &Points::why_unknown,
                    "str: why the lost rays are not known; \"\" where they are")
      .def("__len__", [](const Points& p) { return p.t_ns.size(); })
      .def("__repr__", [](const Points& p) {
        return "<redrive.Scan of " + std::to_string(p.t_ns.size()) + " points>";
      });
}

void bind_rays(py::module_& module) {
  py::class_<RayArrays>(module, "Rays", "The rays of an image's pixels, in the world.")
      .def_readonly("origins", &RayArrays::origins,
                    "[height, width, 3] float32, metres; read-only: the pixels of a line share one")
      .def_readonly("directions", &RayArrays::directions,
                    "[height, width, 3] float32, unit; 0 where the lens has no ray")
      .def_readonly("times_ns", &RayArrays::times_ns,
                    "[height, width] int64: exposure; read-only: the pixels of a line share one")
      .def_readonly("valid", &RayArrays::valid, "[height, width] bool: where the lens has a ray");
}

void bind_properties(py::class_<Opened, std::shared_ptr<Opened>>& recording) {
  recording
      .def_property_readonly(
          "path", [](const Opened& o) { return o.run().recording.root; }, "pathlib.Path")
      .def_property_readonly(
          "format", [](const Opened& o) { return o.run().recording.format; },
          "str: \"aimotive\", \"kitti360\", ...")
      .def_property_readonly(
          "metric", [](const Opened& o) { return o.scene().metric; },
          "bool: a drive, in metres and seconds; False: photographs in an arbitrary unit")
      .def_property_readonly(
          "cameras",
          [](const Opened& o) {
            py::dict all;
            for (const NamedCamera& camera : o.cameras()) all[py::str(camera.rig.name)] = camera;
            return all;
          },
          "dict of Camera by name")
      .def_property_readonly(
          "frames",
          [](const Opened& o) {
            return numbers(o.scene().frames, [](const Frame& f) { return f.id; });
          },
          "[n] int64: ids of the frames that a camera has an image of")
      .def_property_readonly(
          "times_ns",
          [](const Opened& o) {
            return numbers(o.scene().frames, [](const Frame& f) { return f.t_ns; });
          },
          "[n] int64: their times")
      .def_property_readonly(
          "lidar_frames",
          [](const Opened& o) {
            return numbers(o.run().recording.scans_of(0),
                           [](const FrameFile& f) { return f.frame_id; });
          },
          "[m] int64: ids of the frames with a LiDAR scan")
      .def_property_readonly(
          "box_frames",
          [](const Opened& o) {
            return numbers(o.run().recording.box_files,
                           [](const FrameFile& f) { return f.frame_id; });
          },
          "[m] int64: ids of the frames with annotated boxes")
      .def_property_readonly(
          "body_from_lidar",
          [](const Opened& o) -> py::object {
            const auto& lidars = o.run().recording.lidars;
            return lidars.empty() ? py::object(py::none())
                                  : py::object(matrix(lidars[0].body_from_lidar));
          },
          "[4, 4] float64 of the first LiDAR, or None without one")
      .def_property_readonly(
          "global_from_world", [](const Opened& o) { return matrix(o.scene().global_from_world); },
          "[4, 4] float64: from the world to the recording's own frame (ECEF, UTM, a map's)")
      .def_property_readonly(
          "notes",
          [](const Opened& o) {
            std::vector<std::string> notes;
            for (const Finding& finding : o.run().recording.findings)
              notes.push_back(finding.subject + ": " + finding.what);
            return notes;
          },
          "list of str: what is missing, damaged and left out, or unusual");
}

void bind_methods(py::class_<Opened, std::shared_ptr<Opened>>& recording) {
  recording
      .def(
          "camera_frames",
          [](const Opened& o, const std::string& camera) {
            const int index = o.camera_index(camera);
            std::vector<std::int64_t> ids;
            for (const View& view : o.scene().views)
              if (view.camera == index) ids.push_back(o.scene().frames[view.frame].id);
            const py::ssize_t n = length(ids.size());
            return taken(std::move(ids), {n});
          },
          py::arg("camera"), "[n] int64: ids of the frames with an image of this camera.")
      .def("image", &image_of, py::arg("camera"), py::arg("frame"),
           "[height, width, 3] uint8: the recorded image, over white where it is transparent.")
      .def("mask", &mask_of, py::arg("camera"), py::arg("frame"), py::arg("moving") = true,
           "[height, width] bool: True where pixels count: not masked by the recording or the "
           "run and, with `moving`, not in the box of a moving object.")
      .def(
          "world_from_body",
          [](const Opened& o, const Times& time_ns) {
            return poses_at(time_ns, [&](std::int64_t t_ns) {
              return o.scene().world_from_body(o.checked_time(t_ns));
            });
          },
          py::arg("time_ns"),
          "[4, 4] float64 at a time, [n, 4, 4] at an array of times: linear between the recorded "
          "poses, up to a second beyond them.")
      .def("export", &export_drive, py::arg("out"), py::kw_only(), py::arg("to"),
           py::arg("force") = false,
           "Writes a drive in the layout of a data set, as `redrive export`: to aimotive, kitti, "
           "kitti360, nuscenes, argoverse2 or ncore. Returns a list of what is written in another "
           "form or left out.")
      .def("world_from_camera", &world_from_camera, py::arg("camera"),
           py::arg("frame") = py::none(), py::kw_only(), py::arg("time_ns") = py::none(),
           py::arg("row") = py::none(),
           "[4, 4] float64 while a row is exposed, [n, 4, 4] for an array of rows; default: the "
           "middle one. With readout_by_column row is a column. The image is that of a frame, or "
           "one whose middle line is exposed at time_ns.")
      .def(
          "rays",
          [](Opened& o, const std::string& camera, std::int64_t frame) {
            const int index = o.camera_index(camera);
            const View view = o.view_of(index, frame);
            return arrays_of(without_lock([&] { return o.rays(index, view); }));
          },
          py::arg("camera"), py::arg("frame"),
          "Rays of every pixel, exact through any lens, with the row's pose of a rolling shutter.")
      .def(
          "scan",
          [](Opened& o, std::int64_t frame, const std::string& axes, bool lost) {
            const Axes chosen = axes_of(axes);
            return without_lock([&] { return o.scan(frame, chosen, lost); });
          },
          py::arg("frame"), py::arg("axes") = "sensor", py::arg("lost") = false,
          "The recorded LiDAR scan of a frame. axes: sensor or body (those at the time of each "
          "point), or world (motion compensated). lost: also finds the rays without a return.")
      .def("boxes", &boxes_of, py::arg("frame"), "list of Box: the annotated objects of a frame.")
      .def("tracks", &tracks_of,
           "list of Track, by id: all annotated objects; of a run also moving ones that the LiDAR "
           "found.")
      .def("__repr__", [](const Opened& o) {
        return "<redrive." + std::string(o.run().field() ? "Run " : "Recording ") +
               (o.run().field() ? o.run().paths.root : o.run().recording.root).string() + ": " +
               o.run().recording.format + ", " + std::to_string(o.cameras().size()) + " cameras, " +
               std::to_string(o.scene().frames.size()) + " frames>";
      });
}

}  // namespace

std::vector<std::string> export_drive(Opened& opened, const fs::path& out, const std::string& to,
                                      bool force) {
  const auto format = std::ranges::find(drive_formats(), to, &DriveFormat::name);
  if (format == drive_formats().end()) {
    std::vector<std::string> names;
    for (const DriveFormat& known : drive_formats()) names.emplace_back(known.name);
    throw UsageError("to", to, unknown_name(to, names));
  }
  return without_lock([&] {
    check_output_folder("out", out, force);
    const Recording drive = drive_of_scene(opened.run().recording, opened.scene());
    std::vector<std::string> remarks;
    write_output_folder("out", out, force, [&](const fs::path& folder) {
      DriveNotes notes = opened.with_pool([&](ThreadPool& pool) {
        return format->write(folder, drive, pool, InterruptibleCall::came());
      });
      remarks = std::move(notes.changed);
      for (const std::string& what : notes.left_out) remarks.push_back("not exported: " + what);
    });
    return remarks;
  });
}

void bind_recording(py::module_& module) {
  bind_boxes(module);
  bind_scan(module);
  bind_rays(module);
  py::class_<Opened, std::shared_ptr<Opened>> recording(
      module, "Recording",
      "A recording of any known format (redrive.open). Its methods may be "
      "called from several threads.");
  bind_properties(recording);
  bind_methods(recording);
  module.def(
      "open", &open, py::arg("path"), py::kw_only(), py::arg("frames") = "",
      py::arg("cameras") = std::vector<std::string>(), py::arg("downscale") = 1,
      py::arg("poses") = "", py::arg("truth_poses") = false, py::arg("outside_files") = false,
      py::arg("max_damaged") = kMostDamagedPercent, py::arg("threads") = 0,
      "Opens a recording; nothing but metadata is read yet. The options are those of `redrive "
      "train`: frames \"FIRST:LAST[:STEP]\"; cameras, all if empty; downscale of images and "
      "intrinsics; poses: a folder that `redrive align` wrote; truth_poses of a made recording; "
      "threads, 0: all.");
}

}  // namespace redrive::python

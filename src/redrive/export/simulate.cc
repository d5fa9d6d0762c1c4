// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/simulate.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstring>
#include <map>
#include <optional>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/progress.h"
#include "redrive/eval/coverage.h"
#include "redrive/export/labels.h"
#include "redrive/export/write_photo_set.h"
#include "redrive/image/image_io.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/parse/rigid_json.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;

/// Seconds since it was made, or since the last call.
class Stopwatch {
 public:
  double lap() {
    const auto now = std::chrono::steady_clock::now();
    return std::chrono::duration<double>(now - std::exchange(last_, now)).count();
  }

 private:
  std::chrono::steady_clock::time_point last_ = std::chrono::steady_clock::now();
};

/// The files of a simulated drive.
class SimulatedReader : public RecordingReader {
 public:
  SimulatedReader(Scene scene, MovingObjects moving)
      : scene_(std::move(scene)), moving_(std::move(moving)) {}

  std::vector<LidarPoint> read_lidar(const FrameFile& file, std::size_t* = nullptr) const override {
    constexpr std::uint64_t kMostBytes = std::uint64_t{1} << 32;
    const std::string bytes = read_file(file.path, kMostBytes);
    std::vector<LidarPoint> points(bytes.size() / sizeof(LidarPoint));
    std::memcpy(static_cast<void*>(points.data()), bytes.data(),
                points.size() * sizeof(LidarPoint));
    return points;
  }
  std::vector<Box> read_boxes(const FrameFile& file) const override {
    return boxes_at(scene_, moving_, scene_.frames[scene_.frame_index(file.frame_id)]);
  }

 private:
  Scene scene_;
  MovingObjects moving_;
};

/// Velocity of an object in the world, m/s.
Eigen::Vector3d velocity_of(const MovingObject& object, std::int64_t t_ns) {
  constexpr std::int64_t kStep_ns = 20'000'000;
  const auto before = object.world_from_box(t_ns - kStep_ns),
             after = object.world_from_box(t_ns + kStep_ns), now = object.world_from_box(t_ns);
  const auto over = [](const Rigid3d& a, const Rigid3d& b, int steps) -> Eigen::Vector3d {
    return (b.translation() - a.translation()) / (1e-9 * double(steps * kStep_ns));
  };
  if (before && after) return over(*before, *after, 2);
  if (before && now) return over(*before, *now, 1);
  if (after && now) return over(*now, *after, 1);
  return Eigen::Vector3d::Zero();
}

/// A view's images until they are files.
struct RenderedView {
  const View* view = nullptr;
  ShutterPoses poses = Rigid3d::Identity();  ///< poses of the labelled image
  std::shared_ptr<const RayTable> rays;
  RenderedImage image;
  /// By the camera of the written images, where that is another one.
  std::optional<RenderedImage> as_written;
  const RenderedImage& labelled() const { return as_written ? *as_written : image; }
  std::vector<float> flow;         ///< empty: none
  std::vector<std::uint8_t> seen;  ///< Coverage::seen; empty: not asked for
  nlohmann::json label;
};

struct SimulatedLidar {
  std::string name;
  LidarRequest request;
  SensorMotion motion;
};

/// Returns the LiDARs to simulate: all of the recording, or the one that a sensor or a mount
/// replaces. `scene`: on its path; must outlive them. UsageError.
std::vector<SimulatedLidar> lidars_of(const SimulateOptions& options, const Recording& recording,
                                      const Scene& scene) {
  std::vector<SimulatedLidar> lidars;
  if (!options.with_lidar) return lidars;
  const LidarRequest asked = parse_lidar_request(options.lidar);
  const auto add = [&](const std::string& name, LidarRequest request) {
    SensorMotion motion = sensor_motion(request, recording, scene, {});
    complete_sensor(recording, &request);
    lidars.push_back({name, std::move(request), std::move(motion)});
  };
  if (!asked.is_of_recording() || asked.mount) {
    if (!asked.mount && recording.lidars.empty()) return lidars;
    if (asked.is_of_recording() && recording.lidar_files.empty()) return lidars;
    const std::size_t meant = lidar_index(asked, recording);
    add(meant < recording.lidars.size() ? recording.lidars[meant].name : asked.options.sensor,
        asked);
    return lidars;
  }
  for (std::size_t k = 0; k < recording.lidars.size(); ++k) {
    if (recording.scans_of(k).empty()) continue;
    LidarOptions own = options.lidar;
    own.lidar = recording.lidars[k].name;
    add(own.lidar, parse_lidar_request(own));
  }
  return lidars;
}

class Simulation {
 public:
  /// `written`: has the scene's cameras.
  Simulation(RunRenderer& renderer, const Scene& scene, const WrittenCameras& written,
             const SimulateOptions& options, const fs::path& folder, SimulateTimes* times)
      : renderer_(renderer),
        scene_(scene),
        labelled_scene_(scene),
        options_(options),
        folder_(folder),
        times_(*times) {
    resampling_.resize(scene.rig.size());
    for (std::size_t c = 0; c < scene.rig.size(); ++c) {
      const auto camera = written.find(scene.rig[c].name);
      if (camera == written.end() || !camera->second.resampled) continue;
      resampling_[c] = make_resampling(camera->second);
      labelled_scene_.rig[c] = make_rig_camera(camera->second.calibration, {});
    }
    for (const RigCamera& camera : scene.rig)
      for (const char* layer : {"images", "labels/images", "labels/ids", "labels/depth",
                                "labels/flow", "labels/guesses", "done"})
        if (is_wanted(layer)) make_folders(folder / layer / camera.name);
    if (options.guesses) coverage_.emplace(renderer.run(), renderer.backend());
    for (const View& view : scene.views) of_frame_[view.frame].push_back(&view);
  }

  void render_frame(int frame) {
    std::vector<RenderedView> rendered;
    Stopwatch watch;
    for (const View* view : of_frame_[frame]) {
      if (fs::exists(done_file(*view))) {
        ++times_.kept;
        continue;
      }
      RenderedView out{view, labelled_scene_.shutter_poses(*view)};
      const bool resampled = resampling_[view->camera].has_value();
      out.image = image_of(*view, scene_, options_.labels && !resampled);
      times_.images_s += watch.lap();
      ++times_.images;
      if (options_.labels && resampled) out.as_written = image_of(*view, labelled_scene_, true);
      out.rays = renderer_.rays(labelled_scene_.rig[view->camera].recorded);
      label(&out);
      times_.labels_s += watch.lap();
      rendered.push_back(std::move(out));
    }
    renderer_.backend().pool().run(static_cast<int>(rendered.size()),
                                   [&](int i) { write(rendered[i]); });
    times_.files_s += watch.lap();
  }

  void render_scan(const SimulatedLidar& lidar, const Frame& frame) {
    const LidarRequest& request = lidar.request;
    const fs::path file = scan_file(lidar.name, frame.id);
    if (fs::exists(file)) return;
    Stopwatch watch;
    const Run& run = renderer_.run();
    // The rays that were fired, wherever the body is now.
    const auto firings = firings_of(request, run.recording, run.scene, frame.id, frame.t_ns,
                                    renderer_.backend().pool());
    std::vector<LidarPoint> points;
    if (firings) {
      ScanOptions scan = request.scan;
      scan.axes = PointAxes::kBody;
      for (const LidarRecord& record :
           redrive::render_scan(renderer_.backend(), *run.field(), *firings, lidar.motion, scan)
               .points)
        points.push_back({record.position_m.cast<float>(), intensity_in_16_bits(record.intensity),
                          record.ring, record.t_ns});
      ++times_.scans;
    }
    write_file(file,
               {reinterpret_cast<const char*>(points.data()), points.size() * sizeof(LidarPoint)});
    times_.scans_s += watch.lap();
  }

  void write_documents() const {
    if (!options_.labels) return;
    std::vector<nlohmann::json> images;
    nlohmann::json poses{{"objects", nlohmann::json::array()}, {"images", nlohmann::json::array()}};
    for (const MovingObject& object : scene_.actors)
      poses["objects"].push_back(
          {{"id", object.id},
           {"type", object.type},
           {"size_m", {object.size_m.x(), object.size_m.y(), object.size_m.z()}}});
    for (const View& view : scene_.views) {
      nlohmann::json label = read_json(done_file(view));
      nlohmann::json pose = label.at("poses");
      label.erase("poses");
      pose["file_name"] = label.at("file_name");
      poses["images"].push_back(std::move(pose));
      images.push_back(std::move(label));
    }
    write_file(folder_ / "labels/instances.json", coco_document(images).dump() + "\n");
    write_file(folder_ / "labels/poses.json", poses.dump(1) + "\n");
  }

  fs::path file_of(const View& view, const char* layer, const char* extension) const {
    return folder_ / layer / scene_.rig[view.camera].name /
           (std::to_string(scene_.frames[view.frame].id) + extension);
  }
  fs::path scan_file(const std::string& lidar, std::int64_t id) const {
    return folder_ / "scans" / lidar / std::to_string(id);
  }

 private:
  RenderedImage image_of(const View& view, const Scene& scene, bool labelled) {
    ImageRequest request{scene.rig[view.camera], scene.camera_during(view), scene.exposed_ns(view),
                         options_.rig.empty() ? scene.exposure(view) : Exposure()};
    request.camera.camera = request.camera.recorded;
    request.labelled = labelled;
    return renderer_.image(request, scene);
  }
  bool is_wanted(std::string_view layer) const {
    if (layer == "labels/flow") return options_.labels && options_.flow;
    if (layer == "labels/guesses") return options_.guesses;
    return options_.labels || !layer.starts_with("labels");
  }
  /// Written last, so that its image is complete.
  fs::path done_file(const View& view) const { return file_of(view, "done", ".json"); }

  /// Returns the next view of its camera; null: there is none.
  const View* next_of(const View& view) const {
    const View* const next = &view + 1;
    return next != scene_.views.data() + scene_.views.size() && next->camera == view.camera
               ? next
               : nullptr;
  }

  void label(RenderedView* out) const {
    const View& view = *out->view;
    const RigCamera& camera = labelled_scene_.rig[view.camera];
    const RenderedImage& image = out->labelled();
    out->label = {{"file_name", "images/" + camera.name + "/" +
                                    std::to_string(scene_.frames[view.frame].id) + ".png"},
                  {"width", image.width},
                  {"height", image.height},
                  {"camera", camera.name},
                  {"frame_id", scene_.frames[view.frame].id},
                  {"exposed_ns", scene_.exposed_ns(view)},
                  {"annotations", nlohmann::json::array()}};
    if (options_.guesses) out->seen = coverage_->seen(camera.recorded, out->poses, image);
    if (!options_.labels) return;
    out->label["annotations"] = annotations_of(image, camera.recorded, out->poses, labelled_scene_);
    nlohmann::json poses{
        {"world_from_camera", rigid_to_json(labelled_scene_.world_from_camera(view))},
        {"world_from_box", nlohmann::json::object()}};
    for (const MovingObject& object : scene_.actors)
      if (const auto pose = object.world_from_box(scene_.exposed_ns(view)))
        poses["world_from_box"][std::to_string(object.id)] = rigid_to_json(*pose);
    out->label["poses"] = std::move(poses);
    const View* const next = options_.flow ? next_of(view) : nullptr;
    if (next)
      out->flow = optical_flow(image, *out->rays, out->poses, labelled_scene_.shutter_poses(*next),
                               renderer_.backend());
  }

  void write(const RenderedView& out) const {
    const View& view = *out.view;
    const RenderedImage& image = out.labelled();
    const fs::path rendered = file_of(view, "images", ".png");
    write_image(rendered, to_image8(out.image));
    if (options_.labels) {
      const fs::path shown = file_of(view, "labels/images", ".png");
      if (const auto& how = resampling_[view.camera]) {
        Image8 again{how->map.width, how->map.height, {}, {}, {}};
        again.rgb =
            resample(how->map, to_image8(out.image).rgb, out.image.width, out.image.height, 3, 0);
        write_image(shown, again);
      } else {
        write_file(shown, read_file(rendered, kMaxImageBytes));
      }
      write_png16(file_of(view, "labels/ids", ".png"), {image.width, image.height, image.ids});
      write_png16(file_of(view, "labels/depth", ".png"),
                  {image.width, image.height, depth_mm(image)});
    }
    if (!out.flow.empty())
      write_file(file_of(view, "labels/flow", ".flo"),
                 make_flo(out.flow, image.width, image.height));
    if (!out.seen.empty()) {
      Image8 guesses{image.width, image.height, std::vector<std::uint8_t>(3 * out.seen.size())};
      for (std::size_t i = 0; i < guesses.rgb.size(); ++i)
        guesses.rgb[i] = image.valid[i / 3] && !out.seen[i / 3] ? 255 : 0;
      write_image(file_of(view, "labels/guesses", ".png"), guesses);
    }
    write_file(done_file(view), out.label.dump() + "\n");
  }

  RunRenderer& renderer_;
  const Scene& scene_;
  Scene labelled_scene_;                               ///< with the cameras of the written images
  std::vector<std::optional<Resampling>> resampling_;  ///< to them, by camera; empty: as rendered
  const SimulateOptions& options_;
  const fs::path& folder_;
  SimulateTimes& times_;
  std::optional<Coverage> coverage_;
  std::map<int, std::vector<const View*>> of_frame_;  ///< key: index into Scene::frames
};

}  // namespace

Scene scene_with_rig(Scene scene, const std::vector<CameraCalibration>& cameras) {
  scene.rig.clear();
  scene.views.clear();
  for (const CameraCalibration& calibration : cameras) {
    const int camera = static_cast<int>(scene.rig.size());
    scene.rig.push_back(make_rig_camera(calibration, {}));
    for (int frame = 0; frame < std::ssize(scene.frames); ++frame)
      scene.views.push_back({.camera = camera, .frame = frame});
  }
  return scene;
}

std::vector<Box> boxes_at(const Scene& scene, const MovingObjects& moving, const Frame& frame) {
  std::vector<const MovingObject*> objects;
  for (const MovingObject& object : scene.actors) objects.push_back(&object);
  for (const MovingObject& object : moving.parked()) objects.push_back(&object);
  const Rigid3d world_from_body = scene.world_from_body(frame.t_ns),
                body_from_world = world_from_body.inverse(Eigen::Isometry);
  const Eigen::Vector3d own =
      scene.global_from_world.linear().transpose() * velocity_at(scene.trajectory, frame.t_ns);
  std::vector<Box> boxes;
  for (const MovingObject* object : objects) {
    const auto pose = object->world_from_box(frame.t_ns);
    if (!pose) continue;
    Box box;
    box.object_id = object->id;
    box.type = object->type;
    box.actor_name = object->type + " " + std::to_string(object->id);
    box.t_ns = frame.t_ns;
    box.body_from_box = body_from_world * *pose;
    box.size_m = object->size_m;
    box.velocity_in_body_m_per_s =
        body_from_world.linear() * (velocity_of(*object, frame.t_ns) - own);
    boxes.push_back(box);
  }
  std::ranges::sort(boxes, {}, &Box::object_id);
  return boxes;
}

Recording simulate(RunRenderer& renderer, const Scene& whole, const SimulateOptions& options,
                   const fs::path& folder, const std::atomic<bool>& stop, SimulateTimes* times,
                   DriveNotes* notes) {
  const Run& run = renderer.run();
  // The rig's cameras come first, since a recorded one may have the same name.
  Recording recorded = run.recording;
  recorded.cameras.clear();
  for (const CameraCalibration& camera : options.rig) recorded.cameras.push_back({camera, {}});
  std::ranges::copy(run.recording.cameras, std::back_inserter(recorded.cameras));
  const WrittenCameras written = options.format->cameras(drive_of_scene(recorded, whole), notes);
  Scene scene = whole;
  std::erase_if(scene.views, [&](const View& view) {
    return !written.contains(scene.rig[static_cast<std::size_t>(view.camera)].name);
  });
  Recording drive = drive_of_scene(recorded, scene);
  const std::vector<SimulatedLidar> lidars = lidars_of(options, run.recording, scene);
  for (const SimulatedLidar& lidar : lidars) make_folders(folder / "scans" / lidar.name);
  Simulation simulation(renderer, scene, written, options, folder, times);
  {
    Progress progress("simulating frames", std::ssize(scene.frames));
    for (int f = 0; f < std::ssize(scene.frames); ++f) {
      if (stop) throw Interrupted();
      simulation.render_frame(f);
      for (const SimulatedLidar& lidar : lidars) simulation.render_scan(lidar, scene.frames[f]);
      progress.count();
    }
  }
  simulation.write_documents();

  drive.reader = std::make_shared<SimulatedReader>(scene, run.moving);
  drive.lidar_files.clear();
  drive.box_files.clear();
  drive.points_file.clear();
  drive.novel.clear();
  drive.ground_truth_frames.clear();
  drive.lidars.clear();
  for (const SimulatedLidar& lidar : lidars) {
    for (const Frame& frame : scene.frames)
      drive.lidar_files.push_back(
          {frame.id, simulation.scan_file(lidar.name, frame.id), drive.lidars.size()});
    drive.lidars.push_back({lidar.name, lidar.motion.body_from_sensor});
  }
  for (const Frame& frame : scene.frames) drive.box_files.push_back({frame.id, {}});
  for (RecordedCamera& camera : drive.cameras) camera.images.clear();
  for (const View& view : scene.views) {
    const std::string& name = scene.rig[view.camera].name;
    const auto camera = std::ranges::find_if(
        drive.cameras, [&](const RecordedCamera& c) { return c.calibration.name == name; });
    ImageFile image;
    image.frame_id = scene.frames[view.frame].id;
    image.path = simulation.file_of(view, "images", ".png");
    camera->images.push_back(image);
  }
  return drive;
}

}  // namespace redrive

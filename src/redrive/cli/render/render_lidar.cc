// SPDX-License-Identifier: Apache-2.0
// redrive render lidar: renders a LiDAR scan into a point file, or the scans of all frames into a
// folder.
#include <algorithm>
#include <cctype>
#include <cstdio>
#include <filesystem>
#include <memory>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/files/output_folder.h"
#include "redrive/base/progress.h"
#include "redrive/cli/backend_options.h"
#include "redrive/cli/command.h"
#include "redrive/cli/frames_option.h"
#include "redrive/cli/help.h"
#include "redrive/cli/output_file.h"
#include "redrive/cli/render/render_options.h"
#include "redrive/cli/train/training.h"
#include "redrive/recording/formats/kitti/kitti_write.h"
#include "redrive/recording/formats/nuscenes/nuscenes_scan.h"
#include "redrive/recording/lidar/las.h"
#include "redrive/recording/lidar/scan_files.h"
#include "redrive/render/lidar_request.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;

struct RenderLidarOptions : MovedSensorOptions {
  LidarOptions lidar;
};

/// A point file format, by the end of its name.
struct ScanFormat {
  const char* ending;
  std::string (*make)(std::span<const LidarRecord> points);
};
constexpr ScanFormat kScanFormats[] = {
    {".las", [](auto points) { return make_las(points, 1e-4, LasFields::kAll); }},
    {".pcd", make_pcd},
    {".ply", make_scan_ply},
    {".pcd.bin", nuscenes::make_scan},
    {".bin", kitti::make_scan}};

/// Returns the format of --out; null: a folder.
const ScanFormat* scan_format(const RenderLidarOptions& options) {
  const fs::path out = options.out;
  std::string name = out.filename().string();
  std::ranges::transform(name, name.begin(), [](unsigned char c) { return std::tolower(c); });
  for (const ScanFormat& format : kScanFormats)
    if (name.ends_with(format.ending)) return &format;
  if (!out.extension().empty() && !fs::is_directory(out))
    throw UsageError(
        "--out", options.out,
        "must end in .las, .pcd, .ply, .bin or .pcd.bin, or be a folder for all frames");
  return nullptr;
}

/// Counts of all scans.
struct ScanCounts {
  std::size_t rays = 0, points = 0, lost = 0, out_of_range = 0;
  bool has_intensity = false;

  void add(const LidarScan& scan, std::size_t firings) {
    rays += firings;
    points += scan.points.size();
    lost += scan.lost;
    out_of_range += scan.out_of_range;
    has_intensity = scan.has_intensity;
  }
};

/// Files of a folder in the layout of KITTI's velodyne_points.
class KittiFolder {
 public:
  explicit KittiFolder(const fs::path& folder) : folder_(folder) {
    std::error_code error;
    fs::create_directory(folder / "data", error);
    if (error) throw IoError(folder / "data", error.message());
  }
  /// Call in ascending order of ids.
  void add(std::int64_t id, std::int64_t t_ns, const LidarFirings& firings, const LidarScan& scan) {
    const auto [first, last] = std::ranges::minmax(firings.t_ns);
    const std::int64_t times[] = {t_ns, first, last};
    for (int k = 0; k < 3; ++k) times_[k].emplace_back(id, times[k]);
    write_file(folder_ / "data" / kitti::file_name(id, ".bin"), kitti::make_scan(scan.points));
  }
  void finish() const {
    const char* const names[] = {"timestamps.txt", "timestamps_start.txt", "timestamps_end.txt"};
    for (int k = 0; k < 3; ++k) write_file(folder_ / names[k], kitti::make_timestamps(times_[k]));
  }

 private:
  fs::path folder_;
  std::vector<std::pair<std::int64_t, std::int64_t>> times_[3];
};

/// UsageError if no ray has a return: the file would be empty.
void require_points(const ScanCounts& counts, const RenderLidarOptions& options) {
  if (counts.points == 0)
    throw UsageError("--sensor", options.lidar.sensor,
                     "has no return: of " + std::to_string(counts.rays) + " rays " +
                         std::to_string(counts.lost) + " are lost and " +
                         std::to_string(counts.out_of_range) + " end out of --range");
}

int run_render_lidar(const RenderLidarOptions& options) {
  const ScanFormat* const format = scan_format(options);
  if (format && options.frame.empty())
    throw UsageError("--out", options.out, "needs --frame; a folder takes all frames");
  if (!format && !options.frame.empty())
    throw UsageError("--frame", options.frame, "is for a file; a folder takes all frames");
  const fs::path out = fs::path(options.out).has_filename() ? fs::path(options.out)
                                                            : fs::path(options.out).parent_path();
  if (format)
    check_output_file("--out", out, options.force);
  else
    check_output_folder("--out", out, options.force);
  LidarRequest request = parse_lidar_request(options.lidar);
  const std::int64_t wanted = format ? parse_frame("--frame", options.frame) : -1;

  const Run run = open_edited_run(options);
  const std::int64_t last_id = run.scene.frames.back().id;
  if (!format && last_id >= kitti::kMaxTimes)
    throw InputError(run.recording.root, "frame id", std::to_string(last_id),
                     "KITTI has files of a line for every number; a million fit");
  const SensorMotion motion =
      sensor_motion(request, run.recording, run.scene, sensor_shift(options, run));
  if (complete_sensor(run.recording, &request))
    std::printf("estimated: %zu beams, %d steps a turn, %.2f Hz\n", request.sensor->beams.size(),
                request.sensor->azimuth_steps, request.sensor->rate_hz);
  const auto backend = make_backend(options.backend, run.options.method);
  std::printf("%s\n", kernels::describe(*backend).c_str());
  ScanCounts counts;
  const auto firings_at = [&](std::int64_t id, std::int64_t t_ns) {
    return firings_of(request, run.recording, run.scene, id, t_ns, backend->pool());
  };
  const auto scan_of = [&](const LidarFirings& firings) {
    LidarScan scan = render_scan(*backend, *run.field(), firings, motion, request.scan);
    counts.add(scan, firings.size());
    return scan;
  };
  if (format) {
    const auto frame = std::ranges::find(run.recording.frames, wanted, &FramePose::id);
    if (frame == run.recording.frames.end()) no_such_frame(options.frame, run);
    const auto firings = firings_at(frame->id, frame->t_ns);
    if (!firings)
      throw UsageError("--frame", options.frame, "the run has no LiDAR revolution of this frame");
    const LidarScan scan = scan_of(*firings);
    require_points(counts, options);
    write_file(out, format->make(scan.points));
  } else {
    const std::atomic<bool>& stop = stop_on_signal();
    Progress progress("rendering revolutions", std::ssize(run.scene.frames));
    int scans = 0;
    write_output_folder("--out", out, options.force, [&](const fs::path& folder) {
      KittiFolder files(folder);
      for (const Frame& frame : run.scene.frames) {
        if (stop) throw Interrupted();
        if (const auto firings = firings_at(frame.id, frame.t_ns)) {
          files.add(frame.id, frame.t_ns, *firings, scan_of(*firings));
          ++scans;
        }
        progress.count();
      }
      if (scans == 0)
        throw UsageError("--sensor", options.lidar.sensor, "the run has no LiDAR revolution");
      require_points(counts, options);
      files.finish();
    });
    std::printf("%d revolutions\n", scans);
  }
  std::printf("%s: %zu points of %zu rays; %zu lost, %zu out of range\n", options.out.c_str(),
              counts.points, counts.rays, counts.lost, counts.out_of_range);
  if (!counts.has_intensity) std::printf("intensity: 0, since the run's method has none\n");
  return kExitOk;
}

}  // namespace

Action configure_render_lidar(CLI::App& command) {
  auto options = std::make_shared<RenderLidarOptions>();
  add_run_option(command, &options->run);
  command
      .add_option("--sensor", options->lidar.sensor,
                  "recorded (the rays of the recording's own revolution that returned), estimated "
                  "(the recording's beams, all rays), " +
                      known_lidar_names() +
                      ", N beams as usual sensors have them, N:MIN:MAX (from MIN to MAX degrees of "
                      "elevation) or elevations E1,E2,..")
      ->capture_default_str();
  command
      .add_option("--lidar", options->lidar.lidar,
                  "the recorded LiDAR that is meant, by its name in inspect")
      ->default_str("the first");
  add_mount_option(command, &options->lidar.mount, "the LiDAR")->default_str("the recording's");
  command
      .add_option("--azimuth-steps", options->lidar.azimuth_steps,
                  "firings of a beam in a revolution")
      ->check(within("--azimuth-steps", 1, 36000))
      ->default_str("the sensor's, or " + std::to_string(LidarSensor().azimuth_steps));
  command.add_option("--rate", options->lidar.rate_hz, "revolutions a second")
      ->check(within("--rate", 0.1, 1000.0))
      ->default_str("the sensor's, or " + number_text(LidarSensor().rate_hz));
  command
      .add_option("--range", options->lidar.range, "MIN:MAX metres: returns outside are dropped")
      ->default_str("the sensor's, or 0.5:200");
  command
      .add_option(
          "--seed", options->lidar.seed,
          "draw which rays return by their probabilities; otherwise a probability of 0.4 decides")
      ->default_str("not drawn");
  command
      .add_option("--points-in", options->lidar.points_in,
                  "axes of the points: sensor or body (those at the time of each point), or world "
                  "(of the scene, motion compensated)")
      ->check(one_of("--points-in", {"sensor", "body", "world"}))
      ->capture_default_str();
  add_motion_options(command, options.get());
  add_render_options(
      command, options.get(), "OUT",
      "points of --frame, .las, .pcd, .ply, .bin (KITTI) or .pcd.bin (nuScenes), or a "
      "folder as KITTI's velodyne_points for all frames");
  return [options] { return run_render_lidar(*options); };
}

}  // namespace redrive

// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/argoverse2/argoverse2.h"

#include <algorithm>
#include <cstdlib>
#include <map>
#include <optional>
#include <set>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/argoverse2/argoverse2_boxes.h"
#include "redrive/recording/formats/argoverse2/argoverse2_scan.h"
#include "redrive/recording/formats/argoverse2/argoverse2_tables.h"
#include "redrive/recording/formats/frame_files.h"
#include "redrive/recording/formats/recording_reader.h"
#include "redrive/recording/formats/timed_images.h"

namespace redrive::argoverse2 {
namespace {

namespace fs = std::filesystem;

constexpr std::int64_t kSameTrigger_ns = 50'000'000;  // cameras fire at 20 Hz
constexpr std::int64_t kBeyondPoses_ns = 20'000'000;

class Reader : public RecordingReader {
 public:
  std::vector<LidarPoint> read_lidar(const FrameFile& file,
                                     std::size_t* left_out = nullptr) const override {
    return parse_scan(read_file(file.path), file.path, lidars.at(file.lidar),
                      scan_times_ns.at(file.path), poses, left_out);
  }
  std::uint64_t lidar_point_count(const FrameFile& file) const override {
    return arrow_rows(file.path);
  }
  std::vector<Box> read_boxes(const FrameFile& file) const override {
    return boxes.at(file.frame_id);
  }

  std::vector<FramePose> poses;
  std::vector<Lidar> lidars;  ///< Recording::lidars
  std::map<fs::path, std::int64_t> scan_times_ns;
  std::map<std::int64_t, std::vector<Box>> boxes;  ///< key: frame; for Recording::box_files
};

/// Returns the cameras that have images and a calibration, the first one first, with findings about
/// the others.
std::vector<TimedImages> list_cameras(const fs::path& root,
                                      const std::map<std::string, CameraCalibration>& calibrations,
                                      std::vector<Finding>* findings) {
  std::vector<TimedImages> cameras;
  std::vector<std::string> without_images;
  for (const fs::path& folder : list_folder(root / "sensors/cameras")) {
    const std::string name = folder.filename().string();
    if (!is_folder(folder)) continue;
    if (!calibrations.contains(name)) {
      findings->push_back({name, std::string("left out: no row of ") + kIntrinsics + " and " +
                                     kExtrinsics + " has it"});
      continue;
    }
    TimedImages camera{name, 0,
                       list_frame_files(folder, "", {".jpg", ".jpeg", ".png"}, name, findings)};
    if (!camera.images.empty()) cameras.push_back(std::move(camera));
  }
  for (const auto& [name, calibration] : calibrations)
    if (std::ranges::find(cameras, name, &TimedImages::camera) == cameras.end())
      without_images.push_back(name);
  if (!without_images.empty())
    findings->push_back({"cameras", counted(without_images.size(), "camera") +
                                        " of the calibration without images here: " +
                                        first_few(without_images, 9)});
  if (cameras.empty())
    throw InputError(root / "sensors/cameras", "", "",
                     "has no image of a camera in " + std::string(kIntrinsics));
  const auto first = std::ranges::find(cameras, kFirstCamera, &TimedImages::camera);
  if (first != cameras.end()) std::rotate(cameras.begin(), first, first + 1);
  return cameras;
}

/// Adds frames, which are the images' times, and the cameras.
void add_cameras(const fs::path& root, const std::vector<FramePose>& poses,
                 const std::map<std::string, CameraCalibration>& calibrations,
                 Recording* recording) {
  std::vector<TimedImages> cameras = list_cameras(root, calibrations, &recording->findings);
  set_time_offsets(kSameTrigger_ns, &cameras);
  recording->frames = join_frames(poses, root / "sensors/cameras", &cameras, &recording->damaged);
  std::erase_if(recording->frames, [&](const FramePose& frame) {
    return frame.t_ns < poses.front().t_ns - kBeyondPoses_ns ||
           frame.t_ns > poses.back().t_ns + kBeyondPoses_ns;
  });
  const DamagedList damaged{"poses", &recording->damaged};
  leave_out_impossible(root / kPoses, {"timestamp_ns", "tx_m, ty_m, tz_m"}, &damaged,
                       &recording->frames);
  add_posed_cameras(std::move(cameras), calibrations, recording);
}

/// Whether the first scan that can be read has returns of a LiDAR.
bool has_returns(const std::vector<FrameFile>& scans, Lidar lidar) {
  for (const FrameFile& scan : scans) try {
      return has_lasers_of(lidar, read_file(scan.path), scan.path);
    } catch (const InputError&) {  // named where all scans are checked
    }
  return false;
}

void add_scans(const fs::path& root, const std::map<std::string, Rigid3d>& extrinsics,
               Reader* reader, Recording* recording) {
  std::vector<Finding>* findings = &recording->findings;
  for (const char* name : {kDownLidar, kUpLidar})
    if (extrinsics.contains(name)) recording->other_sensors.push_back(name);
  std::vector<FrameFile> scans =
      list_frame_files(root / "sensors/lidar", "", {".feather"}, "lidar", findings);
  if (scans.empty()) return;
  for (const auto& [name, lidar] : {std::pair(kUpLidar, Lidar::kUp), {kDownLidar, Lidar::kDown}}) {
    const auto pose = extrinsics.find(name);
    if (pose == extrinsics.end()) {
      if (has_returns(scans, lidar))
        findings->push_back(
            {name, std::string("its returns are not used: no row of ") + kExtrinsics + " has it"});
      continue;
    }
    recording->lidars.push_back({name, pose->second});
    reader->lidars.push_back(lidar);
  }
  if (recording->lidars.empty()) return;
  for (FrameFile& scan : scans) {
    const std::int64_t t_ns = std::min(scan.frame_id, kMaxTime_ns);
    reader->scan_times_ns[scan.path] = t_ns;
    scan.frame_id = t_ns + kRevolution_ns / 2;
  }
  add_timed_scans(std::move(scans), "lidar", recording);
  share_files(recording);
}

/// Returns when the LiDARs look where, from the first scan of each that can be read.
std::vector<SweepTiming> time_sweeps(const Reader& reader, const Recording& recording) {
  std::vector<SweepTiming> timings;
  for (std::size_t k = 0; k < recording.lidars.size(); ++k)
    for (const FrameFile& scan : recording.scans_of(k)) try {
        if (const auto timing =
                sweep_timing(reader.read_lidar(scan), reader.scan_times_ns.at(scan.path),
                             recording.lidars[k].body_from_lidar))
          timings.push_back(*timing);
        break;
      } catch (const InputError&) {  // named where all scans are checked
      }
  return timings;
}

/// Returns how long after the time of its file a point is seen: the middle between the times at
/// which the LiDARs look at it, or of the revolution where no scan tells.
std::int64_t seen_after_ns(const std::vector<SweepTiming>& timings,
                           const Eigen::Vector3d& in_body) {
  if (timings.empty()) return kRevolution_ns / 2;
  std::int64_t sum_ns = 0;
  for (const SweepTiming& timing : timings) sum_ns += timing.seen_after_ns(in_body);
  return sum_ns / std::ssize(timings);
}

/// Adds the annotated objects. Their times are known from scans.
void add_boxes(const fs::path& root, Reader* reader, Recording* recording) {
  std::vector<Finding>* findings = &recording->findings;
  const fs::path file = root / kAnnotations;
  if (!is_there(file)) {
    findings->push_back({"boxes", std::string("none: ") + kAnnotations + " is missing"});
    return;
  }
  const std::vector<SweepTiming> timings = time_sweeps(*reader, *recording);
  std::vector<std::string> impossible;
  const std::vector<Cuboid> cuboids = parse_cuboids(read_file(file), file, &impossible);
  std::set<std::string> unknown;
  std::size_t of_unknown = 0;
  for (const Cuboid& cuboid : cuboids)
    if (!is_known_category(cuboid.category)) {
      unknown.insert(cuboid.category);
      ++of_unknown;
    }
  if (!impossible.empty())
    findings->push_back(
        {"boxes", counted(impossible.size(), "cuboid") +
                      " without a size, a place or a name, left out: " + first_few(impossible, 3)});
  if (!unknown.empty())
    findings->push_back({"boxes", counted(of_unknown, "cuboid") +
                                      " of categories that Argoverse 2 does not list, taken for "
                                      "vehicles: " +
                                      first_few(std::vector(unknown.begin(), unknown.end()))});
  reader->boxes = boxes_of_frames(
      cuboids, reader->poses, recording->frames,
      [&](const Eigen::Vector3d& in_body) { return seen_after_ns(timings, in_body); });
  for (const auto& [frame_id, boxes] : reader->boxes)
    recording->box_files.push_back({frame_id, file});
}

}  // namespace

bool looks_like(const fs::path& root) {
  return is_there(root / kPoses) || is_there(root / kExtrinsics);
}

Recording open(const fs::path& root, PoseSource source) {
  refuse_ground_truth(root, source);
  Recording recording;
  recording.root = root;
  recording.global_frame = GlobalFrame::kArbitrary;
  const auto reader = std::make_shared<Reader>();
  const DamagedList damaged{"poses", &recording.damaged};
  reader->poses = parse_poses(read_file(root / kPoses), root / kPoses, &damaged);
  leave_out_strays(root / kPoses, "tx_m, ty_m, tz_m", damaged, &reader->poses);
  const std::map<std::string, Rigid3d> extrinsics =
      parse_extrinsics(read_file(root / kExtrinsics), root / kExtrinsics);
  std::map<std::string, CameraCalibration> calibrations =
      parse_intrinsics(read_file(root / kIntrinsics), root / kIntrinsics);
  std::erase_if(calibrations, [&](const auto& named) { return !extrinsics.contains(named.first); });
  for (auto& [name, camera] : calibrations) camera.body_from_sensor = extrinsics.at(name);
  add_cameras(root, reader->poses, calibrations, &recording);
  add_scans(root, extrinsics, reader.get(), &recording);
  add_boxes(root, reader.get(), &recording);
  recording.reader = reader;
  return recording;
}

}  // namespace redrive::argoverse2

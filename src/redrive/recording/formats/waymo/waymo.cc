// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/waymo/waymo.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <unordered_map>

#include "redrive/base/error.h"
#include "redrive/base/files/file_container.h"
#include "redrive/base/files/files.h"
#include "redrive/math/upper_median.h"
#include "redrive/recording/core/damaged_text.h"
#include "redrive/recording/core/labels.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/frame_files.h"
#include "redrive/recording/formats/recording_reader.h"
#include "redrive/recording/formats/timed_images.h"
#include "redrive/recording/formats/waymo/tfrecord.h"
#include "redrive/recording/formats/waymo/waymo_frame.h"
#include "redrive/recording/formats/waymo/waymo_scan.h"

namespace redrive::waymo {
namespace {

namespace fs = std::filesystem;

constexpr std::int64_t kRevolution_ns = 100'000'000, kSamePose_ns = 1'000'000;

bool is_segment(const fs::path& path) { return has_extension(path, {".tfrecord"}); }

/// Returns the segment's file. InputError for a folder with several.
fs::path segment_of(const fs::path& root) {
  if (!is_folder(root)) return root;
  std::vector<fs::path> files;
  for (const fs::path& path : list_folder(root))
    if (is_segment(path)) files.push_back(path);
  if (files.empty()) throw InputError(root, "", "", "has no segment that is not hidden");
  if (files.size() > 1)
    throw InputError(root, "", "",
                     "has " + std::to_string(files.size()) + " segments: give one of them, " +
                         files.front().filename().string() + " or another");
  return files.front();
}

/// Images of a segment as files: ROOT/CAMERA/RECORD.jpg; range images are ROOT/LASER/RECORD.range.
class Contents : public FileContainer {
 public:
  struct Scan {
    RangeImage image;
    Revolution revolution;
  };

  explicit Contents(std::shared_ptr<const ByteSource> bytes) : bytes_(std::move(bytes)) {}

  void add(const fs::path& path, ByteSpan jpeg) { images_[path.string()] = jpeg; }
  void add(const fs::path& path, const Scan& scan) { scans_[path.string()] = scan; }
  const Scan& scan(const fs::path& path) const { return scans_.at(path.string()); }
  const ByteSource& bytes() const { return *bytes_; }

  std::optional<std::uint64_t> size(const fs::path& path) const override {
    if (const auto image = images_.find(path.string()); image != images_.end())
      return image->second.size();
    const auto scan = scans_.find(path.string());
    return scan == scans_.end() ? std::nullopt : std::optional(scan->second.image.first.size());
  }
  std::string read(const fs::path& path, std::size_t most) const override {
    const auto image = images_.find(path.string());
    const ByteSpan span = image == images_.end() ? scan(path).image.first : image->second;
    return bytes_->read(span.begin, std::min<std::uint64_t>(most, span.size()));
  }

 private:
  std::shared_ptr<const ByteSource> bytes_;
  std::unordered_map<std::string, ByteSpan> images_;
  std::unordered_map<std::string, Scan> scans_;
};

class Reader : public RecordingReader {
 public:
  std::vector<LidarPoint> read_lidar(const FrameFile& file,
                                     std::size_t* left_out = nullptr) const override {
    const Contents::Scan& scan = contents->scan(file.path);
    return read_scan(contents->bytes(), scan.image, context.lasers.at(scan.image.laser),
                     scan.revolution, poses, file.path, left_out);
  }
  std::uint64_t lidar_point_count(const FrameFile& file) const override {
    const Contents::Scan& scan = contents->scan(file.path);
    return scan.image.first.size() == 0 ? 0 : pixels.at(scan.image.laser);
  }
  std::vector<Box> read_boxes(const FrameFile& file) const override {
    return boxes.at(file.frame_id);
  }

  std::shared_ptr<Contents> contents;
  Context context;
  std::vector<FramePose> poses;
  std::map<int, std::uint64_t> pixels;             ///< pixels of a laser's range images, by laser
  std::map<std::int64_t, std::vector<Box>> boxes;  ///< key: frame; for Recording::box_files
};

/// Returns the calibrations of the first frame that has them. InputError if none of a few has.
Context first_context(const ByteSource& bytes, const std::vector<ByteSpan>& records,
                      const fs::path& file, std::vector<Finding>* findings) {
  constexpr std::size_t kLooked = 10;
  for (std::size_t i = 0; i < std::min(kLooked, records.size()); ++i) try {
      std::vector<Finding> found;
      Context context = parse_context(bytes, records[i], file, &found);
      if (context.cameras.empty()) continue;
      findings->insert(findings->end(), found.begin(), found.end());
      return context;
    } catch (const InputError&) {  // named when its frame is read
    }
  throw InputError(file, "context.camera_calibrations", "", "the first frames have none");
}

/// Reads the frames that can be; `id` of a record is its place in the file.
std::vector<std::pair<std::int64_t, Frame>> read_frames(const ByteSource& bytes,
                                                        const std::vector<ByteSpan>& records,
                                                        const fs::path& file,
                                                        const std::string& context_name,
                                                        Recording* recording) {
  std::vector<std::pair<std::int64_t, Frame>> frames;
  std::vector<std::string> impossible;
  std::size_t zones = 0;
  const DamagedList list{"frames", &recording->damaged};
  for (std::int64_t id = 0; id < std::ssize(records); ++id)
    parse_record(&list, id, [&] {
      Frame frame = parse_frame(bytes, records[static_cast<std::size_t>(id)], id, file, &impossible,
                                &recording->damaged);
      if (frame.context_name != context_name)
        throw InputError(file, "context.name", frame.context_name,
                         "other frames are of " + context_name);
      zones += frame.no_label_zones > 0;
      frames.emplace_back(id, std::move(frame));
    });
  std::ranges::stable_sort(frames, {}, [](const auto& frame) { return frame.second.t_ns; });
  if (!impossible.empty())
    recording->findings.push_back(
        {"boxes", counted(impossible.size(), "box") + "es left out: " + first_few(impossible, 3)});
  if (zones > 0)
    recording->findings.push_back(
        {"boxes",
         counted(zones, "frame") + " with no-label zones, in which objects have no boxes"});
  return frames;
}

/// Poses of frames and of images, by time; ids count.
std::vector<FramePose> all_poses(const std::vector<std::pair<std::int64_t, Frame>>& frames) {
  std::vector<FramePose> poses;
  for (const auto& [id, frame] : frames) {
    poses.push_back({0, frame.t_ns, frame.world_from_body});
    for (const Image& image : frame.images)
      poses.push_back({0, image.pose_ns, image.world_from_body});
  }
  std::ranges::stable_sort(poses, {}, &FramePose::t_ns);
  std::vector<FramePose> apart;
  for (FramePose& pose : poses)
    if (apart.empty() || pose.t_ns - apart.back().t_ns >= kSamePose_ns) {
      pose.id = std::ssize(apart);
      apart.push_back(pose);
    }
  return apart;
}

void add_cameras(const fs::path& file, const std::vector<std::pair<std::int64_t, Frame>>& frames,
                 const Context& context, const std::vector<FramePose>& poses, Contents* contents,
                 Recording* recording) {
  std::map<int, TimedImages> cameras;
  std::map<int, std::vector<double>> readouts_ns;
  std::set<int> unknown;
  for (const auto& [id, frame] : frames)
    for (const Image& image : frame.images) {
      const std::string name = camera_name(image.camera);
      if (!context.cameras.contains(image.camera)) {
        unknown.insert(image.camera);
        continue;
      }
      char number[24];
      std::snprintf(number, sizeof number, "%06lld.jpg", static_cast<long long>(id));
      const fs::path path = recording->root / name / number;
      contents->add(path, image.jpeg);
      TimedImages& camera = cameras[image.camera];
      camera.camera = name;
      camera.images.push_back({std::llround(5e8 * (image.trigger_s + image.done_s)), path});
      readouts_ns[image.camera].push_back(
          1e9 * std::max(0.0, image.done_s - image.trigger_s - image.shutter_s));
    }
  for (const int camera : unknown)
    recording->findings.push_back({camera_name(camera), "left out: it has no calibration"});
  std::vector<TimedImages> timed;
  std::map<std::string, CameraCalibration> calibrations;
  for (auto& [number, images] : cameras) {
    const CameraContext& camera = context.cameras.at(number);
    CameraCalibration calibration = camera.calibration;
    const double readout_ns = upper_median(readouts_ns.at(number));
    calibration.readout_ns = camera.direction * std::llround(readout_ns);
    std::ranges::stable_sort(images.images, {}, &FrameFile::frame_id);
    calibrations[calibration.name] = calibration;
    timed.push_back(std::move(images));
  }
  add_timed_cameras(poses, file, {"pose_timestamp", "pose"}, std::move(timed), calibrations,
                    kOneFrame_ns, recording);
}

/// Number of pixels of a range image; 1 for a damaged one, which is named when it is read.
std::uint64_t pixel_count(const ByteSource& bytes, const RangeImage& image, const fs::path& path) {
  try {
    const Matrix matrix = parse_matrix(bytes, image.first, path, laser_name(image.laser));
    return std::max<std::uint64_t>(1, matrix.values.size() / std::uint64_t(matrix.dims.back()));
  } catch (const InputError&) {
    return 1;
  }
}

void add_lidars(const std::vector<std::pair<std::int64_t, Frame>>& frames, Reader* reader,
                Recording* recording) {
  std::map<int, std::vector<FrameFile>> scans;
  bool has_second = false;
  std::size_t without_first = 0;
  for (std::size_t i = 0; i < frames.size(); ++i) {
    const auto& [id, frame] = frames[i];
    const std::int64_t next_ns =
        i + 1 < frames.size() ? frames[i + 1].second.t_ns : frame.t_ns + kRevolution_ns;
    const Revolution revolution{frame.t_ns, std::min(next_ns, frame.t_ns + 2 * kRevolution_ns),
                                frame.world_from_body};
    for (const RangeImage& image : frame.range_images) {
      if (image.first.size() == 0) {
        ++without_first;
        continue;
      }
      char number[24];
      std::snprintf(number, sizeof number, "%06lld.range", static_cast<long long>(id));
      const fs::path path = recording->root / laser_name(image.laser) / number;
      reader->contents->add(path, Contents::Scan{image, revolution});
      std::uint64_t& pixels = reader->pixels[image.laser];
      if (pixels == 0) pixels = pixel_count(reader->contents->bytes(), image, path);
      scans[image.laser].push_back({frame.t_ns + kRevolution_ns / 2, path});
      has_second |= image.has_second;
    }
  }
  for (auto& [laser, files] : scans) {
    const std::string name = laser_name(laser) + "_LASER";
    recording->other_sensors.push_back(name);
    if (!reader->context.lasers.contains(laser)) {
      recording->findings.push_back({name, "not used: it has no calibration"});
      continue;
    }
    for (FrameFile& file : files) file.lidar = recording->lidars.size();
    recording->lidars.push_back({name, reader->context.lasers.at(laser).body_from_laser});
    add_timed_scans(std::move(files), name, recording);
  }
  if (without_first > 0)
    recording->findings.push_back(
        {"lidar", counted(without_first, "scan") + " without a range image of first returns"});
  if (has_second) recording->findings.push_back({"lidar", "of each ray the first return is used"});
}

/// Boxes hold at the times of their frames, in the axes of the body then.
void add_boxes(const fs::path& file, const std::vector<std::pair<std::int64_t, Frame>>& frames,
               Reader* reader, Recording* recording) {
  std::map<std::string, std::int64_t> ids;
  std::vector<Label> labels;
  std::map<std::pair<std::int64_t, std::int64_t>, std::int64_t> times_ns;  // key: frame, object
  for (const auto& [id, frame] : frames)
    for (const LabelledBox& box : frame.boxes) {
      const FramePose& at = nearest_frame(recording->frames, frame.t_ns + kRevolution_ns / 2);
      if (std::abs(at.t_ns - frame.t_ns - kRevolution_ns / 2) > kRevolution_ns) continue;
      Label label;
      label.frame_id = at.id;
      label.object_id = ids.try_emplace(box.id, std::ssize(ids)).first->second;
      if (!times_ns.try_emplace({label.frame_id, label.object_id}, frame.t_ns).second) continue;
      label.type = box.type;
      label.size_m = box.size_m;
      label.sensor_from_box = pose_at(recording->frames, frame.t_ns).inverse(Eigen::Isometry) *
                              frame.world_from_body * box.body_from_box;
      labels.push_back(std::move(label));
    }
  reader->boxes = place_boxes(labels, Rigid3d::Identity(), recording->frames,
                              [&](const Label& label, const FramePose&) {
                                return times_ns.at({label.frame_id, label.object_id});
                              });
  for (const auto& [frame_id, boxes] : reader->boxes)
    recording->box_files.push_back({frame_id, file});
}

}  // namespace

bool looks_like(const fs::path& root) {
  if (!is_folder(root)) return is_segment(root) && is_there(root);
  std::error_code error;
  fs::directory_iterator it(root, error);
  for (const fs::directory_iterator end; !error && it != end; it.increment(error))
    if (is_segment(it->path()) && !it->path().filename().native().starts_with('.')) return true;
  return false;
}

Recording open(const fs::path& root, PoseSource source) {
  refuse_ground_truth(root, source);
  Recording recording;
  recording.root = root;
  recording.global_frame = GlobalFrame::kArbitrary;
  const fs::path file = segment_of(root);
  const std::shared_ptr<const ByteSource> bytes = open_bytes(file);
  const std::vector<ByteSpan> records = list_records(*bytes, file, &recording.damaged);
  if (records.empty()) throw InputError(file, "", "", "has no frame");
  const auto reader = std::make_shared<Reader>();
  reader->context = first_context(*bytes, records, file, &recording.findings);
  const auto frames = read_frames(*bytes, records, file, reader->context.name, &recording);
  if (frames.empty()) throw InputError(file, "", "", "has no frame with a pose");
  reader->poses = all_poses(frames);
  const DamagedList damaged{"poses", &recording.damaged};
  leave_out_strays(file, "pose", damaged, &reader->poses);
  reader->contents = std::make_shared<Contents>(bytes);
  mount(root, reader->contents);
  add_cameras(file, frames, reader->context, reader->poses, reader->contents.get(), &recording);
  add_lidars(frames, reader.get(), &recording);
  add_boxes(file, frames, reader.get(), &recording);
  recording.reader = reader;
  return recording;
}

}  // namespace redrive::waymo

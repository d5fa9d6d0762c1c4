// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/damaged_records.h"

#include <algorithm>
#include <cstdio>
#include <functional>
#include <map>
#include <set>

#include "redrive/base/cpu_features.h"
#include "redrive/base/error.h"
#include "redrive/base/evenly_spaced.h"
#include "redrive/base/files/file_container.h"
#include "redrive/base/parallel.h"
#include "redrive/base/progress.h"
#include "redrive/image/image_head.h"
#include "redrive/image/image_io.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/recording_reader.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;

constexpr const char *kLidar = "lidar", *kBoxes = "boxes";

/// A record to look at.
struct RecordCheck {
  DamagedRecord record;  ///< `why` is empty until it is damaged
  fs::path path;
  std::function<void(bool whole)> look;  ///< throws InputError if it is damaged
  bool whole = false;
};

void require_content(const fs::path& file, std::uint64_t bytes) {
  if (bytes == 0) throw InputError(file, "", "", "the file is empty");
}

void check_scan(const RecordingReader& reader, const FrameFile& file, bool whole) {
  const std::optional<std::uint64_t> bytes = file_bytes(file.path);
  if (!bytes) throw InputError(file.path, "", "", "no such file, or not readable");
  require_content(file.path, *bytes);
  if (whole || reader.lidar_point_count(file) == 0) reader.read_lidar(file);
}

/// Whether frames have their own files of boxes. Other boxes were read when the recording was
/// opened.
bool has_box_files(const Recording& recording) {
  const std::vector<FrameFile>& files = recording.box_files;
  return files.size() == 1 || (files.size() > 1 && files[0].path != files[1].path);
}

struct Verdict {
  Finding finding;
  bool too_many = false;
};

Verdict judge(const Recording& recording, const std::vector<DamagedRecord>& damaged,
              std::size_t all, std::size_t shown) {
  const double percent = recording.most_damaged_percent;
  const auto most = static_cast<std::size_t>(percent / 100 * static_cast<double>(all));
  Verdict verdict;
  verdict.too_many = damaged.size() > (percent > 0 ? std::max<std::size_t>(1, most) : 0);
  std::vector<std::string> why;
  for (const DamagedRecord& record : damaged)
    why.push_back(recording.metric && record.frame_id >= 0
                      ? "frame " + std::to_string(record.frame_id) + ": " + record.why
                      : record.why);
  char limit[80];
  std::snprintf(limit, sizeof limit, "more than %g %%; --max-damaged PERCENT accepts more",
                percent);
  verdict.finding = {
      damaged[0].sensor,
      std::to_string(damaged.size()) + " of " + counted(all, "record") +
          (verdict.too_many ? std::string(" cannot be used, ") + limit : std::string(" left out")) +
          ": " + first_few(why, shown)};
  return verdict;
}

class Records {
 public:
  Records(const DamageCheck& check, Recording* recording) : check_(check), recording_(*recording) {}

  void leave_out_damaged_files() {
    list_checks();
    look();
    for (Finding& finding : recording_.reader->box_findings())
      recording_.findings.push_back(std::move(finding));
    std::set<fs::path> damaged;
    for (const RecordCheck& check : checks_) {
      if (check.record.why.empty()) continue;
      damaged.insert(check.path);
      recording_.damaged.push_back(check.record);
    }
    const auto is_damaged = [&](const FrameFile& file) { return damaged.contains(file.path); };
    for (RecordedCamera& camera : recording_.cameras) std::erase_if(camera.images, is_damaged);
    std::erase_if(recording_.cameras,
                  [](const RecordedCamera& camera) { return camera.images.empty(); });
    std::erase_if(recording_.lidar_files, is_damaged);
    if (has_box_files(recording_)) std::erase_if(recording_.box_files, is_damaged);
  }

  /// Adds a finding for each sensor. Returns the sensors with too much damage.
  std::vector<Finding> judge_all(const std::vector<DamagedRecord>& all_damaged) {
    std::map<std::string, std::vector<DamagedRecord>> damaged;
    std::vector<Finding> too_many;
    for (const DamagedRecord& record : all_damaged)
      if (record.breaks)
        judge_break(record, &too_many);
      else if (is_chosen(record.frame_id))
        damaged[group_of(record.sensor)].push_back(record);
    for (auto& [group, records] : damaged) {
      const std::size_t all = remaining(group) + records.size();
      constexpr std::size_t kShown = 3;
      for (DamagedRecord& record : records) record.sensor = group;
      Verdict verdict = judge(recording_, records, all,
                              check_.whole == DamageCheck::kAll ? records.size() : kShown);
      const bool counts = !verdict.too_many || check_.cameras.empty() ||
                          !camera_names_.contains(group) ||
                          std::ranges::find(check_.cameras, group) != check_.cameras.end();
      (verdict.too_many && counts ? too_many : recording_.findings).push_back(verdict.finding);
    }
    return too_many;
  }

 private:
  /// Frames on both sides of a break do not belong together. Drops those that are not chosen.
  void judge_break(const DamagedRecord& record, std::vector<Finding>* too_many) {
    const auto side = [&](bool before) {
      return std::ranges::any_of(recording_.frames, [&](const FramePose& frame) {
        return is_chosen(frame.id) && (frame.id < record.frame_id) == before;
      });
    };
    if (side(true) && side(false)) {
      too_many->push_back({record.sensor, "frame " + std::to_string(record.frame_id) + ": " +
                                              record.why + "; --frames takes one side of it"});
    } else if (side(true)) {
      keep_frames({-1, record.frame_id - 1, 1}, &recording_);
    } else if (side(false)) {
      keep_frames({record.frame_id, -1, 1}, &recording_);
    }
  }

  bool is_chosen(std::int64_t frame_id) const {
    const auto& [first, last, step] = check_.frames;
    return frame_id < 0 || (frame_id >= first && (last < 0 || frame_id <= last));
  }

  /// Photographs are judged together: each may have a camera of its own.
  std::string group_of(const std::string& sensor) const {
    return recording_.metric || !camera_names_.contains(sensor) ? sensor : "images";
  }

  template <class File>
  std::size_t chosen(const std::vector<File>& files) const {
    return static_cast<std::size_t>(std::ranges::count_if(
        files, [&](const FrameFile& file) { return is_chosen(file.frame_id); }));
  }

  /// Returns the number of a sensor's chosen records that are left; for poses and times, of frames.
  std::size_t remaining(const std::string& group) const {
    std::size_t of_cameras = 0;
    for (const RecordedCamera& camera : recording_.cameras)
      if (group_of(camera.calibration.name) == group) of_cameras += chosen(camera.images);
    if (of_cameras > 0 || camera_names_.contains(group)) return of_cameras;
    const auto lidar = std::ranges::find(recording_.lidars, group, &RecordedLidar::name);
    if (group != kLidar && lidar != recording_.lidars.end()) {
      std::size_t scans = 0;
      for (const FrameFile& file :
           recording_.scans_of(static_cast<std::size_t>(lidar - recording_.lidars.begin())))
        scans += is_chosen(file.frame_id);
      return scans;
    }
    if (group == kLidar) {  // a file may have scans of several LiDARs
      std::set<fs::path> files;
      for (const FrameFile& file : recording_.lidar_files)
        if (is_chosen(file.frame_id)) files.insert(file.path);
      return files.size();
    }
    if (group == kBoxes) return chosen(recording_.box_files);
    return static_cast<std::size_t>(std::ranges::count_if(
        recording_.frames, [&](const FramePose& frame) { return is_chosen(frame.id); }));
  }

  void add(const std::string& sensor, const FrameFile& file,
           std::function<void(bool whole)> look_at) {
    if (is_chosen(file.frame_id))
      checks_.push_back({{sensor, file.frame_id, ""}, file.path, std::move(look_at)});
  }

  /// Makes the first, the last and some between of the checks from `first` on read whole files.
  void mark_whole(std::size_t first, std::size_t count) {
    const std::size_t size = checks_.size() - first;
    if (check_.whole == 0 || size == 0) return;
    checks_[first].whole = checks_.back().whole = true;
    if (count > 0)
      for (const std::size_t i : evenly_spaced(size, std::min(count, size)))
        checks_[first + i].whole = true;
  }

  void list_checks() {
    for (const RecordedCamera& camera : recording_.cameras) {
      const std::size_t first = checks_.size();
      const CameraCalibration& calibration = camera.calibration;
      camera_names_.insert(calibration.name);
      for (const ImageFile& image : camera.images)
        add(calibration.name, image, [&](bool whole) {
          check_image(image.path, calibration, whole);
          if (!image.mask.path.empty()) check_image(image.mask.path, calibration, whole);
        });
      mark_whole(first, recording_.metric ? check_.whole : 0);
    }
    if (!recording_.metric) mark_whole(0, check_.whole);
    const std::size_t first = checks_.size();
    std::set<fs::path> files;
    if (!recording_.lidars.empty())
      for (const FrameFile& file : recording_.lidar_files)
        if (files.insert(file.path).second)
          add(kLidar, file, [&](bool whole) { check_scan(*recording_.reader, file, whole); });
    mark_whole(first, check_.whole);
    if (has_box_files(recording_))
      for (const FrameFile& file : recording_.box_files)
        add(kBoxes, file, [&](bool) { recording_.reader->read_boxes(file); });
  }

  void look() {
    ThreadPool pool(hardware_threads());
    Progress progress("looking at files", std::ssize(checks_));
    pool.run(static_cast<int>(checks_.size()), [&](int i) {
      RecordCheck& check = checks_[static_cast<std::size_t>(i)];
      try {
        check.look(check.whole);
      } catch (const InputError& error) {
        check.record.why = error.what();
      }
      progress.count();
    });
  }

  const DamageCheck& check_;
  Recording& recording_;
  std::vector<RecordCheck> checks_;
  std::set<std::string> camera_names_;
};

void require_none(const std::vector<Finding>& too_many, const Recording& recording) {
  if (!too_many.empty())
    throw InputError(recording.root, too_many[0].subject, "", too_many[0].what);
}

}  // namespace

void check_image(const fs::path& file, const CameraCalibration& camera, bool whole) {
  const auto [bytes, head, has_end] = read_image_ends(file);
  require_content(file, bytes);
  if (whole || !head || !has_end) read_image(file);
  if (head && (head->width != camera.width || head->height != camera.height))
    throw InputError(
        file, "size", size_text(head->width, head->height),
        "the calibration of " + camera.name + " has " + size_text(camera.width, camera.height));
}

std::vector<Finding> leave_out_damaged(const DamageCheck& check, Recording* recording) {
  recording->most_damaged_percent = check.most_percent;
  Records records(check, recording);
  records.leave_out_damaged_files();
  std::vector<Finding> too_many = records.judge_all(std::vector(recording->damaged));
  if (recording->cameras.empty() && too_many.empty())
    too_many.push_back({"images", "none is left: " + recording->damaged.front().why});
  return too_many;
}

void require_few_damaged(const DamageCheck& check, Recording* recording) {
  require_none(leave_out_damaged(check, recording), *recording);
}

void require_few_left_out(const DamageCheck& check, const std::vector<DamagedRecord>& damaged,
                          Recording* recording) {
  recording->damaged.insert(recording->damaged.end(), damaged.begin(), damaged.end());
  require_none(Records(check, recording).judge_all(damaged), *recording);
}

std::optional<Finding> judge_damaged(const Recording& recording,
                                     const std::vector<DamagedRecord>& damaged, std::size_t all) {
  if (damaged.empty()) return std::nullopt;
  constexpr std::size_t kShown = 3;
  const Verdict verdict = judge(recording, damaged, all, kShown);
  if (verdict.too_many)
    throw InputError(recording.root, verdict.finding.subject, "", verdict.finding.what);
  return verdict.finding;
}

}  // namespace redrive

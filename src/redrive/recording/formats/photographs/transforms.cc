// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/photographs/transforms.h"

#include <algorithm>
#include <array>
#include <map>
#include <set>
#include <tuple>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/frame_files.h"
#include "redrive/recording/formats/image_size.h"
#include "redrive/recording/formats/mask_folder.h"
#include "redrive/recording/formats/photographs/far_photographs.h"
#include "redrive/recording/formats/photographs/photographs.h"
#include "redrive/recording/formats/recording_reader.h"
#include "redrive/recording/lidar/ply.h"
#include "redrive/recording/lidar/unusable_returns.h"

namespace redrive::transforms {
namespace {

namespace fs = std::filesystem;

bool is_there(const fs::path& path) {
  std::error_code error;
  return fs::is_regular_file(path, error);
}

using photographs::find_image;

/// Returns the name of an image below the folder of images, which may have any name.
std::string name_in_images(const fs::path& file, const fs::path& image) {
  const fs::path relative =
      image.lexically_normal().lexically_relative(file.parent_path().lexically_normal());
  const bool has_folder = std::distance(relative.begin(), relative.end()) > 1;
  return (has_folder ? relative.lexically_relative(*relative.begin()) : relative).string();
}

/// Returns nerfstudio's mask of the entry, instant-ngp's beside the image, or the one in the folder
/// `masks`. The colours of the first two have opposite meanings.
MaskFile find_mask(const fs::path& file, const FrameEntry& entry, const fs::path& image,
                   MaskFolder* masks) {
  const fs::path dynamic = image.parent_path() / ("dynamic_mask_" + image.stem().string() + ".png");
  if (entry.mask.empty() && !is_there(dynamic)) return masks->find(name_in_images(file, image));
  if (entry.mask.empty()) return {dynamic, false};
  if (is_there(dynamic))
    throw InputError(
        file, "mask_path", entry.mask,
        "there is " + dynamic.string() +
            ", too; mask_path masks black pixels, dynamic_mask white ones: remove one of them");
  const fs::path mask = file.parent_path() / entry.mask;
  if (!is_there(mask))
    throw InputError(mask, "", "", "missing; " + file.string() + " has it as mask_path");
  masks->use(mask);
  return {mask, true};
}

/// Points are in the file's world.
class Reader final : public RecordingReader {
 public:
  std::vector<StaticPoint> read_points(const Recording& recording) const override {
    std::vector<StaticPoint> points;
    for (const Eigen::Vector3d& point : read_ply(recording.points_file))
      points.push_back({point, {}, false});
    return points;
  }
};

TransformsFile read(const fs::path& file, std::vector<DamagedRecord>* damaged) {
  const auto size_of = [&](const std::string& file_path) -> std::optional<ImageSize> {
    const fs::path image = find_image(file.parent_path(), file_path);
    return image.empty() ? std::nullopt : image_size(image);
  };
  const DamagedList poses{"poses", damaged};
  return parse(read_file(file), file, size_of, &poses);
}

/// Collects frames and images. Images with equal intrinsics belong to one camera.
class Collector {
 public:
  explicit Collector(const fs::path& root)
      : recording_(photographs::empty_recording(root)), masks_(root) {}

  void add(const fs::path& file, const FrameEntry& entry, bool held_out) {
    const fs::path image = find_image(file.parent_path(), entry.file);
    if (image.empty()) {
      missing_.push_back(entry.file);
      return;
    }
    const DamagedList images{"images", &recording_.damaged};
    if (!parse_record(&images, -1, [&] {
          if (!entry.camera)
            throw InputError(image, "", "",
                             "neither a PNG nor a JPEG with a size, and w and h are missing where "
                             "the focal length stands");
        }))
      return;
    const auto id = static_cast<std::int64_t>(recording_.frames.size());
    recording_.frames.push_back({id, id * photographs::kFrameTime_ns, entry.global_from_body});
    const fs::path listed = file.parent_path() / entry.file;
    if (listed != image && !image.string().starts_with(listed.string()))
      found_elsewhere_.push_back(image.string());
    if (!images_.insert(image).second)
      throw InputError(file, "file_path", entry.file,
                       "a second frame with the image " + image.string());
    const MaskFile mask = find_mask(file, entry, image, &masks_);
    for (const fs::path& named : {image, mask.path}) note_outside(named);
    const CameraCalibration& c = *entry.camera;
    const auto key = std::tuple(c.model, c.parameters, c.width, c.height);
    const auto [found, is_new] = cameras_.try_emplace(key, recording_.cameras.size());
    if (is_new) recording_.cameras.push_back({c, {}});
    recording_.cameras[found->second].images.push_back({{id, image}, mask, held_out});
  }

  /// `path`: ply_file_path, may be empty.
  void set_points(const std::string& path) {
    if (path.empty()) return;
    const fs::path file = recording_.root / path;
    if (!is_there(file)) {
      recording_.findings.push_back({"ply_file_path", file.string() + " is missing: no points"});
      return;
    }
    note_outside(file);
    std::size_t left_out = 0;
    read_ply(file, &left_out);  // reports here what training would refuse
    if (const auto finding = points_left_out(file, left_out))
      recording_.findings.push_back(*finding);
    recording_.points_file = file;
    recording_.reader = std::make_shared<Reader>();
  }

  Recording finish(std::optional<BoundingCube> bounds) {
    std::vector<RecordedCamera>& cameras = recording_.cameras;
    masks_.report_unused(&recording_.findings);
    photographs::report_unread_points({recording_.root}, recording_.points_file,
                                      &recording_.findings);
    if (!missing_.empty())
      recording_.findings.push_back(
          {"frames", counted(missing_.size(), "image") +
                         " listed, but not there, left out: " + first_few(missing_)});
    if (cameras.empty()) refuse_without_cameras();
    leave_out_far_photographs(&recording_);
    // Numbers of equal length, so that names sort by number.
    const std::size_t digits = std::to_string(cameras.size()).size();
    for (std::size_t i = 0; i < cameras.size(); ++i) {
      std::string number = std::to_string(i + 1);
      number.insert(0, digits - number.size(), '0');
      cameras[i].calibration.name = cameras.size() == 1 ? "camera" : "camera_" + number;
    }
    photographs::note_found_elsewhere(found_elsewhere_, &recording_.findings);
    photographs::fit_to_images(&recording_);
    recording_.bounds = bounds;
    return std::move(recording_);
  }

  std::vector<Finding>& findings() { return recording_.findings; }
  std::vector<DamagedRecord>& damaged() { return recording_.damaged; }

 private:
  [[noreturn]] void refuse_without_cameras() const {
    if (missing_.empty() && !recording_.damaged.empty())
      throw InputError(recording_.root, "", "",
                       "no image can be used: " + recording_.damaged.front().why);
    photographs::refuse_without_images(recording_.root, missing_.empty() ? "" : missing_.front());
  }

  void note_outside(const fs::path& file) {
    if (recording_.outside_file.empty() && !file.empty() && lies_outside(file, recording_.root))
      recording_.outside_file = file;
  }

  Recording recording_;
  MaskFolder masks_;
  std::set<fs::path> images_;
  std::vector<std::string> missing_, found_elsewhere_;
  std::map<std::tuple<std::string, std::vector<double>, int, int>, std::size_t> cameras_;
};

/// Compares numbers in names as numbers, so that r_10 follows r_9.
std::vector<FrameEntry> in_file_name_order(std::vector<FrameEntry> entries) {
  std::sort(entries.begin(), entries.end(), [](const FrameEntry& a, const FrameEntry& b) {
    return strverscmp(a.file.c_str(), b.file.c_str()) < 0;
  });
  return entries;
}

}  // namespace

bool looks_like(const fs::path& root) { return is_there(root / "transforms.json"); }
bool looks_like_blender(const fs::path& root) { return is_there(root / "transforms_train.json"); }

Recording open(const fs::path& root, PoseSource source) {
  refuse_ground_truth(root, source);
  const fs::path file = root / "transforms.json";
  Collector collector(root);
  const TransformsFile transforms = read(file, &collector.damaged());
  const auto set_of = [](const std::optional<std::vector<std::string>>& names) {
    return names ? std::set<std::string>(names->begin(), names->end()) : std::set<std::string>();
  };
  const std::set<std::string> train = set_of(transforms.train),
                              held_out = set_of(transforms.test ? transforms.test : transforms.val);
  std::vector<std::string> neither;
  for (const FrameEntry& entry : in_file_name_order(transforms.entries)) {
    const bool held = held_out.contains(entry.file), trains = train.contains(entry.file);
    if (held && trains)
      throw InputError(file, "train_filenames", entry.file,
                       "is to be trained on and held out at the same time");
    if (transforms.train && !held && !trains) {
      neither.push_back(entry.file);
    } else {
      collector.add(file, entry, held);
    }
  }
  if (!neither.empty())
    collector.findings().push_back(
        {"frames",
         counted(neither.size(), "image") +
             " in neither train_filenames nor the held-out list, left out: " + first_few(neither)});
  collector.set_points(transforms.points);
  return collector.finish(transforms.bounds);
}

Recording open_blender(const fs::path& root, PoseSource source) {
  refuse_ground_truth(root, source);
  const fs::path train = root / "transforms_train.json", test = root / "transforms_test.json",
                 val = root / "transforms_val.json";
  Collector collector(root);
  const TransformsFile training = read(train, &collector.damaged());
  for (const FrameEntry& entry : in_file_name_order(training.entries))
    collector.add(train, entry, false);
  if (const fs::path held_out = is_there(test) ? test : val; is_there(held_out))
    for (const FrameEntry& entry : in_file_name_order(read(held_out, &collector.damaged()).entries))
      collector.add(held_out, entry, true);
  return collector.finish(training.bounds ? training.bounds : instant_ngp_cube(1));
}

}  // namespace redrive::transforms
